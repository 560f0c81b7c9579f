"""Which single cause best explains the residuals of a run that do not fit.

Each cause is a direction among the parameters of `perturbed`, or a change that is not small (two
nodes interchanged, the sign of a turn rate, larger noise). Those that the local evidence favours
are tried at several sizes; the one whose run is the most likely wins.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, count

import numpy as np

from clt.core.arrays import Floats
from clt.estimation.perturbed import (
    MAX_RESIDUAL_SIGMAS,
    LogParameter,
    ParameterEvidence,
    RerunCase,
    RunResiduals,
    parameter_evidence,
    range_pair_key,
    remove_effects,
    rerun_filter,
)
from clt.model.problem import BASE_LINK_SUFFIX, Problem

MAX_CAUSES_TRIED = 4
"""Causes that are tried at several sizes ..."""
SIZE_FACTORS = (1.0, 2.0, 4.0, 8.0)
"""... by which the local estimate of a large one may be too small."""
MIN_COST_DROP = 30.0
"""How much likelier (twice the logarithm) a run must be that is believed to be right."""
NOISE_FACTORS = (1.25, 1.5, 2.0, 3.0, 5.0)
"""Factors on standard deviations that are tried."""
CLOCK_DELAYS_S = (0.25, 0.5, 1.0, 2.0)
"""Of clocks that are far off, s: beyond what a derivative shows."""
MAX_OFFSET_PAIRS = 3
"""Pairs that may have an offset of their own."""
MAX_SWAP_ENDS = 8
"""Larger teams are not searched for nodes that are interchanged."""


@dataclass(frozen=True)
class Cause:
    """What may be wrong with a log."""

    kind: str
    """offset (of all ranges, one node's, a pair's), gain, late, clock, anchor, baseline (of two
    anchors), scale, turn scale, bias, sign, swap, range noise, odometry noise."""
    who: tuple[str, ...]
    """The robots concerned; none: all."""
    value: float = 0.0
    """m, share, s, s, m, m, share, share, rad/s; of noise the factor."""
    place: tuple[float, float] | None = None
    """Where an anchor is rather, m."""


@dataclass(frozen=True)
class CandidateCause:
    """A cause whose size is not known: weights of the parameters that it is made of."""

    kind: str
    who: tuple[str, ...]
    weights: dict[LogParameter, float]


def moving_drivers(problem: Problem) -> list[int]:
    """The drivers that have odometry."""
    return [int(d) for d in np.flatnonzero(np.diff(problem.segments.first) > 0)]


def range_ends(problem: Problem) -> list[int]:
    """State indices, or -1 - k for fixed robots, that ranges have as ends."""
    return [int(end) for end in np.unique(np.append(problem.ranges.a, problem.ranges.b))]


def is_world_frame(problem: Problem) -> bool:
    """Whether fixed ends are places in a fixed frame, not antennas of a body."""
    return not any(frame.endswith(BASE_LINK_SUFFIX) for frame in problem.frames)


def worst_pairs(case: RerunCase, base: RunResiduals) -> list[int]:
    """The pairs (by `range_pair_key`) whose residuals are furthest from what they should be."""
    table = case.problem.ranges
    z = np.clip(np.nan_to_num(base.z), -MAX_RESIDUAL_SIGMAS, MAX_RESIDUAL_SIGMAS)
    order = np.argsort(table.row, kind="stable")
    keys, where, size = np.unique(
        range_pair_key(table)[order], return_inverse=True, return_counts=True
    )
    score = np.abs(np.bincount(where, z)) / np.sqrt(size)
    return [int(key) for key in keys[np.argsort(-score, kind="stable")[:MAX_OFFSET_PAIRS]]]


def candidate_parameters(case: RerunCase, base: RunResiduals) -> list[LogParameter]:
    """Everything that the suspects are made of."""
    problem = case.problem
    ends = range_ends(problem)
    sources = np.unique(case.source[problem.ranges.row])
    keys = [LogParameter("late", d) for d in moving_drivers(problem)]
    keys += [LogParameter("ranges late", int(robot)) for robot in sources]
    keys += [LogParameter("offset", end) for end in ends]
    keys += [LogParameter("pair", pair) for pair in worst_pairs(case, base)]
    keys.append(LogParameter("gain"))
    if is_world_frame(problem):
        keys += [LogParameter(axis, end) for end in ends if end < 0 for axis in ("x", "y")]
    if not np.any(problem.space.calibration >= 0):
        keys += [
            LogParameter(kind, d)
            for d in moving_drivers(problem)
            for kind in ("scale", "turn scale", "bias")
        ]
    return keys


def candidate_causes(
    case: RerunCase, found: ParameterEvidence, names: Sequence[str]
) -> Iterator[CandidateCause]:
    """Every small change that may be the cause; `names` of the team's robots."""
    problem, keys = case.problem, found.keys
    yield from delay_causes(problem, keys, names)
    yield CandidateCause("offset", (), {key: 0.5 for key in keys if key.kind == "offset"})
    for key in keys:
        if key.kind == "gain":
            yield CandidateCause("gain", (), {key: 1.0})
        elif key.kind == "offset":
            yield CandidateCause("offset", (range_end_name(problem, key.of, names),), {key: 1.0})
        elif key.kind == "pair":
            row = int(np.argmax(range_pair_key(problem.ranges) == key.of))
            ends = int(problem.ranges.a[row]), int(problem.ranges.b[row])
            pair = sorted((range_end_name(problem, end, names) for end in ends), key=names.index)
            yield CandidateCause("offset", tuple(pair), {key: 1.0})
        elif key.kind == "x":
            yield from moved_anchor_causes(found, key, names)
        elif key.kind in {"scale", "turn scale", "bias"}:
            yield CandidateCause(key.kind, (problem.drivers[key.of],), {key: 1.0})


def delay_causes(
    problem: Problem, keys: Sequence[LogParameter], names: Sequence[str]
) -> Iterator[CandidateCause]:
    """Odometry that is late, of one robot and of all, and clocks that are wrong."""
    late = [key for key in keys if key.kind == "late"]
    for key in late:
        name = problem.drivers[key.of]
        yield CandidateCause("late", (name,), {key: 1.0})
        measured = LogParameter("ranges late", names.index(name))
        if measured in keys:
            yield CandidateCause("clock", (name,), {key: 1.0, measured: 1.0})
    if len(late) > 1:
        yield CandidateCause("late", (), dict.fromkeys(late, 1.0))
    for key in keys:
        if key.kind == "ranges late":
            yield CandidateCause("clock", (names[key.of],), {key: 1.0})


def moved_anchor_causes(
    found: ParameterEvidence, x: LogParameter, names: Sequence[str]
) -> Iterator[CandidateCause]:
    """An anchor at another place, in the direction that explains most; `x` of its keys."""
    y = LogParameter("y", x.of)
    rows = [found.keys.index(x), found.keys.index(y)]
    both = found.information[np.ix_(rows, rows)]
    step = np.linalg.lstsq(both, found.score[rows], rcond=None)[0]
    size = float(np.hypot(*step))
    if size > 0.0:
        weights = {x: float(step[0]) / size, y: float(step[1]) / size}
        yield CandidateCause("anchor", (names[-1 - x.of],), weights)


def range_end_name(problem: Problem, end: int, names: Sequence[str]) -> str:
    """The robot at an end of a range."""
    return problem.robots[end] if end >= 0 else names[-1 - end]


def likely_cause(
    case: RerunCase, base: RunResiduals, names: Sequence[str], *, gross: bool
) -> Cause | None:
    """The cause whose run is the most likely; None where none is much better than the run as it is.

    `gross`: so much is wrong that nodes may be interchanged, or signs.
    """
    found = parameter_evidence(case, base, candidate_parameters(case, base))
    ranked = []
    tie = count()
    for suspect in candidate_causes(case, found, names):
        value, sigma = found.along(suspect.weights)
        ranked.append((-((value / sigma) ** 2), next(tie), suspect, value))
    ranked.sort()
    clocks = [row for row in ranked if row[2].kind in {"late", "clock"}]
    clocks = clocks[: 2 * MAX_CAUSES_TRIED if gross else 0]
    attempts = [
        (suspect, value * size)
        for *_, suspect, value in ranked[:MAX_CAUSES_TRIED]
        for size in SIZE_FACTORS
    ]
    attempts += [
        (row[2], sign * delay) for row in clocks for delay in CLOCK_DELAYS_S for sign in (1.0, -1.0)
    ]
    tried: list[tuple[float, int, Cause]] = []
    for suspect, own in attempts:
        if own != 0.0:
            weights = {key: own * weight for key, weight in suspect.weights.items()}
            run = rerun_filter(case, remove_effects(case, base, weights))
            cause = Cause(suspect.kind, suspect.who, own, corrected_anchor(case.problem, weights))
            tried.append((run.cost, next(tie), cause))
    for cause, problem in (
        *noise_causes(case.problem),
        *(gross_changes(case, names) if gross else ()),
    ):
        tried.append((rerun_filter(case, problem).cost, next(tie), cause))
    cost, _, cause = min(tried, key=lambda row: row[:2])
    return cause if cost < base.cost - MIN_COST_DROP else None


def corrected_anchor(
    problem: Problem, moves: dict[LogParameter, float]
) -> tuple[float, float] | None:
    """Where an anchor is once its `moves` (m) are taken off."""
    place: Floats | None = None
    for key, value in moves.items():
        if key.kind in {"x", "y"}:
            table = problem.ranges
            meets = (table.a == key.of) | (table.b == key.of)
            place = table.anchor[np.argmax(meets)].copy() if place is None else place
            place[0 if key.kind == "x" else 1] -= value
    return None if place is None else (float(place[0]), float(place[1]))


def noise_causes(problem: Problem) -> Iterator[tuple[Cause, Problem]]:
    """The problem with larger noise of the ranges, and of the odometry."""
    table, segments = problem.ranges, problem.segments
    for factor in NOISE_FACTORS:
        square = factor**2
        wider = table._replace(
            variance=square * table.variance, weight_variance=square * table.weight_variance
        )
        yield Cause("range noise", (), factor), replace(problem, ranges=wider)
        looser = segments._replace(
            var_v=square * segments.var_v, var_omega=square * segments.var_omega
        )
        yield Cause("odometry noise", (), factor), replace(problem, segments=looser)


def gross_changes(case: RerunCase, names: Sequence[str]) -> Iterator[tuple[Cause, Problem]]:
    """Nodes interchanged, turn rates of the other sign: of one robot, of all."""
    problem, segments = case.problem, case.problem.segments
    drivers = moving_drivers(problem)
    for chosen in [*([d] for d in drivers), *([drivers] if len(drivers) > 1 else [])]:
        omega = segments.omega.copy()
        for d in chosen:
            omega[segments.first[d] : segments.first[d + 1]] *= -1.0
        everyone = 1 < len(drivers) == len(chosen)
        who = () if everyone else (problem.drivers[chosen[0]],)
        yield Cause("sign", who), replace(problem, segments=segments._replace(omega=omega))
    ends = range_ends(problem)
    for one, other in combinations(ends if len(ends) <= MAX_SWAP_ENDS else [], 2):
        if (one < 0) == (other < 0):
            pair = tuple(
                sorted((range_end_name(problem, e, names) for e in (one, other)), key=names.index)
            )
            yield Cause("swap", pair), swap_range_ends(problem, one, other)


def swap_range_ends(problem: Problem, one: int, other: int) -> Problem:
    """The problem with two range ends interchanged, both states or both fixed."""
    table = problem.ranges
    a, b, anchor = table.a.copy(), table.b.copy(), table.anchor.copy()
    places = {}
    for old, new in ((one, other), (other, one)):
        meets = (table.a == new) | (table.b == new)
        places[old] = table.anchor[np.argmax(meets)]
    for old, new in ((one, other), (other, one)):
        a[table.a == old], b[table.b == old] = new, new
        if old < 0:
            anchor[(table.a == old) | (table.b == old)] = places[old]
    return replace(problem, ranges=table._replace(a=a, b=b, anchor=anchor))
