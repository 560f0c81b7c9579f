"""Plain arrays of a data set as the columns of a recording."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import WORLD_FRAME, Poses, Ranges, Robot
from clt.log.faults import Faults
from clt.log.recording import cleaning

NOTES_KEY = "import_notes"
"""In `clt.run`: what an importer did to the data, a JSON list of lines."""


class RawRanges(NamedTuple):
    """Ranges in any order, shape (n,)."""

    stamp: Stamps
    source: Indices
    """Index into the robots of the team."""
    target: Indices
    raw: Floats
    """m."""
    sigma: Floats
    """As the data set states it, m; NaN unknown."""


def sorted_ranges(given: RawRanges, robots: int, faults: Faults) -> Ranges:
    """The usable ranges by stamp, uncalibrated; `sequence` counts those of each source."""
    rows = cleaning.usable_rows(faults, "ranges", np.ones(len(given.raw), np.bool_), given.raw)
    alone = given.source[rows] == given.target[rows]
    rows = rows[
        cleaning.drop_rows(faults, "ranges", "self", alone, "ranges go from a robot to itself")
    ]
    rows = rows[np.argsort(given.stamp[rows], kind="stable")]
    keep = cleaning.distinct_ranges(
        faults, given.stamp[rows], given.source[rows], given.target[rows], given.raw[rows], robots
    )
    rows = rows[keep]
    stamp, source, target = given.stamp[rows], given.source[rows], given.target[rows]
    raw, sigma = given.raw[rows], given.sigma[rows]
    sequence = np.zeros(len(stamp), np.int64)
    for robot in np.unique(source):
        own = source == robot
        sequence[own] = np.arange(np.count_nonzero(own))
    return Ranges(stamp, stamp, source, target, raw, raw, sigma, sequence)


def truth_of_static(robots: Iterable[Robot], truth: Mapping[str, Poses]) -> dict[str, Poses]:
    """Surveyed positions as a reference, at the first and the last stamp of `truth`; no heading."""
    stamps = [poses.stamp for poses in truth.values() if len(poses.stamp) > 0]
    if len(stamps) == 0:
        return {}
    span = [min(int(stamp[0]) for stamp in stamps), max(int(stamp[-1]) for stamp in stamps)]
    stamp = np.unique(np.array(span, np.int64))
    one = np.ones(len(stamp))
    return {
        robot.name: Poses(
            WORLD_FRAME,
            stamp,
            stamp,
            robot.position[0] * one,
            robot.position[1] * one,
            np.nan * one,
        )
        for robot in robots
        if robot.static and robot.position is not None
    }


def run_notes(notes: Sequence[str]) -> dict[str, str]:
    """The part of `clt.run` that says what was done to the data; empty without notes."""
    return {NOTES_KEY: json.dumps(list(notes))} if len(notes) > 0 else {}
