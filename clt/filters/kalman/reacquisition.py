"""A filter that searches for robots that look lost, and believes what it finds if it is better.

When many ranges of a robot contradict the estimate, the latest seconds are run once more from
other poses of it. The ranges decide: only a belief under which all of them are far more probable
takes the place of the old one, which otherwise runs on as if nothing had been tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.geometry import wrap_angle
from clt.filters.kalman.evidence import range_log_densities
from clt.filters.kalman.rivals import alternative_beliefs
from clt.filters.kalman.suspicion import (
    FOUND_COUNT,
    SEARCH_COUNT,
    find_next_lost,
    new_verdict_record,
    reset_verdict_record,
    robots_that_look_lost,
)
from clt.filters.kalman.trail import (
    HistoryPart,
    cut_problem,
    history_before,
    history_since,
    make_history_part,
    resume_problem,
)
from clt.model.belief import Belief
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution

MIN_LOG_LIKELIHOOD_GAIN = 20.0
"""Log-likelihood ratio by which a rival must be better than the old belief."""
MIN_LOG_LIKELIHOOD_LEAD = 7.0
"""The same by which it must be better than one elsewhere: a mirror image fits ranges as well."""
REPLAY_INTERVALS = 2
"""How much is run once more, and how long to wait after a vain search, in units of `reacquire`."""


class SearchMemory(NamedTuple):
    """What a run keeps beside its belief, to go on from here."""

    filter: object
    """The filter's own."""
    record: Indices
    """See `suspicion`."""
    trail: tuple[HistoryPart, ...]
    """The latest seconds."""


class ReplayedBelief(NamedTuple):
    """A belief that ran through a trail."""

    began: Belief
    solution: Solution
    """Of the last piece."""
    evidence: Floats
    """Log-density of each range, (n,)."""


def solve_with_search(problem: Problem, settings: FilterSettings, run: Filter) -> Solution:
    """The solution of a filter `run` that searches for robots which look lost."""
    patience = int(settings.reacquire * 1e9)
    memory = restore_search_memory(problem, patience)
    record, part = memory.record.copy(), replace(problem, memory=memory.filter)
    solution = run(part, settings)
    trail = (*memory.trail, make_history_part(part, solution))
    done: list[Solution] = []
    m = 0
    while True:
        a, b, stamp = part.ranges.a, part.ranges.b, part.ranges.stamp
        m = int(find_next_lost(record, a, b, stamp, solution.verdict, m, patience))
        if m == stamp.size:
            break
        now, lost = int(stamp[m]), robots_that_look_lost(record)
        trail = history_since(trail, now - REPLAY_INTERVALS * patience, settings, run)
        found = search_lost_robots(history_before(trail, now), np.flatnonzero(lost), settings, run)
        record[lost, SEARCH_COUNT] += 1
        if found is None:
            reset_verdict_record(record, lost, now + REPLAY_INTERVALS * patience)
            continue
        record[lost, FOUND_COUNT] += 1
        reset_verdict_record(record, np.ones_like(lost), now + patience)
        done.append(truncate_solution(solution, m, int(np.searchsorted(part.outputs.stamp, now))))
        part, m = resume_problem(cut_problem(part, now), found), 0
        solution = run(part, settings)
        trail = (make_history_part(part, solution),)
    kept = tuple(
        piece for piece in trail if piece.problem.end > part.end - REPLAY_INTERVALS * patience
    )
    return replace(
        join_solutions([*done, solution]),
        lost=record[:, SEARCH_COUNT].copy(),
        found=record[:, FOUND_COUNT].copy(),
        memory=SearchMemory(solution.memory, record, kept),
    )


def restore_search_memory(problem: Problem, patience: int) -> SearchMemory:
    """What the run that a problem goes on from kept; else what a first one begins with."""
    if isinstance(problem.memory, SearchMemory):
        return problem.memory
    return SearchMemory(None, new_verdict_record(len(problem.robots), problem.start + patience), ())


def search_lost_robots(
    trail: Sequence[HistoryPart], lost: Indices, settings: FilterSettings, run: Filter
) -> Solution | None:
    """Where the `lost` blocks (L,) are, at the end of a trail; None if that is not clearly better.

    Nor if other positions are nearly as good. Blocks without ranges in the trail stay where they
    are; an estimate that is not finite is lost for good.
    """
    ranges = RangeTable._make(
        np.concatenate(columns)
        for columns in zip(*(piece.problem.ranges for piece in trail), strict=True)
    )
    first = trail[0].problem
    begun = Belief._make(column[:1] for column in first.belief)
    old = run_log_densities(ranges, trail)
    lost = lost[np.isin(lost, [ranges.a, ranges.b])]
    if lost.size == 0 or not (np.isfinite(begun.mean).all() and np.isfinite(old).all()):
        return None
    found = []
    for turned in alternative_beliefs(begun, first.lever, ranges, lost):
        rivals = [replay_belief(trail, rival, ranges, settings, run) for rival in turned]
        found.append(best_headings(rivals, trail, ranges, lost, settings, run))
    best, *others = sorted(found, key=lambda each: -each.evidence.sum())
    if not best.evidence.sum() > old.sum() + MIN_LOG_LIKELIHOOD_GAIN:
        return None
    if any(
        other.evidence.sum() > best.evidence.sum() - MIN_LOG_LIKELIHOOD_LEAD for other in others
    ):
        return None
    return best.solution


def best_headings(
    rivals: Sequence[ReplayedBelief],
    trail: Sequence[HistoryPart],
    ranges: RangeTable,
    lost: Indices,
    settings: FilterSettings,
    run: Filter,
) -> ReplayedBelief:
    """The best of rivals that differ in heading; each lost block may have that of another one."""
    own = np.array([(ranges.a == i) | (ranges.b == i) for i in lost], np.float64)
    scores = np.array([np.where(own > 0.0, rival.evidence, 0.0).sum(axis=1) for rival in rivals])
    chosen = np.argmax(scores, axis=0)
    candidates = list(rivals)
    if np.any(chosen != chosen[0]):
        mixed = combine_beliefs([rivals[k].began for k in chosen], lost)
        candidates.append(replay_belief(trail, mixed, ranges, settings, run))
    best = max(candidates, key=lambda rival: float(rival.evidence.sum()))
    return best._replace(solution=add_heading_uncertainty(best.solution, rivals, scores, lost))


def run_log_densities(ranges: RangeTable, runs: Sequence[HistoryPart | Solution]) -> Floats:
    """Log-density of each range (n,) by the innovations of successive runs; -inf where not finite.

    `ranges` are those of all runs.
    """
    residual = np.concatenate([each.residual for each in runs])
    variance = np.concatenate([each.variance for each in runs])
    found: Floats = np.nan_to_num(range_log_densities(ranges, residual, variance), nan=-np.inf)
    return found


def replay_belief(
    trail: Sequence[HistoryPart],
    began: Belief,
    ranges: RangeTable,
    settings: FilterSettings,
    run: Filter,
) -> ReplayedBelief:
    """Run a belief through a trail whose ranges are given."""
    first, *rest = (piece.problem for piece in trail)
    runs = [run(replace(first, prior=None, belief=began, memory=None), settings)]
    for problem in rest:
        runs.append(run(resume_problem(problem, runs[-1]), settings))
    return ReplayedBelief(began, runs[-1], run_log_densities(ranges, runs))


def combine_beliefs(begun: Sequence[Belief], lost: Indices) -> Belief:
    """One beginning in which each of the lost blocks (L,) is as in its own one of `begun` (L,)."""
    x, P = begun[0].mean.copy(), begun[0].covariance.copy()
    for i, theirs in zip(lost.tolist(), begun, strict=True):
        own = slice(3 * i, 3 * i + 3)
        x[0, own], P[0, own, own] = theirs.mean[0, own], theirs.covariance[0, own, own]
    return Belief(begun[0].log_weight, x, P)


def add_heading_uncertainty(
    solution: Solution, rivals: Sequence[ReplayedBelief], scores: Floats, lost: Indices
) -> Solution:
    """A solution that also knows how little the ranges of each lost block said of its heading.

    scores: of each rival and lost block, (K, L). A robot that stands may have any heading.
    """
    P = solution.belief.covariance.copy()
    for i, score in zip((3 * lost + 2).tolist(), scores.T, strict=True):
        w = np.exp(score - score.max()) if np.isfinite(score.max()) else np.ones_like(score)
        ends = np.array([rival.solution.belief.mean[0, i] for rival in rivals])
        P[0, i, i] += w @ wrap_angle(ends - solution.belief.mean[0, i]) ** 2 / w.sum()
    return replace(solution, belief=solution.belief._replace(covariance=P))


def truncate_solution(solution: Solution, m: int, o: int) -> Solution:
    """The first m ranges and o outputs of a solution."""
    return replace(
        solution,
        mean=solution.mean[:o],
        covariance=solution.covariance[:o],
        residual=solution.residual[:m],
        variance=solution.variance[:m],
        verdict=solution.verdict[:m],
    )


def join_solutions(parts: Sequence[Solution]) -> Solution:
    """Solutions one after the other; all but rows of ranges and outputs is the last one's."""
    if len(parts) == 1:
        return parts[0]
    return replace(
        parts[-1],
        mean=np.concatenate([part.mean for part in parts]),
        covariance=np.concatenate([part.covariance for part in parts]),
        residual=np.concatenate([part.residual for part in parts]),
        variance=np.concatenate([part.variance for part in parts]),
        verdict=np.concatenate([part.verdict for part in parts]),
    )
