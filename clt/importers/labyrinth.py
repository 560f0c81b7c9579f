"""TU Chemnitz "Labyrinth" (libRSF): one small robot, four UWB anchors, positions as truth.

One text file of the whole run (`Data_Indoor_UWB.txt`), or `..._Input.txt` with `..._GT.txt` beside
it, plain or gzip; of a folder the whole run, else the only input. Seconds from the start, metres:

- `range2 t range sigma x y id`: one anchor and its position; the newer form has the variance in
  place of sigma and one more column;
- `odom2diff t w1 w2 vy b s1 s2 s3`: wheel speeds (m/s), deviations, or variances in the newer form;
- `gt2` or `point2`, t x y: truth.

Nothing says when a sample reached the recorder, so log_time = stamp. Against what the data set
says of itself, w1 is the LEFT wheel and b HALF the track: v = (w1 + w2) / 2,
omega = (w2 - w1) / (2 b), the mean over the interval that ends at the stamp, as its authors use it.

The truth has no heading. Where the robot drives straight it is the course over ground, turned by pi
where the wheels run backwards; elsewhere it is unknown. Ranges are as published (they read 0.12 m
long). The robot is `robot`, anchors are A<id>, static.
"""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.columns import RawRanges, run_notes, sorted_ranges, truth_of_static
from clt.importers.textfile import parse_floats, parse_stamp, read_words
from clt.log.faults import Faults
from clt.log.recording import cleaning

WHOLE_RUN = ("Data_Indoor_UWB.txt", "Data_Indoor_UWB.txt.gz")
INPUT_END, TRUTH_END = "_Input.txt", "_GT.txt"
LINE_WIDTHS = {"range2": 6, "odom2diff": 8, "gt2": 3, "point2": 3}
"""Numbers that a line has at least, time included."""
VARIANCE_FORM_WIDTH = 7
"""Numbers of a `range2` that states a variance."""
MAX_ANCHOR_SHIFT = 1e-3
"""Two positions of one anchor are as far apart at most, m."""
COURSE_ROWS = 2
"""The course over ground is taken over as many rows of the truth on both sides."""
MIN_COURSE_SPEED = 0.2
"""It is the heading where the robot is as fast on both sides, m/s."""
MAX_COURSE_S = 1.5
"""And where these rows span no more, s,"""
MAX_COURSE_TURN = 0.5
"""and the wheels turn it no faster, rad/s: a marker beside the axle moves sideways in turns."""


class LabyrinthRows(NamedTuple):
    """Lines of one kind, in the order of their stamps."""

    stamp: Stamps
    values: Floats
    """What stands behind the time, shape (n, width - 1)."""


def labyrinth_files(path: Path) -> tuple[Path, ...]:
    """The whole run, or an input with its truth. Raises LogError where a folder holds neither."""
    if path.is_dir():
        whole = [path / name for name in WHOLE_RUN if (path / name).is_file()]
        inputs = sorted(file for file in path.iterdir() if INPUT_END in file.name)
        if len(whole) == 0 and len(inputs) != 1:
            there = ", ".join(file.name for file in inputs) or "none of its files"
            raise LogError(f"{path}: give {WHOLE_RUN[0]} or one *{INPUT_END}; it has: {there}")
        path = (whole or inputs)[0]
    if INPUT_END not in path.name:
        return (path,)
    name = path.name.replace(INPUT_END, TRUTH_END)
    truth = [path.with_name(one) for one in (name, f"{name}.gz", name.removesuffix(".gz"))]
    return (path, *[file for file in truth if file.is_file()][:1])


def read_labyrinth(path: Path) -> Recording:
    """Read one run; `path` as `labyrinth_files` takes it.

    Raises:
        LogError: naming the file, the line and what is wrong in it.
    """
    files = labyrinth_files(path)
    faults, notes = Faults(str(files[0])), list[str]()
    columns = {kind: array("d") for kind in LINE_WIDTHS}
    stamps = {kind: array("q") for kind in LINE_WIDTHS}
    variances = [_collect(file, stamps, columns) for file in files]
    rows = {kind: _rows(stamps[kind], columns[kind], kind, faults) for kind in LINE_WIDTHS}
    for kind in ("range2", "odom2diff"):
        if len(rows[kind].stamp) == 0:
            raise LogError(f"{files[0]}: no line `{kind}`: not a run of libRSF's Indoor_UWB")
    if any(variances):
        notes.append("the newer form: stated variances became standard deviations")
    team = _team(rows["range2"], files[0])
    odometry = _odometry(rows["odom2diff"], any(variances), files[0])
    notes.append("robot: w1 was taken as the left wheel and b as half the track")
    truth = {}
    known = rows["gt2"] if len(rows["gt2"].stamp) > 0 else rows["point2"]
    if len(known.stamp) > 0:
        truth["robot"] = _truth(known, odometry)
        notes.append("robot: true headings are the course over ground where it drives straight")
    return Recording(
        team=team,
        odometry={"robot": odometry},
        ranges=_ranges(rows["range2"], any(variances), team, faults),
        truth={**truth, **truth_of_static(team.robots, truth)},
        run=run_notes(notes),
        faults=faults.all(),
    )


def _collect(path: Path, stamps: dict[str, array[int]], columns: dict[str, array[float]]) -> bool:
    """Take the lines of one file; whether it states variances. Raises LogError naming the line."""
    variances = False
    for number, words in read_words(path):
        kind = words[0]
        if kind not in LINE_WIDTHS:
            known = ", ".join(LINE_WIDTHS)
            raise LogError(f"{path}: line {number}: `{kind[:40]}` is none of {known}")
        width = LINE_WIDTHS[kind]
        values = parse_floats(words[2 : width + 1])
        stamp = parse_stamp(words[1]) if len(words) > width else None
        if stamp is None or values is None:
            text = f"no time and {width - 1} numbers behind `{kind}`"
            raise LogError(f"{path}: line {number}: {text}")
        variances |= kind == "range2" and len(words) > VARIANCE_FORM_WIDTH
        stamps[kind].append(stamp)
        columns[kind].extend(values)
    return variances


def _rows(stamps: array[int], values: array[float], kind: str, faults: Faults) -> LabyrinthRows:
    stamp = np.array(stamps, np.int64)
    table = np.array(values).reshape(-1, LINE_WIDTHS[kind] - 1)
    kept = cleaning.usable_rows(faults, kind, np.ones(len(stamp), np.bool_), table)
    kept = kept[cleaning.sorted_rows(faults, kind, stamp[kept])]
    if kind != "range2":
        kept = kept[cleaning.first_of_each_stamp(faults, kind, stamp[kept])]
    return LabyrinthRows(stamp[kept], table[kept])


def _team(ranges: LabyrinthRows, path: Path) -> Team:
    """The robot with the lowest free id, and the anchors. Raises LogError for one that moves."""
    positions: dict[int, tuple[float, float]] = {}
    for x, y, number in ranges.values[:, 2:5].tolist():
        if number != round(number) or not 0 <= number < 1 << 16:
            raise LogError(f"{path}: `range2`: {number:g} is no id of an anchor")
        known = positions.setdefault(int(number), (x, y))
        if max(abs(known[0] - x), abs(known[1] - y)) > MAX_ANCHOR_SHIFT:
            raise LogError(f"{path}: `range2`: anchor {number:g} is at ({x}, {y}) and at {known}")
    own = next(number for number in range(1, 1 << 16) if number not in positions)
    anchors = [
        Robot(f"A{number}", number, static=True, position=positions[number])
        for number in sorted(positions)
    ]
    return Team((Robot("robot", own), *anchors))


def _odometry(rows: LabyrinthRows, variances: bool, path: Path) -> Odometry:
    left, right, _, half, *stated = rows.values.T
    if half.min() <= 0.0:
        raise LogError(f"{path}: `odom2diff`: half the track is not positive")
    a, b = (np.sqrt(one) if variances else one for one in stated[:2])
    both = np.hypot(a, b)
    both = np.where(both > 0.0, both, np.nan)
    return Odometry(
        rows.stamp,
        rows.stamp,
        (left + right) / 2.0,
        (right - left) / (2.0 * half),
        both / 2.0,
        both / (2.0 * half),
    )


def _truth(rows: LabyrinthRows, odometry: Odometry) -> Poses:
    """Positions, with the course over ground as heading where that is known."""
    x, y = rows.values.T
    t = (rows.stamp - rows.stamp[0]) * 1e-9
    own = (odometry.stamp - rows.stamp[0]) * 1e-9
    v, omega = np.interp(t, own, odometry.v), np.interp(t, own, np.abs(odometry.omega))
    heading, k = np.full(len(t), np.nan), COURSE_ROWS
    if len(t) > 2 * k:
        span = t[2 * k :] - t[: -2 * k]
        slowest = np.minimum(
            np.hypot(x[k:-k] - x[: -2 * k], y[k:-k] - y[: -2 * k]) / (t[k:-k] - t[: -2 * k]),
            np.hypot(x[2 * k :] - x[k:-k], y[2 * k :] - y[k:-k]) / (t[2 * k :] - t[k:-k]),
        )
        course = np.arctan2(y[2 * k :] - y[: -2 * k], x[2 * k :] - x[: -2 * k])
        course = wrap_angle(np.where(v[k:-k] < 0.0, course + np.pi, course))
        fastest = np.max([omega[i : len(t) - 2 * k + i] for i in range(2 * k + 1)], axis=0)
        known = (slowest > MIN_COURSE_SPEED) & (span <= MAX_COURSE_S)
        known &= fastest < MAX_COURSE_TURN
        heading[k:-k] = np.where(known, course, np.nan)
    return Poses(WORLD_FRAME, rows.stamp, rows.stamp, x, y, heading)


def _ranges(rows: LabyrinthRows, variances: bool, team: Team, faults: Faults) -> Ranges:
    index = {robot.id: row for row, robot in enumerate(team.robots)}
    raw, stated = rows.values[:, 0], np.maximum(rows.values[:, 1], 0.0)
    sigma = np.sqrt(stated) if variances else stated
    target = np.array([index[int(number)] for number in rows.values[:, 4].tolist()], np.int64)
    source = np.zeros(len(raw), np.int64)
    sigma = np.where(sigma > 0.0, sigma, np.nan)
    return sorted_ranges(RawRanges(rows.stamp, source, target, raw, sigma), len(index), faults)
