from __future__ import annotations

import gzip
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.core.recording import Recording
from clt.importers import IMPORT_FORMATS
from clt.importers.thu_capture import read_capture
from clt.initialization.motion.layout import estimate_layout
from clt.initialization.motion.motion import from_motion
from clt.initialization.pair_distances import mean_distances
from clt.model.settings import FilterSettings

DATA = Path(__file__).parents[3] / "shared" / "data" / "thu_rcl_20190418"
REAL = DATA / "static_20190614_test.txt.gz"


def frame(kind: int, payload: bytes) -> bytes:
    return b"\xa5\x5a" + bytes([len(payload) + 1, kind]) + payload + b"\xdd"


def inertial(ms: int, node: int) -> bytes:
    return frame(1, struct.pack("<IB6h", ms, node, *range(6)))


def wheels(ms: int, node: int, dx: float, dphi: float, interval: int = 50) -> bytes:
    return frame(2, struct.pack("<IBB3f", ms, node, interval, dx, 0.0, dphi))


def measured(ms: int, a: int, b: int, value: float) -> bytes:
    return frame(3, struct.pack("<IBBd", ms, a, b, value))


def capture(path: Path, *frames: bytes) -> Path:
    path.write_bytes(b"".join(frames))
    return path


FRAMES = [
    part
    for k in range(10)
    for part in (
        inertial(1000 + 50 * k, 9),
        wheels(1000 + 50 * k, 4, 0.01 * k, -0.5),
        wheels(1001 + 50 * k, 1, 0.0, 0.0),
        measured(1000 + 50 * k, 0, 4, 0.25 * k - 0.125),
        measured(1000 + 50 * k, 1, 4, 3.0),
    )
]


def test_streams(tmp_path: Path) -> None:
    recording = read_capture(capture(tmp_path / "pc.txt", *FRAMES))
    assert recording.faults == ()
    assert recording.team.names == ("R0", "R1", "R4")
    assert [robot.static for robot in recording.team.robots] == [True, True, False]
    assert {robot.position for robot in recording.team.robots} == {None}
    assert list(recording.odometry) == ["R4"]
    odometry = recording.odometry["R4"]
    assert odometry.stamp[:2].tolist() == [1_000_000_000, 1_050_000_000]
    assert odometry.v == pytest.approx(0.2 * np.arange(10), abs=1e-6)
    assert odometry.omega == pytest.approx(np.full(10, -10.0))
    r = recording.ranges
    first = r.source == 0
    assert r.raw[first] == pytest.approx(0.25 * np.arange(10) - 0.125)
    assert np.array_equal(r.range, r.raw)
    assert r.target.tolist() == [2] * 20
    assert r.sequence[first].tolist() == list(range(10))
    assert r.stamp[:3].tolist() == [1_000_000_000, 1_000_000_000, 1_050_000_000]


def test_gzip_is_the_same(tmp_path: Path) -> None:
    packed = capture(tmp_path / "pc.gz", gzip.compress(b"".join(FRAMES), mtime=0))
    plain = read_capture(capture(tmp_path / "pc.txt", *FRAMES))
    assert np.array_equal(read_capture(packed).ranges.raw, plain.ranges.raw)


def test_stamps_are_sorted(tmp_path: Path) -> None:
    ranges = read_capture(capture(tmp_path / "pc", *FRAMES[::-1])).ranges
    assert np.all(np.diff(ranges.stamp) > -1)
    assert len(ranges.stamp) == 20


def test_mark_inside_a_payload(tmp_path: Path) -> None:
    """What looks like a frame within a frame is its content, were it followed by an end mark."""
    ms = int.from_bytes(b"\xa5\x5a\x0f\x03", "little")
    recording = read_capture(capture(tmp_path / "pc", measured(ms, 0, 1, 2.0), *[FRAMES[0]] * 2))
    assert recording.faults == ()
    assert recording.ranges.stamp.tolist() == [ms * 1_000_000]


def test_resynchronizes_after_damage(tmp_path: Path) -> None:
    cut = measured(1000, 0, 1, 2.0)[:9]
    noise = b"\x00\xa5\xa5\x5a\xff\xdd"
    strange = frame(7, bytes(5))
    parts = [measured(1000, 0, 1, 1.0), cut, measured(1010, 0, 1, 2.0), noise, strange]
    recording = read_capture(capture(tmp_path / "pc", *parts, measured(1020, 0, 1, 3.0), cut))
    assert recording.ranges.raw.tolist() == [1.0, 2.0, 3.0]
    whole = len(parts[0])
    assert [fault.text.split(": ")[1:] for fault in recording.faults] == [
        [f"byte {whole}", "9 bytes are no frame", "skipped"],
        [f"byte {2 * whole + 9}", f"{6 + len(strange)} bytes are no frame", "skipped"],
        [f"byte {3 * whole + 15 + len(strange)}", "9 bytes are no frame", "skipped"],
    ]
    assert all(fault.data_lost and fault.kind == "frame" for fault in recording.faults)


@pytest.mark.parametrize("size", range(1, len(FRAMES[3])))
def test_truncated_at_every_byte(tmp_path: Path, size: int) -> None:
    recording = read_capture(capture(tmp_path / "pc", FRAMES[4], FRAMES[3][:size]))
    assert recording.ranges.raw.tolist() == [3.0]
    assert [f"{size} bytes" in fault.text for fault in recording.faults] == [True]


@pytest.mark.parametrize(
    ("bad", "kind"),
    [
        (measured(5, 0, 1, float("nan")), "range"),
        (measured(5, 1, 1, 2.0), "range"),
        (wheels(5, 1, float("inf"), 0.0), "wheels"),
        (wheels(5, 1, 0.1, 0.0, interval=0), "wheels"),
    ],
)
def test_senseless_content_is_dropped(tmp_path: Path, bad: bytes, kind: str) -> None:
    recording = read_capture(capture(tmp_path / "pc", *FRAMES, bad))
    assert len(recording.ranges.raw) == 20
    assert list(recording.odometry) == ["R4"]
    (fault,) = recording.faults
    assert (fault.kind, fault.count, fault.data_lost) == (kind, 1, True)
    assert f"byte {sum(map(len, FRAMES))}: " in fault.text


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no range and no wheel frame"),
        (b"\xa5", "no range and no wheel frame"),
        (b"\xa5\x5a" * 100, "no range and no wheel frame"),
        (b"some text\n" * 50, "no range and no wheel frame"),
        (inertial(5, 1), "no range and no wheel frame"),
        (gzip.compress(b"".join(FRAMES), mtime=0)[:-30], "damaged gzip"),
        (gzip.compress(b"".join(FRAMES), mtime=0)[:-8] + bytes(8), "damaged gzip"),
        (b"\x1f\x8b" + bytes(50), "damaged gzip"),
        (gzip.compress(b"", mtime=0)[:10] + b"\xff" * 50, "damaged gzip"),
    ],
)
def test_malformed(tmp_path: Path, content: bytes, said: str) -> None:
    with pytest.raises(LogError, match=said) as caught:
        read_capture(capture(tmp_path / "pc", content))
    assert str(tmp_path / "pc") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unreadable(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="nowhere: No such file"):
        read_capture(tmp_path / "nowhere")
    with pytest.raises(LogError, match="is a folder"):
        read_capture(tmp_path)


def test_known_format(tmp_path: Path) -> None:
    path = tmp_path / "nowhere"
    assert IMPORT_FORMATS["thu-capture"].files((path,)) == (path,)
    with pytest.raises(LogError, match="No such file"):
        IMPORT_FORMATS["thu-capture"].read((path,), None)


@pytest.fixture(scope="module")
def real() -> Recording:
    if not REAL.is_file():
        pytest.skip("the Tsinghua data set is not here")
    return read_capture(REAL)


def test_real_capture(real: Recording) -> None:
    """163 s of standstill; its beginning and its end cut a frame."""
    assert [robot.name for robot in real.team.static] == ["R0", "R1", "R2", "R4"]
    assert real.odometry == {}
    assert len(real.ranges.raw) == 97897
    assert np.ptp(real.ranges.stamp) * 1e-9 == pytest.approx(163.16, abs=0.01)
    faults = [fault.text.split(": ", 1)[1] for fault in real.faults]
    assert faults == [
        "byte 44: 34 bytes are no frame: skipped",
        "byte 3446028: 15 bytes are no frame: skipped",
    ]


def test_real_layout(real: Recording) -> None:
    """Six calibrated distances fit four places in the plane to a few centimetres."""
    ranges = replace(real.ranges, range=0.9567 * real.ranges.raw + 0.6245)
    recording, settings = replace(real, ranges=ranges), FilterSettings()
    span = int(ranges.stamp[0]) - 1, int(ranges.stamp[-1])
    pairs = mean_distances(recording, range(4), *span, settings.noise)
    assert pairs.distance == pytest.approx([0.487, 1.424, 0.958, 1.616, 0.475, 1.476], abs=0.002)
    found = estimate_layout(pairs, 4, {})
    assert found.used.all()
    assert float(np.sqrt(np.mean(found.residual**2))) < 0.03
    start = from_motion(recording, settings).robots
    for i, robot in enumerate(start.values()):
        assert robot.pose is not None
        assert robot.pose.mean[:2] == pytest.approx(found.position[i])
