"""Rows of a CSV table with times, names and numbers, recognized by its head line."""

from __future__ import annotations

import csv
import sys
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.importers.textfile import open_text, parse_stamp, report_lines
from clt.log.faults import Faults
from clt.log.recording import cleaning
from clt.log.recording.metadata import ROBOT_NAME_PATTERN

TIME_COLUMNS = ("time", "t", "timestamp", "stamp")
ROBOT_COLUMN = "robot"


class CsvSpec(NamedTuple):
    """Columns of one kind of table."""

    names: tuple[str, ...]
    """Columns that hold names of robots."""
    numbers: tuple[str, ...]
    """Columns that hold finite numbers."""
    perhaps: tuple[str, ...]
    """Columns of numbers that may be missing or empty."""
    timed: bool = True
    robot: bool = False
    """It is about one robot in each row, or as a whole."""


class CsvRows(NamedTuple):
    """Usable rows, in the order of their stamps."""

    stamp: Stamps
    """ns; zeros for a table without times."""
    names: tuple[list[str], ...]
    """Each column of names."""
    values: Floats
    """`numbers` and `perhaps` of the spec, NaN where there is none, shape (n, width)."""


class _Place(NamedTuple):
    """Where the columns stand; -1 for one that is missing."""

    time: int
    names: tuple[int, ...]
    numbers: tuple[int, ...]
    perhaps: tuple[int, ...]


def read_csv_rows(
    path: Path, owner: str | None, specs: Mapping[str, CsvSpec], faults: Faults
) -> tuple[str, CsvRows]:
    """The kind of a table, a key of `specs`, and its rows. `owner` has those without a name.

    Unusable rows are faults that name the first line, and dropped. Raises LogError for a file that
    cannot be read, whose columns fit no kind, or without any usable row.
    """
    stamps, values, wrong = array("q"), array("d"), array("q")
    columns: list[list[str]] = []
    with open_text(path) as file:
        rows = csv.reader(file)
        try:
            head = [name.strip() for name in next(rows, [])]
            kind, place = _recognize(head, path, specs, owner)
            spec = specs[kind]
            columns = [[] for _ in place.names] or [[]]
            for row in rows:
                if len(row) == 0:
                    continue
                found = _parse(row, place)
                if found is None:
                    wrong.append(rows.line_num)
                    continue
                at, names, numbers = found
                stamps.append(at)
                values.extend(numbers)
                for column, name in zip(columns, names or (owner or "",), strict=True):
                    column.append(sys.intern(name))
        except csv.Error as error:
            raise LogError(f"{path}: line {rows.line_num}: not CSV: {error}") from None
    expected = ", ".join((*(("time",) if spec.timed else ()), *spec.names, *spec.numbers))
    report_lines(faults, path, wrong, f"without {expected}")
    table = np.array(values).reshape(-1, len(spec.numbers) + len(spec.perhaps))
    stamp = np.array(stamps, np.int64)
    sane = table[:, : len(spec.numbers)]
    kept = cleaning.usable_rows(faults, path.name, np.ones(len(stamp), np.bool_), sane)
    if spec.timed:
        kept = kept[cleaning.sorted_rows(faults, path.name, stamp[kept])]
    if len(kept) == 0:
        raise LogError(f"{path}: no row with {expected}")
    chosen = tuple([column[row] for row in kept.tolist()] for column in columns)
    return kind, CsvRows(stamp[kept], chosen, table[kept])


def _recognize(
    head: Sequence[str], path: Path, specs: Mapping[str, CsvSpec], owner: str | None
) -> tuple[str, _Place]:
    """The first kind whose columns are all there. Raises LogError where none is."""
    where = {name: column for column, name in reversed(list(enumerate(head)))}
    time = next((where[name] for name in TIME_COLUMNS if name in where), -1)
    for kind, spec in specs.items():
        if spec.timed != (time >= 0) or any(n not in where for n in (*spec.names, *spec.numbers)):
            continue
        names = tuple(where[name] for name in spec.names)
        if spec.robot and ROBOT_COLUMN in where:
            names = (where[ROBOT_COLUMN],)
        elif spec.robot and owner is None:
            raise LogError(
                f"{path}: whose is it? give a column `{ROBOT_COLUMN}`, or the file as NAME={path}"
            )
        perhaps = tuple(where.get(name, -1) for name in spec.perhaps)
        return kind, _Place(time, names, tuple(where[name] for name in spec.numbers), perhaps)
    wanted = "; ".join(
        ",".join((*(("time",) if spec.timed else ()), *spec.names, *spec.numbers))
        for spec in specs.values()
    )
    raise LogError(f"{path}: line 1: its columns ({', '.join(head)}) fit no table: {wanted}")


def _parse(row: Sequence[str], place: _Place) -> tuple[int, list[str], list[float]] | None:
    """Stamp (ns), names and numbers of a row; None for one that does not hold them."""
    try:
        stamp = parse_stamp(row[place.time].strip()) if place.time >= 0 else 0
        names = [row[column].strip() for column in place.names]
        values = [float(row[column]) for column in place.numbers]
        for column in place.perhaps:
            cell = row[column].strip() if 0 <= column < len(row) else ""
            values.append(float(cell) if cell != "" else float("nan"))
    except (IndexError, ValueError):
        return None
    if stamp is None or any(ROBOT_NAME_PATTERN.fullmatch(name) is None for name in names):
        return None
    return stamp, names, values
