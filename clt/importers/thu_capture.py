"""The binary stream of the Tsinghua radios (range_only_CL, 2019): inertial, wheels, ranges.

A capture, plain or gzip, is a row of frames, little endian: A5 5A, length, type, payload, DD; the
length counts type and payload. Every payload begins with u32 ms and u8 id:

- 1, inertial: 6 x i16; not imported;
- 2, wheels: u8 interval (ms), f32 dx, dy (m), dphi (rad) over the interval that ends at the stamp;
- 3, range: u8 id of the other radio, f64 m, as the radio gave it (it reads about 0.58 m short).

There is no checksum. What is no frame of these types with its length and end mark is skipped up to
the next one that is, and reported with its byte. Robots are named R<id>; whose wheels never turn,
or who has none, is static, its position unknown. Wheels do not slip sideways: dy is not imported.
"""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Bytes, Stamps
from clt.core.errors import LogError
from clt.core.recording import Odometry, Ranges, Recording, Robot, Team
from clt.log.faults import Faults

GZIP_MAGIC = b"\x1f\x8b"
FRAME_START, FRAME_END = b"\xa5\x5a", 0xDD
FRAME_HEAD_BYTES = 4
"""Bytes of a frame before its payload."""
INERTIAL_FRAME, WHEELS_FRAME, RANGE_FRAME = 1, 2, 3
FRAME_LENGTHS = {INERTIAL_FRAME: 18, WHEELS_FRAME: 19, RANGE_FRAME: 15}
"""What the length byte of every type says."""
WHEELS_DTYPE = np.dtype(
    [("ms", "<u4"), ("id", "u1"), ("interval", "u1"), ("dx", "<f4"), ("dy", "<f4"), ("dphi", "<f4")]
)
RANGE_DTYPE = np.dtype([("ms", "<u4"), ("id", "u1"), ("other", "u1"), ("range", "<f8")])

StructuredRows = NDArray[np.void]


def capture_files(path: Path) -> tuple[Path]:
    """The capture itself."""
    return (path,)


def read_capture(path: Path) -> Recording:
    """Read a capture.

    Raises:
        LogError: for a file that cannot be read or holds neither ranges nor turns of wheels.
    """
    data = np.frombuffer(_content(path), np.uint8)
    faults = Faults(str(path))
    at = _frame_starts(data, faults)
    kind = data[at + 3]
    wheels = _payloads(data, at[kind == WHEELS_FRAME], WHEELS_DTYPE)
    ranges = _payloads(data, at[kind == RANGE_FRAME], RANGE_DTYPE)
    twist = np.stack([wheels["dx"], wheels["dy"], wheels["dphi"]], axis=-1)
    sound = np.isfinite(twist).all(axis=1) & (wheels["interval"] > 0)
    _report_dropped(
        faults, "wheels", at[kind == WHEELS_FRAME], ~sound, "not finite, or over no time"
    )
    wheels, twist = wheels[sound], twist[sound]
    sound = np.isfinite(ranges["range"]) & (ranges["id"] != ranges["other"])
    _report_dropped(
        faults, "range", at[kind == RANGE_FRAME], ~sound, "not finite, or of a radio to itself"
    )
    ranges = ranges[sound]
    if len(wheels) + len(ranges) == 0:
        raise LogError(f"{path}: no range and no wheel frame of the Tsinghua radios in it")
    moving = set(wheels["id"][twist.any(axis=1)].tolist())
    ids = sorted({*wheels["id"].tolist(), *ranges["id"].tolist(), *ranges["other"].tolist()})
    return Recording(
        team=Team(tuple(Robot(f"R{i}", i, static=i not in moving) for i in ids)),
        odometry={f"R{i}": _odometry(wheels[wheels["id"] == i]) for i in sorted(moving)},
        ranges=_ranges(ranges, ids),
        faults=faults.all(),
    )


def _content(path: Path) -> bytes:
    try:
        data = path.read_bytes()
        return gzip.decompress(data) if data.startswith(GZIP_MAGIC) else data
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path}: a damaged gzip file: {error}") from None
    except IsADirectoryError:
        raise LogError(f"{path}: is a folder; give the capture in it") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


def _frame_starts(data: Bytes, faults: Faults) -> Stamps:
    """Where sound frames begin, shape (n,); what lies between them is a fault."""
    size = len(data)
    at = np.flatnonzero((data[:-1] == FRAME_START[0]) & (data[1:] == FRAME_START[1]))
    at = at[at + FRAME_HEAD_BYTES < size]
    length = np.zeros(256, np.int64)
    length[list(FRAME_LENGTHS)] = list(FRAME_LENGTHS.values())
    expected = length[data[at + 3]]
    end = at + 3 + expected
    sound = (data[at + 2] == expected) & (expected > 0) & (end < size)
    sound &= data[np.minimum(end, size - 1)] == FRAME_END
    kept, free = [], 0
    for begin, stop in zip(at[sound].tolist(), (end[sound] + 1).tolist(), strict=True):
        if begin < free:
            continue  # the mark stands in a payload
        _report_skipped(faults, free, begin)
        kept.append(begin)
        free = stop
    _report_skipped(faults, free, size)
    return np.array(kept, np.int64)


def _report_skipped(faults: Faults, begin: int, end: int) -> None:
    if end > begin:
        text = f"{end - begin} bytes are no frame: skipped"
        faults.add("frame", f"byte {begin}", text, lost=True)


def _report_dropped(
    faults: Faults, name: str, at: Stamps, wrong: NDArray[np.bool_], text: str
) -> None:
    """Report frames whose content makes no sense."""
    for byte in at[wrong].tolist():
        faults.add(name, f"byte {byte}", f"{text}: dropped", lost=True)


def _payloads(data: Bytes, at: Stamps, layout: np.dtype[np.void]) -> StructuredRows:
    """Payloads of the frames that begin `at`, in that order."""
    taken = data[at[:, None] + FRAME_HEAD_BYTES + np.arange(layout.itemsize)]
    return np.ascontiguousarray(taken).view(layout).reshape(len(at))


def _sorted(rows: StructuredRows) -> tuple[StructuredRows, Stamps]:
    """Rows by time, and their stamps in ns."""
    rows = rows[np.argsort(rows["ms"], kind="stable")]
    return rows, rows["ms"].astype(np.int64) * 1_000_000


def _odometry(rows: StructuredRows) -> Odometry:
    rows, stamp = _sorted(rows)
    seconds, unknown = rows["interval"] * 1e-3, np.full(len(rows), np.nan)
    v, omega = rows["dx"] / seconds, rows["dphi"] / seconds
    return Odometry(stamp, stamp, v, omega, sigma_v=unknown, sigma_omega=unknown)


def _ranges(rows: StructuredRows, ids: list[int]) -> Ranges:
    """Uncalibrated, so `range` is `raw`; the sequence counts each ordered pair."""
    rows, stamp = _sorted(rows)
    source, target = (np.searchsorted(ids, rows[end]).astype(np.int64) for end in ("id", "other"))
    pair, sequence = source * len(ids) + target, np.zeros(len(rows), np.int64)
    for one in np.unique(pair):
        mine = pair == one
        sequence[mine] = np.arange(np.count_nonzero(mine))
    raw = rows["range"].astype(np.float64)
    return Ranges(stamp, stamp, source, target, raw, raw, np.full(len(raw), np.nan), sequence)
