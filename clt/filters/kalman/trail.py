"""The latest stretch of a run, kept so that it can be run once more from another belief."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.model.filter_inputs import Outputs
from clt.model.known_odometry import segments_after
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution


class HistoryPart(NamedTuple):
    """A part of a run: the problem with the belief and memory that it began with."""

    problem: Problem
    residual: Floats
    """Of each range, m."""
    variance: Floats
    """Of the residual, m^2."""


def make_history_part(problem: Problem, solution: Solution) -> HistoryPart:
    """A problem as its filter solved it."""
    return HistoryPart(problem, solution.residual, solution.variance)


def history_since(
    trail: Sequence[HistoryPart], start: int, settings: FilterSettings, run: Filter
) -> tuple[HistoryPart, ...]:
    """A trail from the time `start` (ns) on, or as far back as it reaches."""
    first, *rest = (piece for piece in trail if piece.problem.end > start)
    whole = first.problem
    if whole.start < start:
        left = run(without_outputs(cut_problem(whole, whole.start, start)), settings)
        rows = slice(int(np.searchsorted(whole.ranges.stamp, start)), None)
        later = resume_problem(cut_problem(whole, start), left)
        first = HistoryPart(later, first.residual[rows], first.variance[rows])
    return (first, *rest)


def history_before(trail: Sequence[HistoryPart], end: int) -> tuple[HistoryPart, ...]:
    """A trail until before the time `end` (ns), which is in its last piece; without outputs."""
    last = trail[-1]
    part = cut_problem(last.problem, last.problem.start, end)
    n = part.ranges.stamp.size
    pieces = (*trail[:-1], HistoryPart(part, last.residual[:n], last.variance[:n]))
    return tuple(piece._replace(problem=without_outputs(piece.problem)) for piece in pieces)


def cut_problem(problem: Problem, start: int, end: int | None = None) -> Problem:
    """The problem from `start` until before `end` (ns), by default to where it ends.

    Its belief and memory are left as they are.
    """

    def inside(stamp: Stamps) -> slice:
        last = stamp.size if end is None else int(np.searchsorted(stamp, end))
        return slice(int(np.searchsorted(stamp, start)), last)

    rows, wanted = inside(problem.ranges.stamp), inside(problem.outputs.stamp)
    return replace(
        problem,
        segments=segments_after(problem.segments, start),
        ranges=RangeTable._make(column[rows] for column in problem.ranges),
        outputs=Outputs._make(column[wanted] for column in problem.outputs),
        start=start,
        end=problem.end if end is None else end,
    )


def resume_problem(problem: Problem, earlier: Solution) -> Problem:
    """The problem from where an earlier solution ended."""
    return replace(problem, prior=None, belief=earlier.belief, memory=earlier.memory)


def without_outputs(problem: Problem) -> Problem:
    """The problem without outputs."""
    return replace(problem, outputs=Outputs._make(column[:0] for column in problem.outputs))
