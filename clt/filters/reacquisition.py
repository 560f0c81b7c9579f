"""A filter that searches for robots that look lost, and believes what it finds if it is better.

When most ranges of a robot contradict the estimate, the latest seconds are run once more from
other poses of it. The ranges decide: only a belief under which all of them are far more probable
takes the place of the old one, which runs on untouched otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clt.filters.evidence import log_densities
from clt.filters.inputs import Outputs, RangeTable
from clt.filters.heard import rows_after
from clt.filters.prior import Belief
from clt.filters.problem import Problem
from clt.filters.rivals import HEADINGS, rivals_of
from clt.filters.settings import FilterSettings
from clt.filters.solution import Filter, Solution
from clt.filters.suspicion import FOUND, SEARCHED, clear, look_lost, next_suspicion, unsuspected
from clt.geometry import wrap
from clt.streams import Floats, Indices

CLEARLY = 20.0
"""Log-likelihood ratio by which a rival must be better than the old belief."""
REPLAYED = 2
"""How much is run once more, and how long to wait after a vain search, in units of `reacquire`."""


class Piece(NamedTuple):
    """A stretch of a run: the problem with the belief and memory that it began with."""

    problem: Problem
    residual: Floats
    """Of each range, m."""
    variance: Floats


class Memory(NamedTuple):
    """What a run keeps beside its belief, to go on from here."""

    filter: object
    """The filter's own."""
    record: Indices
    """See `suspicion`."""
    trail: tuple[Piece, ...]
    """The latest seconds."""


def follow(problem: Problem, settings: FilterSettings, run: Filter) -> Solution:
    """The solution of a filter `run` that searches for robots which look lost."""
    patience = int(settings.reacquire * 1e9)
    memory = remembered(problem, patience)
    record, part = memory.record.copy(), replace(problem, memory=memory.filter)
    solution = run(part, settings)
    trail, done, m = (*memory.trail, piece_of(part, solution)), [], 0
    while True:
        a, b, stamp = part.ranges.a, part.ranges.b, part.ranges.stamp
        m = int(next_suspicion(record, a, b, stamp, solution.verdict, m, patience))
        if m == stamp.size:
            break
        now, lost = int(stamp[m]), look_lost(record)
        trail = since(trail, now - REPLAYED * patience, settings, run)
        found = search(until(trail, now), np.flatnonzero(lost), settings, run)
        record[lost, SEARCHED] += 1
        if found is None:
            clear(record, lost, now + REPLAYED * patience)
            continue
        record[lost, FOUND] += 1
        clear(record, np.ones_like(lost), now + patience)
        done.append(rows_of(solution, m, int(np.searchsorted(part.outputs.stamp, now))))
        part, m = replace(cut(part, now), **going_on(found)), 0
        solution = run(part, settings)
        trail = (piece_of(part, solution),)
    kept = tuple(piece for piece in trail if piece.problem.end > part.end - REPLAYED * patience)
    return replace(
        joined([*done, solution]),
        lost=record[:, SEARCHED].copy(),
        found=record[:, FOUND].copy(),
        memory=Memory(solution.memory, record, kept),
    )


def remembered(problem: Problem, patience: int) -> Memory:
    """What the run that a problem goes on from kept; else what a first one begins with."""
    if isinstance(problem.memory, Memory):
        return problem.memory
    return Memory(None, unsuspected(len(problem.robots), problem.start + patience), ())


def piece_of(problem: Problem, solution: Solution) -> Piece:
    """A stretch as its filter ran through it."""
    return Piece(problem, solution.residual, solution.variance)


def going_on(solution: Solution) -> dict[str, object]:
    """The fields of a problem that goes on where a solution ends."""
    return {"belief": solution.belief, "memory": solution.memory, "prior": None}


def cut(problem: Problem, start: int, end: int | None = None) -> Problem:
    """The problem from `start` until before `end` (ns), by default to where it ends."""
    until = problem.end + 1 if end is None else end

    def inside(stamp: Indices) -> slice:
        last = stamp.size if end is None else int(np.searchsorted(stamp, end))
        return slice(int(np.searchsorted(stamp, start)), last)

    rows, wanted = inside(problem.ranges.stamp), inside(problem.outputs.stamp)
    return replace(
        problem,
        segments=rows_after(problem.segments, start),
        ranges=RangeTable._make(column[rows] for column in problem.ranges),
        outputs=Outputs._make(column[wanted] for column in problem.outputs),
        start=start,
        end=min(until, problem.end),
    )


def silent(problem: Problem) -> Problem:
    """The problem without outputs."""
    return replace(problem, outputs=Outputs._make(column[:0] for column in problem.outputs))


def since(
    trail: Sequence[Piece], start: int, settings: FilterSettings, run: Filter
) -> tuple[Piece, ...]:
    """A trail from the time `start` (ns) on, or as far back as it reaches."""
    first, *rest = (piece for piece in trail if piece.problem.end > start)
    whole = first.problem
    if whole.start < start:
        left = run(silent(cut(whole, whole.start, start)), settings)
        rows = slice(int(np.searchsorted(whole.ranges.stamp, start)), None)
        later = replace(cut(whole, start), **going_on(left))
        first = Piece(later, first.residual[rows], first.variance[rows])
    return (first, *rest)


def until(trail: Sequence[Piece], end: int) -> tuple[Piece, ...]:
    """A trail until before the time `end` (ns), which is in its last piece; without outputs."""
    last = trail[-1]
    part = cut(last.problem, last.problem.start, end)
    n = part.ranges.stamp.size
    pieces = (*trail[:-1], Piece(part, last.residual[:n], last.variance[:n]))
    return tuple(piece._replace(problem=silent(piece.problem)) for piece in pieces)


class Replayed(NamedTuple):
    """A belief that ran through a trail."""

    began: Belief
    solution: Solution
    """Of the last piece."""
    evidence: Floats
    """Log-density of each range, (n,)."""


def search(
    trail: Sequence[Piece], lost: Indices, settings: FilterSettings, run: Filter
) -> Solution | None:
    """Where the `lost` blocks (L,) are, at the end of a trail; None if that is not clearly better.

    Each of them takes the rival under which its own ranges are most probable.
    """
    first = trail[0].problem
    ranges = RangeTable._make(
        np.concatenate(columns)
        for columns in zip(*(piece.problem.ranges for piece in trail), strict=True)
    )
    old = log_densities(
        ranges,
        np.concatenate([piece.residual for piece in trail]),
        np.concatenate([piece.variance for piece in trail]),
    )
    begun = Belief._make(column[:1] for column in first.belief)
    rivals = [
        replayed(trail, rival, ranges, settings, run)
        for rival in rivals_of(begun, first.lever, ranges, lost)
    ]
    own = np.array([(ranges.a == i) | (ranges.b == i) for i in lost], np.float64)
    scores = np.array([own @ rival.evidence for rival in rivals])
    chosen = np.argmax(scores, axis=0)
    best = rivals[chosen[0]]
    if np.any(chosen != chosen[0]):
        best = replayed(trail, composed(rivals, chosen, lost), ranges, settings, run)
        best = max((best, *rivals), key=lambda rival: float(rival.evidence.sum()))
    if not best.evidence.sum() > old.sum() + CLEARLY:
        return None
    return best.solution


def replayed(
    trail: Sequence[Piece], belief: Belief, ranges: RangeTable, settings: FilterSettings, run: Filter
) -> Replayed:
    """Run a belief through a trail whose ranges are given."""
    began, memory, runs = belief, None, []
    for piece in trail:
        problem = replace(piece.problem, belief=belief, memory=memory, prior=None)
        solution = run(problem, settings)
        belief, memory = solution.belief, solution.memory
        runs.append(solution)
    evidence = log_densities(
        ranges,
        np.concatenate([solution.residual for solution in runs]),
        np.concatenate([solution.variance for solution in runs]),
    )
    return Replayed(began, runs[-1], np.nan_to_num(evidence, nan=-np.inf))


def composed(rivals: Sequence[Replayed], chosen: Indices, lost: Indices) -> Belief:
    """The rivals' beginning with each of the lost blocks as its chosen one has it."""
    belief = rivals[chosen[0]].began
    x, P = belief.mean.copy(), belief.covariance.copy()
    for i, k in zip(lost, chosen, strict=True):
        own = slice(3 * i, 3 * i + 3)
        x[0, own] = rivals[k].began.mean[0, own]
        P[0, own, own] = rivals[k].began.covariance[0, own, own]
    return belief._replace(mean=x, covariance=P)


def rows_of(solution: Solution, m: int, o: int) -> Solution:
    """The first m ranges and o outputs of a solution."""
    return replace(
        solution,
        mean=solution.mean[:o],
        covariance=solution.covariance[:o],
        residual=solution.residual[:m],
        variance=solution.variance[:m],
        verdict=solution.verdict[:m],
    )


def joined(parts: Sequence[Solution]) -> Solution:
    """Solutions one after the other; the belief is that of the last."""
    names = ("mean", "covariance", "residual", "variance", "verdict")
    if len(parts) == 1:
        return parts[0]
    columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[-1], **columns)
