"""Columns of a CSV file, plain or gzip, whose first column is a time in seconds."""

from __future__ import annotations

import csv
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.importers.textfile import open_text, parse_stamp
from clt.log.faults import Faults
from clt.log.recording import cleaning


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
    stamps, flat = array("q"), array("d")
    with open_text(path) as file:
        rows = csv.reader(file)
        try:
            head = [name.strip() for name in next(rows, [])]
            missing = [name for name in (time, *names) if name not in head]
            if len(missing) > 0:
                raise LogError(f"{path}: no column `{missing[0]}`; it has: {', '.join(head)}")
            place = [head.index(name) for name in names]
            for row in rows:
                if len(row) > 0:
                    at, numbers = _parse_row(row, head.index(time), place)
                    stamps.append(at)
                    flat.extend(numbers)
        except csv.Error as error:
            raise LogError(f"{path}: not a CSV file: {error}") from None
    stamp = np.array(stamps, np.int64)
    values = np.array(flat).reshape(-1, len(names))
    kept = np.flatnonzero(
        cleaning.drop_rows(faults, path.name, "row", stamp < 0, "rows are not a time and numbers")
    )
    kept = kept[cleaning.usable_rows(faults, path.name, np.ones(len(kept), np.bool_), values[kept])]
    kept = kept[cleaning.sorted_rows(faults, path.name, stamp[kept])]
    kept = kept[cleaning.first_of_each_stamp(faults, path.name, stamp[kept])]
    if len(kept) == 0:
        raise LogError(f"{path}: no row with a time and {len(names)} number(s)")
    return CsvTable(stamp[kept], dict(zip(names, values[kept].T, strict=True)))


def _parse_row(row: Sequence[str], time: int, place: Sequence[int]) -> tuple[int, list[float]]:
    """Stamp in ns and values; stamp -1 for a row that holds anything else."""
    try:
        stamp = parse_stamp(row[time].strip())
        values = [float(row[column]) for column in place]
    except (IndexError, ValueError):
        return -1, [0.0] * len(place)
    return -1 if stamp is None else stamp, values
