from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from clt.core.errors import LogError
from clt.core.recording import Recording
from clt.importers import IMPORT_FORMATS
from clt.importers.thu import MAT_FILE, SURVEY_FILE, read_thu

REAL = Path(__file__).parents[3] / "shared" / "data" / "thu_rcl_20190418"
# Its other text is GBK; the words are "anchor" and "start".
ANCHORS = b"\xc3\xaa\xb5\xe3\xa3\xbaID0\r\n2.5,-0.75\r\n\xc3\xaa\xb5\xe3\xa3\xbaID2\r\n"
TEXT = ANCHORS + b"   0.5,  -1.25\r\n\xb3\xf5\xca\xbc\xa3\xba0-4\xa3\xba257cm\xa3\xbbID9\r\n"


def content() -> dict[str, Any]:
    """Robots 1 and 4 driving, nodes 0 and 2 standing; 20 Hz odometry, 2 Hz truth, 100 Hz ranges."""
    odometry, truth, radio = np.arange(40) / 20.0, np.arange(4) / 2.0 + 0.1, np.arange(200) / 100.0
    robots = [
        {
            "id": np.uint8(node),
            "t_m": (100.0 + odometry)[:, None],
            "v_m": (0.1 * node + 0.0 * odometry)[:, None],
            "omega_m": np.sin(odometry)[:, None],
            "t": (100.0 + truth)[:, None],
            "x": truth[:, None] + node,
            "y": -truth[:, None],
            "phi": 0.5 * truth[:, None],
        }
        for node in (1, 4)
    ]
    pairs = [(0, 1), (0, 2), (0, 4), (1, 2), (1, 4), (2, 4)]
    ranges = [
        {
            "pair": np.array([pair], np.uint8),
            "t": (100.0 + radio)[:, None],
            "range": (10.0 * pair[0] + pair[1] + radio)[:, None],
        }
        for pair in pairs
    ]
    return {"range_m": ranges, "robot": robots}


def structs(entries: Any) -> Any:
    """A list of dictionaries as a MATLAB array of structs; anything else as it is."""
    if not isinstance(entries, list):
        return entries
    array = np.empty(len(entries), [(name, object) for name in entries[0]])
    for k, entry in enumerate(entries):
        array[k] = tuple(entry.values())
    return array


def write(folder: Path, data: dict[str, Any], text: bytes | None = TEXT) -> Path:
    savemat(folder / MAT_FILE, {name: structs(value) for name, value in data.items()})
    if text is not None:
        (folder / SURVEY_FILE).write_bytes(text)
    return folder


def test_streams(tmp_path: Path) -> None:
    recording = read_thu(write(tmp_path, content()))
    team = recording.team
    assert team.names == ("R0", "R1", "R2", "R4")
    assert [robot.id for robot in team.robots] == [0, 1, 2, 4]
    assert [robot.position for robot in team.robots] == [(2.5, -0.75), None, (0.5, -1.25), None]
    assert [robot.name for robot in team.static] == ["R0", "R2"]
    assert {robot.twist for robot in team.robots} == {"mean"}
    odometry, truth = recording.odometry["R4"], recording.truth["R4"]
    assert list(recording.odometry) == ["R1", "R4"]
    assert list(recording.truth) == ["R0", "R2", "R1", "R4"]
    assert np.isnan(recording.truth["R0"].heading).all()
    assert odometry.stamp[:3].tolist() == [100_000_000_000, 100_050_000_000, 100_100_000_000]
    assert np.array_equal(odometry.v, np.full(40, 0.4))
    assert odometry.omega == pytest.approx(np.sin(np.arange(40) / 20.0))
    assert truth.frame == "world"
    assert truth.stamp[0] == 100_100_000_000
    assert truth.x == pytest.approx([4.1, 4.6, 5.1, 5.6])
    assert truth.heading == pytest.approx([0.05, 0.3, 0.55, 0.8])


def test_ranges(tmp_path: Path) -> None:
    r = read_thu(write(tmp_path, content())).ranges
    assert len(r.raw) == 1200
    assert np.all(np.diff(r.stamp) >= 0)
    ids = np.array([0, 1, 2, 4])
    expected = 10.0 * ids[r.source] + ids[r.target] + (r.stamp - 100_000_000_000) * 1e-9
    assert r.raw == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(r.range, r.raw)
    assert np.all(np.isnan(r.sigma))
    for source, target in ((0, 1), (2, 3)):
        mine = (r.source == source) & (r.target == target)
        assert np.array_equal(r.sequence[mine], np.arange(200))


def test_file_instead_of_folder(tmp_path: Path) -> None:
    folder = write(tmp_path, content())
    assert read_thu(folder / MAT_FILE).team == read_thu(folder).team


def test_columns_are_sorted_by_time(tmp_path: Path) -> None:
    data = content()
    for name in ("t_m", "v_m", "omega_m"):
        data["robot"][0][name] = data["robot"][0][name][::-1]
    shuffled = read_thu(write(tmp_path, data)).odometry["R1"]
    assert np.all(np.diff(shuffled.stamp) > 0)
    assert shuffled.omega == pytest.approx(np.sin(np.arange(40) / 20.0))


def without(entry: str, name: str) -> Callable[[dict[str, Any]], None]:
    """Take one field away from all entries (a struct array has one set of fields)."""

    def spoil(data: dict[str, Any]) -> None:
        for item in data[entry]:
            del item[name]

    return spoil


def replaced(entry: str, k: int, name: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def spoil(data: dict[str, Any]) -> None:
        data[entry][k][name] = value

    return spoil


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda data: data.pop("robot"), "no `robot` in it"),
        (lambda data: data.update(range_m=np.arange(3)), "`range_m` is not an array of structs"),
        (without("robot", "phi"), "robot 1: no field `phi`"),
        (without("range_m", "range"), "range_m of pair 0-1: no field `range`"),
        (replaced("robot", 1, "v_m", np.zeros(3)), "robot 4: fields differ in length: t_m 40, v_m"),
        (replaced("robot", 1, "x", np.full(4, np.nan)), "robot 4: `x` holds values that are not"),
        (replaced("robot", 1, "x", "text"), "robot 4: `x` is not numeric"),
        (replaced("robot", 1, "id", 1), "two entries of `robot` share one id"),
        (replaced("robot", 1, "id", 1.5), "`id` should hold 1 id(s)"),
        (replaced("range_m", 2, "pair", [0, 1, 2]), "`pair` should hold 2 id(s)"),
        (replaced("range_m", 2, "pair", [4, 4]), "from a node to itself"),
        (replaced("range_m", 2, "pair", [4, 7]), "Data1.txt: no position of node 7"),
    ],
)
def test_malformed_mat(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], object], said: str
) -> None:
    data = content()
    spoil(data)
    with pytest.raises(LogError) as caught:
        read_thu(write(tmp_path, data))
    message = str(caught.value)
    assert said in message
    assert str(tmp_path) in message
    assert "\n" not in message


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: b"not a MATLAB file" * 50,
        lambda data: data[: len(data) // 2],
        lambda data: data[:200] + bytes(64) + data[264:],
    ],
)
def test_damaged_mat(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path = write(tmp_path, content()) / MAT_FILE
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(LogError, match=MAT_FILE):
        read_thu(tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, "No such file"),
        (b"", "no position of node 0"),
        (b"ID0\r\n1.0.0,2.0\r\nID2\r\n0,0\r\n", "not two numbers"),
    ],
)
def test_bad_survey(tmp_path: Path, text: bytes | None, said: str) -> None:
    with pytest.raises(LogError, match=said) as caught:
        read_thu(write(tmp_path, content(), text))
    assert SURVEY_FILE in str(caught.value)


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="nowhere: No such file"):
        read_thu(tmp_path / "nowhere")


def test_known_format(tmp_path: Path) -> None:
    path = tmp_path / MAT_FILE
    assert IMPORT_FORMATS["thu"].files((tmp_path,)) == (path, tmp_path / SURVEY_FILE)
    with pytest.raises(LogError, match="No such file"):
        IMPORT_FORMATS["thu"].read((path,), None)


@pytest.fixture(scope="module")
def real() -> Recording:
    if not REAL.is_dir():
        pytest.skip("the Tsinghua data set is not here")
    return read_thu(REAL)


def test_real_run(real: Recording) -> None:
    assert real.team.names == ("R0", "R1", "R2", "R4")
    assert real.team.robots[0].position == (2.5305, -0.80421)
    assert real.team.robots[2].position == (0.4084, -1.20842)
    assert len(real.ranges.raw) == 4 * 34662 + 2 * 34663
    assert [len(real.odometry[name].v) for name in ("R1", "R4")] == [6932, 6924]
    assert [len(real.truth[name].x) for name in ("R1", "R4")] == [666, 663]
    for stream in (real.ranges, *real.odometry.values(), *real.truth.values()):
        assert np.all(np.diff(stream.stamp) >= 0)
        seconds = stream.stamp * 1e-9
        assert 3622.0 < seconds[0] < 3628.0
        assert 3956.0 < seconds[-1] < 3969.0


def test_real_ranges_read_short(real: Recording) -> None:
    """The calibration that the data set's users found leaves residuals of 5 cm and no mean."""
    r = real.ranges
    mutual = (r.source == 1) & (r.target == 3)
    t = r.stamp[mutual]
    a, b = real.truth["R1"], real.truth["R4"]
    covered = (t > max(a.stamp[0], b.stamp[0])) & (t < min(a.stamp[-1], b.stamp[-1]))
    x = np.interp(t, a.stamp, a.x) - np.interp(t, b.stamp, b.x)
    y = np.interp(t, a.stamp, a.y) - np.interp(t, b.stamp, b.y)
    residual = (0.9567 * r.raw[mutual] + 0.6245 - np.hypot(x, y))[covered]
    assert abs(np.mean(residual)) < 0.02
    assert np.std(residual) < 0.05
