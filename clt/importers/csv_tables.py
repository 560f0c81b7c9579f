"""Tables of one's own: CSV files with a head line, plain or gzip, recognized by their columns.

| columns | what it is |
|---|---|
| `time`, `source`, `target`, `range`, perhaps `sigma` | ranges (m) between robots by name |
| `time`, `v`, `omega`, perhaps `robot`, `sigma_v`, `sigma_omega` | odometry (m/s, rad/s) |
| `time`, `x`, `y`, perhaps `robot`, `heading` | ground truth (m, rad) |
| `robot`, no `time`, perhaps `x`, `y`, `id` | static robots; empty cells: position unknown |

Times are seconds (`t`, `timestamp` and `stamp` will do), the odometry the mean over the interval
that ends at its stamp. Without a column `robot` the file's name says whose it is: `R1.csv`,
`R1.odometry.csv`, or NAME=PATH. Poses go to the stream of that name in `ROBOT.STREAM.csv`
(`ground_truth`, `estimate`, `dead_reckoning`). Other columns are left. Robots that no table calls
static move. Nothing says when a sample reached the recorder, so log_time = stamp.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.errors import LogError
from clt.core.recording import (
    WORLD_FRAME,
    Odometry,
    Poses,
    Ranges,
    Recording,
    Robot,
    Team,
    no_ranges,
)
from clt.importers.columns import RawRanges, sorted_ranges, truth_of_static
from clt.importers.csv_rows import CsvRows, CsvSpec, read_csv_rows
from clt.importers.named import POSE_STREAMS, NamedFile, named_files
from clt.log.faults import Faults
from clt.log.recording import cleaning

Stream = TypeVar("Stream", Odometry, Poses)

CSV_ENDS = (".csv",)
CSV_SPECS = {
    "ranges": CsvSpec(("source", "target"), ("range",), ("sigma",)),
    "odometry": CsvSpec((), ("v", "omega"), ("sigma_v", "sigma_omega"), robot=True),
    "poses": CsvSpec((), ("x", "y"), ("heading",), robot=True),
    "static": CsvSpec(("robot",), (), ("x", "y", "id"), timed=False),
}
"""By what they hold; the first whose columns are there counts."""


def csv_files(paths: Sequence[Path]) -> tuple[Path, ...]:
    """The files that the paths stand for; of a folder every `.csv`."""
    return tuple(file.path for file in named_files(paths, CSV_ENDS))


def read_csv_tables(paths: Sequence[Path]) -> Recording:
    """Read the tables of one run.

    Raises:
        LogError: naming the file, and the line or column that is wrong.
    """
    files = named_files(paths, CSV_ENDS)
    faults = Faults(str(files[0].path.parent))
    tables = [(file, *read_csv_rows(file.path, file.robot, CSV_SPECS, faults)) for file in files]
    odometry: dict[str, Odometry] = {}
    streams: dict[str, dict[str, Poses]] = {stream: {} for stream in POSE_STREAMS}
    for file, kind, rows in tables:
        if kind == "odometry":
            _add(odometry, _odometry(rows, file.path, faults), file.path)
        elif kind == "poses":
            stream = file.stream or POSE_STREAMS[0]
            _add(streams[stream], _poses(file, rows, stream, faults), file.path)
    ranged = [rows for _, kind, rows in tables if kind == "ranges"]
    static = _static([(file.path, rows) for file, kind, rows in tables if kind == "static"])
    ends = {name for rows in ranged for column in rows.names for name in column}
    moving = sorted({*odometry, *(n for held in streams.values() for n in held), *ends} - {*static})
    team = _team(moving, static, files[0].path)
    return Recording(
        team=team,
        odometry=odometry,
        ranges=_ranges(ranged, team, faults),
        truth={**truth_of_static(team.robots, streams["ground_truth"]), **streams["ground_truth"]},
        estimate=streams["estimate"],
        dead_reckoning=streams["dead_reckoning"],
        faults=faults.all(),
    )


def _add(held: dict[str, Stream], new: Mapping[str, Stream], path: Path) -> None:
    for name, stream in new.items():
        if name in held:
            raise LogError(f"{path}: a second table of the same kind for {name}")
        held[name] = stream


def _rows_of_robots(rows: CsvRows, path: Path, faults: Faults) -> dict[str, Indices]:
    """Row numbers by robot, each stamp of one once."""
    owner = np.array(rows.names[0], np.object_)
    found = {}
    for name in sorted(set(rows.names[0])):
        own = np.flatnonzero(owner == name)
        keep = cleaning.first_of_each_stamp(faults, path.name, rows.stamp[own])
        found[name] = own[keep]
    return found


def _positive(values: Floats) -> Floats:
    """Standard deviations; NaN where none is stated."""
    return np.where(np.isfinite(values) & (values > 0.0), values, np.nan)


def _odometry(rows: CsvRows, path: Path, faults: Faults) -> dict[str, Odometry]:
    found = {}
    for name, own in _rows_of_robots(rows, path, faults).items():
        stamp, (v, omega, *noise) = rows.stamp[own], rows.values[own].T
        sigma_v, sigma_omega = map(_positive, noise)
        found[name] = Odometry(stamp, stamp, v, omega, sigma_v, sigma_omega)
    return found


def _poses(file: NamedFile, rows: CsvRows, stream: str, faults: Faults) -> dict[str, Poses]:
    found = {}
    for name, own in _rows_of_robots(rows, file.path, faults).items():
        x, y, heading = rows.values[own].T
        if stream != POSE_STREAMS[0] and not np.all(np.isfinite(heading)):
            raise LogError(f"{file.path}: the {stream} of {name} needs a `heading` in every row")
        found[name] = Poses(WORLD_FRAME, rows.stamp[own], rows.stamp[own], x, y, heading)
    return found


def _static(tables: Sequence[tuple[Path, CsvRows]]) -> dict[str, tuple[float, float, float]]:
    """x, y and id of static robots, NaN where a cell is empty. Raises LogError for one twice."""
    found: dict[str, tuple[float, float, float]] = {}
    for path, rows in tables:
        for name, (x, y, number) in zip(rows.names[0], rows.values.tolist(), strict=True):
            if name in found:
                raise LogError(f"{path}: {name} is there twice")
            if np.isfinite(x) != np.isfinite(y):
                raise LogError(f"{path}: {name} has one of x and y; give both, or none")
            if np.isfinite(number) and (number != round(number) or not 0 <= number < 1 << 16):
                raise LogError(f"{path}: {name}: {number:g} is no id, 0 to 65535")
            found[name] = (x, y, number)
    return found


def _team(
    moving: Sequence[str], static: Mapping[str, tuple[float, float, float]], path: Path
) -> Team:
    """Static robots keep the ids of their table; the others take the lowest free ones."""
    given = [int(number) for _, _, number in static.values() if np.isfinite(number)]
    if len(set(given)) < len(given):
        raise LogError(f"{path}: two static robots share one id")
    free = (number for number in range(1, 1 << 16) if number not in given)
    robots = [Robot(name, next(free)) for name in moving]
    robots += [
        Robot(
            name,
            int(number) if np.isfinite(number) else next(free),
            static=True,
            position=(x, y) if np.isfinite(x) else None,
        )
        for name, (x, y, number) in static.items()
    ]
    return Team(tuple(robots))


def _ranges(tables: Sequence[CsvRows], team: Team, faults: Faults) -> Ranges:
    if len(tables) == 0:
        return no_ranges()
    index = {name: row for row, name in enumerate(team.names)}
    parts = []
    for rows in tables:
        source, target = (
            np.array([index[name] for name in column], np.int64) for column in rows.names
        )
        raw, sigma = rows.values.T
        parts.append(RawRanges(rows.stamp, source, target, raw, _positive(sigma)))
    return sorted_ranges(
        RawRanges(*(np.concatenate(column) for column in zip(*parts, strict=True))),
        len(team.robots),
        faults,
    )
