"""Columns of a CSV file, plain or gzip, whose first column is a time in seconds."""

from __future__ import annotations

import csv
import gzip
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import TextIOWrapper
from pathlib import Path
from typing import TextIO

import numpy as np

from clt.core.errors import LogError
from clt.core.recording import Floats, Stamps
from clt.log.faults import Faults
from clt.log.recording import cleaning

SECONDS_PATTERN = re.compile(r"\s*(\d{1,10})(?:\.(\d*))?\s*", re.ASCII)
"""Read digit by digit: a float has no room for nanoseconds."""
ROS_TIME_END_S = 1 << 31
"""The first second that is not ROS 2 time."""


@dataclass(frozen=True)
class CsvTable:
    """Sound rows in the order of their stamps, each stamp once."""

    stamp: Stamps
    columns: Mapping[str, Floats]


def read_csv_table(path: Path, time: str, names: Sequence[str], faults: Faults) -> CsvTable:
    """The named columns of a file with a head line; unusable rows are faults, and dropped.

    Raises:
        LogError: for a file that cannot be read, lacks a column or has no sound row.
    """
    try:
        with _open_text(path) as file:
            rows = csv.reader(file)
            head = [name.strip() for name in next(rows, [])]
            missing = [name for name in (time, *names) if name not in head]
            if len(missing) > 0:
                raise LogError(f"{path}: no column `{missing[0]}`; it has: {', '.join(head)}")
            place = [head.index(name) for name in names]
            parsed = [_parse_row(row, head.index(time), place) for row in rows if len(row) > 0]
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path}: a damaged gzip file: {error}") from None
    except (csv.Error, UnicodeDecodeError) as error:
        raise LogError(f"{path}: not a CSV file: {error}") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    stamp = np.array([at for at, _ in parsed], np.int64)
    values = np.array([row for _, row in parsed]).reshape(-1, len(names))
    kept = np.flatnonzero(
        cleaning.drop_rows(faults, path.name, "row", stamp < 0, "rows are not a time and numbers")
    )
    kept = kept[cleaning.usable_rows(faults, path.name, np.ones(len(kept), np.bool_), values[kept])]
    kept = kept[cleaning.sorted_rows(faults, path.name, stamp[kept])]
    kept = kept[cleaning.first_of_each_stamp(faults, path.name, stamp[kept])]
    if len(kept) == 0:
        raise LogError(f"{path}: no row with a time and {len(names)} number(s)")
    return CsvTable(stamp[kept], dict(zip(names, values[kept].T, strict=True)))


@contextmanager
def _open_text(path: Path) -> Iterator[TextIO]:
    with path.open("rb") as file:
        packed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        with TextIOWrapper(gzip.open(file) if packed else file, "utf-8", newline="") as text:
            yield text


def _parse_row(row: Sequence[str], time: int, place: Sequence[int]) -> tuple[int, list[float]]:
    """Stamp in ns and values; stamp -1 for a row that holds anything else."""
    try:
        seconds, rest = SECONDS_PATTERN.fullmatch(row[time]).groups()  # type: ignore[union-attr]
        values = [float(row[column]) for column in place]
    except (AttributeError, IndexError, ValueError):
        return -1, [0.0] * len(place)
    if int(seconds) >= ROS_TIME_END_S:
        return -1, values
    return int(seconds) * 1_000_000_000 + int((rest or "")[:9].ljust(9, "0")), values
