from __future__ import annotations

import gzip
import json
import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import Stores
from typer.testing import CliRunner

from clt.calibration.apply import apply_calibration, read_calibration
from clt.cli.app import app
from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.core.recording import Recording
from clt.importers import IMPORT_FORMATS
from clt.importers.tiers import read_tiers
from clt.log.recording.load import load
from clt.metrics.associate import interpolate
from tests.importers.bags import SECOND, write_bag

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"
REAL = DATA / "tiers_pair_20220907"
CASE4 = DATA / "tiers_case4"
START = 1_662_560_741_000_000_007
DELAY = 75_000_000
PAIR = ("/uwb/tof/n_2/n_3/distance", "/uwb/tof/n_3/n_2/distance")


def every(period, count, *values):
    """Messages at even steps: each value a number, or a function of the seconds since START."""
    stamps = [START + round(k * period * SECOND) for k in range(count)]
    return [
        (at, tuple(f((at - START) / SECOND) if callable(f) else f for f in values)) for at in stamps
    ]


def streams():
    """turtle01 drives with node 2, turtle03 stands with node 3; what others publish is passed."""
    return {
        "/turtle01/odom": every(0.05, 40, 0.25, lambda t: 0.1 * t),
        "/turtle03/odom": every(0.05, 40, 0.0, 0.0),
        "/vrpn_client_node/turtlebot01_cap/pose": every(0.01, 200, lambda t: 0.25 * t, 1.0, 0.5),
        "/vrpn_client_node/turtlebot3/pose": every(0.01, 200, 3.0, -1.0, -3.0),
        PAIR[0]: every(0.02, 100, lambda t: 2.0 + t),
        "/turtle01/text": every(1.0, 2),
    }


def kinds(recording):
    return {fault.kind: (fault.count, fault.data_lost) for fault in recording.faults}


@pytest.mark.parametrize("release", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY])
def test_streams(tmp_path, release):
    """Before and since sensor_msgs/Range has a variance."""
    recording = read_tiers(write_bag(tmp_path / "bag", streams(), DELAY, release))
    team = recording.team
    assert [(r.name, r.id, r.static, r.twist) for r in team.robots] == [
        ("turtle01", 2, False, "mean"),
        ("turtle03", 3, False, "mean"),
    ]
    assert team.range_sigma == 0.057
    assert team.robots[0].sigma_v == 0.02
    odometry, truth, ranges = (
        recording.odometry["turtle01"],
        recording.truth["turtle01"],
        recording.ranges,
    )
    assert odometry.stamp[:2].tolist() == [START, START + 50_000_000]
    assert odometry.log_time[0] == START + DELAY
    assert odometry.v.tolist() == [0.25] * 40
    assert odometry.omega == pytest.approx(0.005 * np.arange(40))
    assert truth.frame == "world"
    assert truth.x == pytest.approx(0.0025 * np.arange(200))
    assert truth.heading == pytest.approx(0.5)
    assert recording.truth["turtle03"].heading == pytest.approx(-3.0)
    assert len(ranges.stamp) == 100
    assert (set(ranges.source), set(ranges.target)) == ({0}, {1})
    assert ranges.raw == pytest.approx(2.0 + 0.02 * np.arange(100), abs=1e-6)
    assert np.array_equal(ranges.range, ranges.raw)
    assert np.isnan(ranges.sigma).all()
    assert recording.faults == ()


def test_folder_file_and_packed_file_are_one(tmp_path):
    path = write_bag(tmp_path / "bag", streams())
    packed = tmp_path / "packed" / f"{path.name}.gz"
    packed.parent.mkdir()
    packed.write_bytes(gzip.compress(path.read_bytes(), mtime=0))
    files = IMPORT_FORMATS["tiers"].files
    assert files((path.parent,)) == (path,)
    assert files((packed.parent,)) == (packed,)
    first = read_tiers(path)
    for other in (path.parent, packed, packed.parent):
        again = read_tiers(other)
        assert again.team == first.team
        assert np.array_equal(again.ranges.raw, first.ranges.raw)


def test_split_bag(tmp_path):
    """Topics have other ids in each file, and some stand in one of them only."""
    early, late = streams(), dict(reversed(streams().items()))
    early.pop("/turtle03/odom")
    late = {
        name: [(at + 10 * SECOND, values) for at, values in rows] for name, rows in late.items()
    }
    folder = tmp_path / "bag"
    folder.mkdir()
    for k, part in enumerate((early, late)):
        shutil.copy(write_bag(tmp_path / f"part{k}", part), folder / f"run_{k}.db3")
    whole = read_tiers(folder)
    assert [len(whole.odometry[name].v) for name in ("turtle01", "turtle03")] == [80, 40]
    assert whole.odometry["turtle03"].stamp[0] == START + 10 * SECOND
    assert len(whole.ranges.raw) == 200
    shutil.copy(folder / "run_0.db3", folder / "other_0.db3")
    with pytest.raises(LogError, match=r"several bags \(other_0.db3, run_0.db3, run_1.db3\)"):
        read_tiers(folder)


def test_a_range_that_both_ends_report_counts_once(tmp_path):
    topics = streams()
    same = [(at + 40_000, values) for at, values in topics[PAIR[0]]]
    same[3] = (same[3][0], (9.0,))
    same[5] = (same[5][0] + 5_000_000, same[5][1])
    recording = read_tiers(write_bag(tmp_path / "bag", {**topics, PAIR[1]: same}))
    assert len(recording.ranges.raw) == 102
    assert kinds(recording) == {"mirrored": (98, False)}
    back = recording.ranges.source == 1
    assert recording.ranges.raw[back] == pytest.approx([9.0, 2.1])


def test_robots_without_odometry(tmp_path):
    """Who stands by the truth is static; node 8, of which nothing is known, if all others are."""
    topics = {
        "/vrpn_client_node/turtlebot1/pose": every(0.1, 20, 3.0, -1.0, 0.0),
        "/vrpn_client_node/turtlebot2/pose": every(0.1, 20, 0.0, lambda t: 0.01 * t, 0.0),
        "/uwb/tof/n_1/n_8/distance": every(0.1, 20, 2.0),
        "/uwb/tof/n_2/n_1/distance": every(0.1, 20, 2.0),
    }
    standing = read_tiers(write_bag(tmp_path / "a", topics)).team
    assert [(r.name, r.id, r.static) for r in standing.robots] == [
        ("turtlebot1", 1, True),
        ("turtlebot2", 2, True),
        ("node8", 8, True),
    ]
    topics["/vrpn_client_node/turtlebot2/pose"] = every(0.1, 20, 0.0, lambda t: 0.2 * t, 0.0)
    driving = read_tiers(write_bag(tmp_path / "b", topics)).team
    assert [r.static for r in driving.robots] == [True, False, False]


def test_nodes_and_robots_whose_numbers_say_nothing(tmp_path):
    """Two nodes, neither with a robot's number: nobody is paired."""
    topics = {name.replace("n_3", "n_7"): rows for name, rows in streams().items()}
    team = read_tiers(write_bag(tmp_path / "bag", topics)).team
    assert [(r.name, r.id, r.static) for r in team.robots] == [
        ("turtle01", 1, False),
        ("turtle03", 3, False),
        ("node2", 2, False),
        ("node7", 7, False),
    ]


def test_a_node_on_another_robot_is_found_by_the_truth(tmp_path):
    """Three robots; what is called n_1 rides on turtlebot2, and the other way around."""
    place = {"1": (0.0, 0.0), "2": (4.0, 0.0), "3": (4.0, 1.0)}
    topics = {
        f"/vrpn_client_node/turtlebot{robot}/pose": every(0.1, 20, *xy, 0.0)
        for robot, xy in place.items()
    }
    distance = {("1", "2"): 4.0, ("1", "3"): 1.0, ("2", "3"): np.hypot(4.0, 1.0)}
    for (a, b), metres in distance.items():
        topics[f"/uwb/tof/n_{a}/n_{b}/distance"] = every(0.1, 20, metres + 0.3)
    faults = read_tiers(write_bag(tmp_path / "bag", topics)).faults
    assert [(fault.kind, fault.count, fault.data_lost) for fault in faults] == [
        ("ends", 20, False),
        ("ends", 20, False),
    ]
    assert "turtlebot1-turtlebot3: ranges are 2.8 m (median) off" in faults[0].text
    assert "turtlebot2-turtlebot3: ranges are 3.4 m (median) off" in faults[1].text


def test_command(tmp_path):
    path = write_bag(tmp_path / "bag", streams())
    out, calibration = tmp_path / "out.mcap", tmp_path / "calibration.toml"
    calibration.write_text("[range]\noffset = -0.5\n[odometry.turtle01]\nscale = 2.0\n")
    words = ["import", "tiers", str(path.parent), "-o", str(out), "--calibration", str(calibration)]
    result = CliRunner().invoke(app, [*words, "--json"])
    assert result.exit_code == 0
    printed = json.loads(result.stdout)
    assert (printed["format"], printed["calibrated"], printed["ranges"]) == ("tiers", True, 100)
    recording = load(out).recording
    direct = read_tiers(path)
    assert recording.team == direct.team
    assert recording.ranges.range == pytest.approx(direct.ranges.raw - 0.5)
    assert np.array_equal(recording.ranges.log_time, direct.ranges.log_time)
    assert recording.odometry["turtle01"].v == pytest.approx(2.0 * direct.odometry["turtle01"].v)
    assert list(json.loads(recording.run["inputs"])) == [str(path), str(calibration)]
    again = CliRunner().invoke(app, [*words[:2], str(tmp_path), *words[3:], "--force"])
    assert again.exit_code == 1


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({PAIR[0]: []}, "no ranges (/uwb/tof/n_A/n_B/distance)"),
        ({"/uwb/tof/n_4/n_4/distance": every(1.0, 2, 1.0)}, "not a range between two nodes"),
        ({"/uwb/tof/n_4/n_70000/distance": every(1.0, 2, 1.0)}, "below 65536"),
        ({"/turtlebot1/odom": every(1.0, 2, 0.0, 0.0)}, "are of the same kind for one robot"),
    ],
)
def test_topics_that_make_no_team(tmp_path, change, said):
    with pytest.raises(LogError) as caught:
        read_tiers(write_bag(tmp_path / "bag", {**streams(), **change}))
    assert said in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def edited(path, *statements):
    with sqlite3.connect(path) as database:
        for statement in statements:
            database.execute(statement)
    database.close()
    return path


def test_another_type_or_encoding_is_named(tmp_path):
    path = write_bag(tmp_path / "bag", streams())
    edited(path, "UPDATE topics SET type = 'std_msgs/msg/String' WHERE name = '/turtle01/odom'")
    with pytest.raises(LogError, match="/turtle01/odom"):
        read_tiers(path)
    path = write_bag(tmp_path / "other", streams())
    edited(path, "UPDATE topics SET serialization_format = 'protobuf'")
    with pytest.raises(LogError, match="protobuf"):
        read_tiers(path)


def test_messages_that_make_no_sense_are_counted(tmp_path):
    path = edited(
        write_bag(tmp_path / "bag", streams()),
        "UPDATE messages SET data = x'00010000' WHERE id IN (SELECT m.id FROM messages m "
        "JOIN topics t ON t.id = m.topic_id WHERE t.name = '/turtle01/odom' LIMIT 3)",
        "UPDATE messages SET data = 'text' WHERE id IN (SELECT m.id FROM messages m "
        "JOIN topics t ON t.id = m.topic_id WHERE t.name LIKE '/uwb/%' LIMIT 2)",
    )
    recording = read_tiers(path)
    assert len(recording.odometry["turtle01"].v) == 37
    assert len(recording.ranges.raw) == 98
    assert kinds(recording)["decode"][1]
    assert sum(fault.count for fault in recording.faults) == 5


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: b"no bag at all" * 100,
        lambda data: data[: len(data) // 2],
        lambda data: data[:100] + bytes(4096) + data[4196:],
        lambda data: data.replace(b"TABLE messages(", b"TABLE mess\nges("),
        lambda data: data.replace(b"TABLE messages(", b"TABLE mess\xffges("),
    ],
)
def test_damaged_database(tmp_path, damage, packed):
    path = write_bag(tmp_path / "bag", streams())
    data = damage(path.read_bytes())
    assert data != path.read_bytes()
    path.write_bytes(gzip.compress(data, mtime=0) if packed else data)
    whole = data.startswith(b"SQLite")
    refused(path, "not a sound rosbag2 file in SQLite" if whole else "is ")


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[:2],
        lambda data: data[: len(data) // 2],
        lambda data: data[:300] + bytes(300) + data[600:],
        lambda data: data[:-8] + bytes(8),
    ],
)
def test_damaged_gzip(tmp_path, damage):
    path = write_bag(tmp_path / "bag", streams())
    path.write_bytes(damage(gzip.compress(path.read_bytes(), mtime=0)))
    refused(path, "a damaged gzip file")


def refused(path, said):
    with pytest.raises(LogError) as caught:
        read_tiers(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {said}")
    assert "\n" not in message


def test_missing(tmp_path):
    with pytest.raises(LogError, match="nowhere: No such file"):
        read_tiers(tmp_path / "nowhere")
    with pytest.raises(LogError, match=r"no \.mcap, \.db3"):
        read_tiers(tmp_path)


@pytest.fixture(scope="module")
def real() -> Recording:
    if not REAL.is_dir():
        pytest.skip("the TIERS pair is not here")
    return read_tiers(REAL)


def test_real_run(real):
    assert [(r.name, r.id, r.static) for r in real.team.robots] == [
        ("turtle01", 2, False),
        ("turtle03", 3, False),
    ]
    assert len(real.ranges.raw) == 3357
    assert [len(stream.v) for stream in real.odometry.values()] == [820, 818]
    assert [len(poses.x) for poses in real.truth.values()] == [5342, 5342]
    assert real.faults == ()
    odometry = real.odometry["turtle01"]
    delay = np.median(odometry.log_time - odometry.stamp) * 1e-9
    assert delay == pytest.approx(0.078, abs=0.002)
    assert np.abs(real.odometry["turtle03"].v).max() < 1e-4


def test_calibration_of_the_real_run(real):
    """What the file says of ranges and of the odometry's scale comes out of the data."""
    calibration = read_calibration(ROOT / "benchmarks" / "tiers_calibration.toml")
    ranges = apply_calibration(real, calibration).ranges
    poses = [interpolate(track, ranges.stamp, 0.5) for track in real.truth.values()]
    both = np.intersect1d(poses[0][0], poses[1][0])
    a, b = (values[np.searchsorted(found, both)] for found, values, _ in poses)
    error = ranges.range[both] - np.hypot(*(a - b)[:, :2].T)
    assert abs(np.mean(error)) < 0.005
    assert np.std(error) == pytest.approx(real.team.range_sigma, abs=0.002)
    odometry = real.odometry["turtle01"]
    found, pose, _ = interpolate(real.truth["turtle01"], odometry.stamp, 0.5)
    ends = np.arange(0, len(found), 60)
    turn = wrap_angle(np.diff(pose[:, 2]))
    middle = pose[:-1, 2] + 0.5 * turn
    step = np.cos(middle) * np.diff(pose[:, 0]) + np.sin(middle) * np.diff(pose[:, 1])
    odometric = odometry.v[found][1:] * np.diff(odometry.stamp[found]) * 1e-9
    true, odometric = (np.add.reduceat(values, ends[:-1])[:-1] for values in (step, odometric))
    scale = calibration.odometry["turtle01"].scale
    assert (true @ odometric) / (odometric @ odometric) == pytest.approx(scale, abs=0.002)


@pytest.mark.parametrize(("name", "count", "static"), [("test1", 8007, 8), ("test3", 14784, 2)])
def test_real_seven_robots(name, count, static):
    path = CASE4 / f"{name}_0.db3.gz"
    if not path.is_file():
        pytest.skip("case 4 is not here")
    recording = read_tiers(path)
    assert [robot.id for robot in recording.team.robots] == list(range(1, 9))
    assert len(recording.team.static) == static
    assert len(recording.ranges.raw) == count
    assert recording.odometry == {}
    assert len(recording.truth) == 7
    assert [fault.kind for fault in recording.faults] == ["mirrored"]
