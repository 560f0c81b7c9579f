"""The lines of a PyFG file as columns."""

from __future__ import annotations

import re
from array import array
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.errors import LogError
from clt.importers.textfile import parse_floats, parse_stamp, read_words

POSE_NAME_PATTERN = re.compile(r"([A-Za-z]+)(\d+)", re.ASCII)
LINE_LAYOUTS = {
    "VERTEX_SE2": (2, 3),
    "VERTEX_XY": (1, 2),
    "EDGE_SE2": (3, 9),
    "EDGE_RANGE": (3, 2),
    "EDGE_SE2_XY": (3, 5),
}
"""Of each kind of line that is read: words (time, names) and numbers behind the kind."""
PRIOR_END = ":PRIOR"
"""Lines of such a kind are beliefs, not measurements."""


class PyfgSteps(NamedTuple):
    """EDGE_SE2: rows of poses, and (dx, dy, dtheta, their variances), shape (n, 6)."""

    begin: Indices
    end: Indices
    values: Floats


class PyfgRanges(NamedTuple):
    """EDGE_RANGE and the distances of EDGE_SE2_XY, shape (n,)."""

    stamp: Stamps
    source: list[str]
    """Names of poses or landmarks."""
    target: list[str]
    value: Floats
    sigma: Floats
    """m; NaN where the variance is not positive."""


@dataclass(frozen=True)
class PyfgGraph:
    """One file. Poses are rows in the order of their lines, shape (n,)."""

    robots: tuple[str, ...]
    """Letters, sorted."""
    landmarks: Mapping[str, tuple[float, float]]
    row: Mapping[str, int]
    """Of a pose by its name."""
    stamp: Stamps
    robot: Indices
    """Index into `robots`."""
    x: Floats
    y: Floats
    theta: Floats
    steps: PyfgSteps
    ranges: PyfgRanges
    relative_positions: int
    """How many of the ranges were EDGE_SE2_XY."""
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Lines that are not read, by kind."""

    def owner(self, name: str) -> str:
        """The robot of a pose, or the landmark itself."""
        return name if name in self.landmarks else self.robots[self.robot[self.row[name]]]

    def stamps_of(self, names: list[str]) -> Stamps:
        """Stamps of poses, ns; -1 for landmarks."""
        rows = [self.row.get(name, -1) for name in names]
        return np.array([-1 if row < 0 else int(self.stamp[row]) for row in rows], np.int64)


@dataclass(frozen=True)
class _Lines:
    """What has been read so far."""

    row: dict[str, int] = field(default_factory=dict)
    landmarks: dict[str, tuple[float, float]] = field(default_factory=dict)
    stamp: array[int] = field(default_factory=lambda: array("q"))
    pose: array[float] = field(default_factory=lambda: array("d"))
    ends: list[tuple[str, str, int]] = field(default_factory=list)
    """Of relative poses: names and line."""
    step: array[float] = field(default_factory=lambda: array("d"))
    seen: list[tuple[str, str, int]] = field(default_factory=list)
    """The same of ranges."""
    seen_stamp: array[int] = field(default_factory=lambda: array("q"))
    range: array[float] = field(default_factory=lambda: array("d"))
    left_out: dict[str, int] = field(default_factory=dict)
    relative: list[int] = field(default_factory=list)


def read_pyfg_graph(path: Path) -> PyfgGraph:
    """Read a planar graph.

    Raises:
        LogError: naming the line that is no line of PyFG, is three-dimensional, or names a pose
            that has no vertex.
    """
    lines = _Lines()
    for number, words in read_words(path):
        kind = words[0]
        if kind.endswith(PRIOR_END):
            lines.left_out[kind] = lines.left_out.get(kind, 0) + 1
            continue
        _take(lines, kind, words, f"{path}: line {number}", number)
    if len(lines.row) == 0:
        raise LogError(f"{path}: no VERTEX_SE2 in it: not a planar PyFG file")
    if len(lines.seen) == 0:
        raise LogError(f"{path}: no EDGE_RANGE and no EDGE_SE2_XY in it: there are no ranges")
    return _graph(lines, path)


def _take(lines: _Lines, kind: str, words: list[str], place: str, number: int) -> None:
    if "SE3" in kind or "XYZ" in kind:
        raise LogError(f"{place}: {kind[:40]} is three-dimensional; clt reads planar graphs")
    if kind not in LINE_LAYOUTS:
        known = ", ".join(LINE_LAYOUTS)
        raise LogError(f"{place}: `{kind[:40]}` is no line of PyFG that clt reads: {known}")
    head, width = LINE_LAYOUTS[kind]
    values = parse_floats(words[head + 1 :]) if len(words) == head + 1 + width else None
    stamp = None if values is None else parse_stamp(words[1]) if kind != "VERTEX_XY" else 0
    if stamp is None or values is None or not np.all(np.isfinite(values)):
        timed = "a time (s), " if kind != "VERTEX_XY" else ""
        raise LogError(f"{place}: {kind} without {timed}its names and {width} finite numbers")
    names = words[head] if head < 3 else (words[2], words[3])
    if isinstance(names, str):
        _take_vertex(lines, kind, names, stamp, values, place)
    elif kind == "EDGE_SE2":
        lines.ends.append((*names, number))
        lines.step.extend([*values[:3], values[3], values[6], values[8]])
    else:
        _take_range(lines, kind, (*names, number), stamp, values)


def _take_vertex(
    lines: _Lines, kind: str, name: str, stamp: int, values: list[float], place: str
) -> None:
    if name in lines.row or name in lines.landmarks or POSE_NAME_PATTERN.fullmatch(name) is None:
        raise LogError(f"{place}: {name[:40]} is there twice, or no letters and a number")
    if kind == "VERTEX_XY":
        lines.landmarks[name] = (values[0], values[1])
        return
    lines.row[name] = len(lines.stamp)
    lines.stamp.append(stamp)
    lines.pose.extend(values)


def _take_range(
    lines: _Lines, kind: str, ends: tuple[str, str, int], stamp: int, values: list[float]
) -> None:
    distance, variance = values[0], values[1]
    if kind == "EDGE_SE2_XY":
        x, y, xx, xy, yy = values
        distance = float(np.hypot(x, y))
        along = np.array([x, y]) / distance if distance > 0.0 else np.array([1.0, 0.0])
        variance = float(along @ np.array([[xx, xy], [xy, yy]]) @ along)
        lines.relative.append(ends[2])
    lines.seen.append(ends)
    lines.seen_stamp.append(stamp)
    lines.range.extend([distance, variance])


def _graph(lines: _Lines, path: Path) -> PyfgGraph:
    for begin, end, number in (*lines.ends, *lines.seen):
        for name in (begin, end):
            if name not in lines.row and name not in lines.landmarks:
                raise LogError(f"{path}: line {number}: {name[:40]} has no vertex")
    for begin, end, number in lines.ends:
        if begin not in lines.row or end not in lines.row:
            raise LogError(f"{path}: line {number}: EDGE_SE2 to or from a landmark")
    letters = [POSE_NAME_PATTERN.fullmatch(name) for name in lines.row]
    owners = [match[1] for match in letters if match is not None]
    robots = tuple(sorted(set(owners)))
    index = {name: row for row, name in enumerate(robots)}
    x, y, theta = np.array(lines.pose).reshape(-1, 3).T
    value, variance = np.array(lines.range).reshape(-1, 2).T
    return PyfgGraph(
        robots,
        lines.landmarks,
        lines.row,
        np.array(lines.stamp, np.int64),
        np.array([index[name] for name in owners], np.int64),
        x,
        y,
        theta,
        PyfgSteps(
            np.array([lines.row[begin] for begin, _, _ in lines.ends], np.int64),
            np.array([lines.row[end] for _, end, _ in lines.ends], np.int64),
            np.array(lines.step).reshape(-1, 6),
        ),
        PyfgRanges(
            np.array(lines.seen_stamp, np.int64),
            [begin for begin, _, _ in lines.seen],
            [end for _, end, _ in lines.seen],
            value,
            np.sqrt(np.where(variance > 0.0, variance, np.nan)),
        ),
        len(lines.relative),
        lines.left_out,
    )
