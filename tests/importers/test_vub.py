from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from clt.calibration.apply import apply_calibration, read_calibration
from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.importers import IMPORT_FORMATS
from clt.importers.vub import read_vub, vub_files

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared" / "data" / "vub_tb4_relative"
START = 1_696_523_866
HEAD = "t_unix_s,x_m,y_m,z_m,qw,qx,qy,qz"
TIME = np.arange(11) * 0.1
UPRIGHT = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Camera axes (x right, y down, z forward) of a body that looks along x, as columns of R."""


def second(t):
    """Nine decimals, so that no float could hold the stamp."""
    return f"{START + int(t + 1e-9)}.{round((t % 1.0) * 10) % 10}89000123"


def quaternion(R):
    """(w, x, y, z) of a rotation matrix with 1 + trace(R) > 0."""
    w = 0.5 * np.sqrt(1.0 + np.trace(R))
    return w, *(np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4.0 * w))


def yaw(heading):
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def pose_rows(x, y, heading, camera):
    turned = [quaternion(yaw(h) @ UPRIGHT if camera else yaw(h)) for h in heading]
    return [
        ",".join([second(t), *(f"{value:.12f}" for value in (a, b, 0.3, *q))])
        for t, a, b, q in zip(TIME, x, y, turned, strict=True)
    ]


def circle(v, omega):
    """Drive an arc from the origin, looking along x."""
    heading = omega * TIME
    return v / omega * np.sin(heading), v / omega * (1.0 - np.cos(heading)), heading


def write(path, head, rows):
    text = "\n".join([head, *rows, ""])
    if path.suffix == ".gz":
        path.write_bytes(gzip.compress(text.encode(), mtime=0))
    else:
        path.write_text(text)


def experiment(folder, name="exp1", suffix=".csv.gz"):
    """tb2 on an arc of 0.2 m/s and 0.5 rad/s, tb3 on one of 0.1 m/s and -1 rad/s."""
    ranges = [f"{second(t)},{2.0 + t:.3f}" for t in TIME]
    write(folder / f"{name}_uwb{suffix}", "t_unix_s,range_m", ranges)
    for robot, motion in (("tb2", circle(0.2, 0.5)), ("tb3", circle(0.1, -1.0))):
        write(folder / f"{name}_{robot}_vio{suffix}", HEAD, pose_rows(*motion, camera=True))
        write(folder / f"{name}_{robot}_vicon{suffix}", HEAD, pose_rows(*motion, camera=False))
    return folder


@pytest.mark.parametrize("suffix", [".csv", ".csv.gz"])
def test_streams(tmp_path, suffix):
    recording = read_vub(experiment(tmp_path, suffix=suffix))
    assert [(r.name, r.id, r.static, r.sigma_v) for r in recording.team.robots] == [
        ("tb2", 2, False, 0.045),
        ("tb3", 3, False, 0.045),
    ]
    assert recording.team.range_sigma == 0.09
    stamp = [START * 10**9 + k * 10**8 + 89_000_123 for k in range(10)]
    for name, v, omega in (("tb2", 0.2, 0.5), ("tb3", 0.1, -1.0)):
        odometry, truth = recording.odometry[name], recording.truth[name]
        assert odometry.stamp.tolist()[:-1] == stamp[1:]
        assert odometry.v == pytest.approx(v, abs=1e-9)
        assert odometry.omega == pytest.approx(omega, abs=1e-9)
        assert truth.stamp.tolist()[:-1] == stamp
        assert truth.heading == pytest.approx(omega * TIME)
        assert truth.frame == "world"
    ranges = recording.ranges
    assert ranges.stamp.tolist()[:-1] == stamp
    assert ranges.raw == pytest.approx(2.0 + TIME)
    assert (set(ranges.source), set(ranges.target)) == ({0}, {1})
    assert recording.faults == ()


def test_paths_of_an_experiment(tmp_path):
    experiment(tmp_path)
    assert len(vub_files(tmp_path)) == 5
    experiment(tmp_path, "exp2")
    names = {file.name for file in vub_files(tmp_path / "exp2")}
    assert names == {f"exp2_{x}.csv.gz" for x in ("uwb", "tb2_vio", "tb3_vio", *VICON)}
    assert vub_files(tmp_path / "exp2_tb3_vio.csv.gz") == vub_files(tmp_path / "exp2")
    with pytest.raises(LogError, match="give one experiment, as FOLDER/NAME; it has: exp1, exp2"):
        read_vub(tmp_path)
    with pytest.raises(LogError, match="no experiment `exp3`; it has: exp1, exp2"):
        read_vub(tmp_path / "exp3")
    with pytest.raises(LogError, match="No such file"):
        read_vub(tmp_path / "nowhere" / "exp1")
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match="none of its files"):
        read_vub(tmp_path / "empty")


VICON = ("tb2_vicon", "tb3_vicon")


def test_missing_streams(tmp_path):
    experiment(tmp_path)
    for name in VICON:
        (tmp_path / f"exp1_{name}.csv.gz").unlink()
    recording = read_vub(tmp_path)
    assert recording.truth == {}
    assert list(recording.odometry) == ["tb2", "tb3"]
    (tmp_path / "exp1_tb3_vio.csv.gz").unlink()
    with pytest.raises(LogError, match=r"exp1: poses of 1 robot\(s\)"):
        read_vub(tmp_path)
    (tmp_path / "exp1_uwb.csv.gz").unlink()
    with pytest.raises(LogError, match="_uwb file beside the poses"):
        read_vub(tmp_path)


def test_jumps_are_reported_and_kept(tmp_path):
    experiment(tmp_path)
    x, y, heading = circle(0.2, 0.5)
    write(
        tmp_path / "exp1_tb2_vio.csv.gz",
        HEAD,
        pose_rows(x + np.where(TIME > 0.55, 1.0, 0.0), y, heading, camera=True),
    )
    recording = read_vub(tmp_path)
    (fault,) = recording.faults
    assert (fault.kind, fault.count, fault.data_lost) == ("jump", 1, False)
    assert "exp1_tb2_vio.csv.gz" in fault.text
    assert recording.odometry["tb2"].v[5] > 9.0


def test_rows_that_make_no_sense_are_counted(tmp_path):
    experiment(tmp_path)
    rows = [
        "1.0,2.0",
        "3.0,nan",
        "2.0,4.0",
        "",
        "2.0,5.0",
        "then,6.0",
        "-4.0,6.0",
        "1e30,6.0",
        "12345678901.0,6.0",
        "5.0",
        "6.0,7.0m",
    ]
    write(tmp_path / "exp1_uwb.csv.gz", "t_unix_s, range_m", rows)
    recording = read_vub(tmp_path)
    assert recording.ranges.stamp.tolist() == [10**9, 2 * 10**9]
    assert recording.ranges.raw.tolist() == [2.0, 4.0]
    found = {fault.kind: 0 for fault in recording.faults}
    for fault in recording.faults:
        found[fault.kind] += fault.count
    assert found == {"row": 6, "nan": 1, "duplicate": 1}


def test_times_without_decimals_and_with_too_many(tmp_path):
    experiment(tmp_path)
    write(
        tmp_path / "exp1_uwb.csv.gz",
        "range_m,t_unix_s",
        ["1.0,7", "2.0,8.", "3.0, 9.1234567899 ", "4.0,4294967296.5"],
    )
    recording = read_vub(tmp_path)
    assert recording.ranges.stamp.tolist() == [7 * 10**9, 8 * 10**9, 9_123_456_789]
    assert [(fault.kind, fault.count) for fault in recording.faults] == [("row", 1)]


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "no column `t_unix_s`"),
        (b"t_unix_s,distance\n1.0,2.0\n", "no column `range_m`; it has: t_unix_s, distance"),
        (b"t_unix_s,range_m\n", "no row with a time and 1 number"),
        (b"t_unix_s,range_m\nx,y\n", "no row with a time and 1 number"),
        (b"\xff\xfe\x00t", "not a text file"),
        (gzip.compress(b"t_unix_s,range_m\n1.0,2.0\n" * 99, mtime=0)[:40], "a damaged gzip file"),
        (b"\x1f\x8b" + bytes(30), "a damaged gzip file"),
        (b't_unix_s,range_m\n1.0,"' + b"9" * 200_000 + b'"\n', "not a CSV file"),
    ],
)
def test_damaged_file(tmp_path, data, said):
    experiment(tmp_path)
    path = tmp_path / "exp1_uwb.csv.gz"
    path.write_bytes(data)
    with pytest.raises(LogError) as caught:
        read_vub(tmp_path)
    message = str(caught.value)
    assert said in message
    assert str(path) in message
    assert "\n" not in message


def test_known_format(tmp_path):
    experiment(tmp_path)
    known = IMPORT_FORMATS["vub"]
    assert known.files((tmp_path,)) == vub_files(tmp_path)
    assert known.read((tmp_path,), None).team == read_vub(tmp_path).team


def real(name):
    if not REAL.is_dir():
        pytest.skip("the VUB pair is not here")
    return read_vub(REAL / name)


def block_means(values, size):
    """Means over blocks of samples."""
    return values[: len(values) // size * size].reshape(-1, size).mean(axis=1)


def speeds(recording, name, size=50):
    """True and measured forward speed, means over 5 s."""
    truth = recording.truth[name]
    middle = truth.heading[:-1] + 0.5 * wrap_angle(np.diff(truth.heading))
    step = np.cos(middle) * np.diff(truth.x) + np.sin(middle) * np.diff(truth.y)
    return block_means(step / 0.1, size), block_means(recording.odometry[name].v, size)


def test_calibration_of_the_real_run():
    """What the file says of ranges and of the odometry's scale comes out of the data."""
    calibration = read_calibration(ROOT / "benchmarks" / "vub_calibration.toml")
    recording = real("exp4")
    assert recording.faults == ()
    a, b = recording.truth.values()
    assert np.array_equal(a.stamp, recording.ranges.stamp)
    distance = np.hypot(a.x - b.x, a.y - b.y)
    error = apply_calibration(recording, calibration).ranges.range - distance
    assert abs(np.median(error)) < 0.002
    spread = 1.4826 * np.median(np.abs(error))
    assert spread == pytest.approx(recording.team.range_sigma, abs=0.005)
    for name in ("tb2", "tb3"):
        true, odometric = speeds(recording, name)
        scale = calibration.odometry[name].scale
        assert (true @ odometric) / (odometric @ odometric) == pytest.approx(scale, abs=0.002)
        turn = wrap_angle(np.diff(recording.truth[name].heading)) / 0.1
        assert abs(np.mean(recording.odometry[name].omega - turn)) < 1.5e-4


def test_real_fault_case():
    recording = real("exp2")
    (fault,) = recording.faults
    assert fault.kind == "jump"
    assert "exp2_tb2_vio" in fault.text
