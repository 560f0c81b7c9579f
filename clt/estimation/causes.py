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

from clt.core.recording import Floats
from clt.estimation.perturbed import (
    CLIPPED,
    Case,
    Evidence,
    Key,
    Residuals,
    evidence,
    pair_key,
    rerun,
    without,
)
from clt.model.problem import BODY, Problem

TRIED = 4
"""Causes that are tried at several sizes ..."""
SIZES = (1.0, 2.0, 4.0, 8.0)
"""... by which the local estimate of a large one may be too small."""
BETTER = 30.0
"""How much likelier (twice the logarithm) a run must be that is believed to be right."""
NOISE = (1.25, 1.5, 2.0, 3.0, 5.0)
"""Factors on standard deviations that are tried."""
DELAYS = (0.25, 0.5, 1.0, 2.0)
"""Of clocks that are far off, s: beyond what a derivative shows."""
WORST_PAIRS = 3
"""Pairs that may have an offset of their own."""
MOST_SWAPPED = 8
"""Larger teams are not searched for nodes that are interchanged."""


@dataclass(frozen=True)
class Cause:
    """What may be wrong with a log."""

    kind: str
    """offset (of all ranges, one node's, a pair's), gain, late, clock, anchor, scale, turn scale,
    bias, sign, swap, range noise, odometry noise."""
    who: tuple[str, ...]
    """The robots concerned; none: all."""
    value: float = 0.0
    """m, share, s, s, m, share, share, rad/s; of noise the factor."""
    place: tuple[float, float] | None = None
    """Where an anchor is rather, m."""


@dataclass(frozen=True)
class Suspect:
    """A cause whose size is not known: weights of the parameters that it is made of."""

    kind: str
    who: tuple[str, ...]
    weights: dict[Key, float]


def driving(problem: Problem) -> list[int]:
    """The drivers that have odometry."""
    return [int(d) for d in np.flatnonzero(np.diff(problem.segments.first) > 0)]


def range_ends(problem: Problem) -> list[int]:
    """State indices, or -1 - k for fixed robots, that ranges have as ends."""
    return [int(end) for end in np.unique(np.append(problem.ranges.a, problem.ranges.b))]


def in_world(problem: Problem) -> bool:
    """Whether fixed ends are places in a fixed frame, not antennas of a body."""
    return not any(frame.endswith(BODY) for frame in problem.frames)


def worst_pairs(case: Case, base: Residuals) -> list[int]:
    """The pairs (as `pair_key` says) whose residuals are furthest from what they should be."""
    table = case.problem.ranges
    z = np.clip(np.nan_to_num(base.z), -CLIPPED, CLIPPED)
    order = np.argsort(table.row, kind="stable")
    keys, where, size = np.unique(pair_key(table)[order], return_inverse=True, return_counts=True)
    score = np.abs(np.bincount(where, z)) / np.sqrt(size)
    return [int(key) for key in keys[np.argsort(-score, kind="stable")[:WORST_PAIRS]]]


def parameters(case: Case, base: Residuals) -> list[Key]:
    """Everything that the suspects are made of."""
    problem = case.problem
    ends = range_ends(problem)
    sources = np.unique(case.source[problem.ranges.row])
    keys = [Key("late", d) for d in driving(problem)]
    keys += [Key("ranges late", int(robot)) for robot in sources]
    keys += [Key("offset", end) for end in ends]
    keys += [Key("pair", pair) for pair in worst_pairs(case, base)]
    keys.append(Key("gain"))
    if in_world(problem):
        keys += [Key(axis, end) for end in ends if end < 0 for axis in ("x", "y")]
    if not np.any(problem.space.calibration >= 0):
        keys += [Key(kind, d) for d in driving(problem) for kind in ("scale", "turn scale", "bias")]
    return keys


def suspects(case: Case, found: Evidence, names: Sequence[str]) -> Iterator[Suspect]:
    """Every small change that may be the cause; `names` of the team's robots."""
    problem, keys = case.problem, found.keys
    yield from timed(problem, keys, names)
    yield Suspect("offset", (), {key: 0.5 for key in keys if key.kind == "offset"})
    for key in keys:
        if key.kind == "gain":
            yield Suspect("gain", (), {key: 1.0})
        elif key.kind == "offset":
            yield Suspect("offset", (end_name(problem, key.of, names),), {key: 1.0})
        elif key.kind == "pair":
            row = int(np.argmax(pair_key(problem.ranges) == key.of))
            ends = int(problem.ranges.a[row]), int(problem.ranges.b[row])
            pair = sorted((end_name(problem, end, names) for end in ends), key=names.index)
            yield Suspect("offset", tuple(pair), {key: 1.0})
        elif key.kind == "x":
            yield from moved(found, key, names)
        elif key.kind in {"scale", "turn scale", "bias"}:
            yield Suspect(key.kind, (problem.drivers[key.of],), {key: 1.0})


def timed(problem: Problem, keys: Sequence[Key], names: Sequence[str]) -> Iterator[Suspect]:
    """Odometry that is late, of one robot and of all, and clocks that are wrong."""
    late = [key for key in keys if key.kind == "late"]
    for key in late:
        name = problem.drivers[key.of]
        yield Suspect("late", (name,), {key: 1.0})
        measured = Key("ranges late", names.index(name))
        if measured in keys:
            yield Suspect("clock", (name,), {key: 1.0, measured: 1.0})
    if len(late) > 1:
        yield Suspect("late", (), dict.fromkeys(late, 1.0))
    for key in keys:
        if key.kind == "ranges late":
            yield Suspect("clock", (names[key.of],), {key: 1.0})


def moved(found: Evidence, x: Key, names: Sequence[str]) -> Iterator[Suspect]:
    """An anchor at another place, in the direction that explains most; `x` of its keys."""
    y = Key("y", x.of)
    rows = [found.keys.index(x), found.keys.index(y)]
    both = found.information[np.ix_(rows, rows)]
    step = np.linalg.lstsq(both, found.score[rows], rcond=None)[0]
    size = float(np.hypot(*step))
    if size > 0.0:
        weights = {x: float(step[0]) / size, y: float(step[1]) / size}
        yield Suspect("anchor", (names[-1 - x.of],), weights)


def end_name(problem: Problem, end: int, names: Sequence[str]) -> str:
    """The robot at an end of a range."""
    return problem.robots[end] if end >= 0 else names[-1 - end]


def likely_cause(case: Case, base: Residuals, names: Sequence[str], *, gross: bool) -> Cause | None:
    """The cause whose run is the most likely; None where none is much better than the run as it is.

    `gross`: so much is wrong that nodes may be interchanged, or signs.
    """
    found = evidence(case, base, parameters(case, base))
    ranked = []
    tie = count()
    for suspect in suspects(case, found, names):
        value, sigma = found.along(suspect.weights)
        ranked.append((-((value / sigma) ** 2), next(tie), suspect, value))
    ranked.sort()
    clocks = [row for row in ranked if row[2].kind in {"late", "clock"}]
    clocks = clocks[: 2 * TRIED if gross else 0]
    attempts = [(suspect, value * size) for *_, suspect, value in ranked[:TRIED] for size in SIZES]
    attempts += [
        (row[2], sign * delay) for row in clocks for delay in DELAYS for sign in (1.0, -1.0)
    ]
    tried: list[tuple[float, int, Cause]] = []
    for suspect, own in attempts:
        if own != 0.0:
            weights = {key: own * weight for key, weight in suspect.weights.items()}
            run = rerun(case, without(case, base, weights))
            cause = Cause(suspect.kind, suspect.who, own, place_of(case.problem, weights))
            tried.append((run.cost, next(tie), cause))
    for cause, problem in (*noises(case.problem), *(gross_changes(case, names) if gross else ())):
        tried.append((rerun(case, problem).cost, next(tie), cause))
    cost, _, cause = min(tried, key=lambda row: row[:2])
    return cause if cost < base.cost - BETTER else None


def place_of(problem: Problem, moves: dict[Key, float]) -> tuple[float, float] | None:
    """Where an anchor is once its `moves` (m) are taken off."""
    place: Floats | None = None
    for key, value in moves.items():
        if key.kind in {"x", "y"}:
            table = problem.ranges
            meets = (table.a == key.of) | (table.b == key.of)
            place = table.anchor[np.argmax(meets)].copy() if place is None else place
            place[0 if key.kind == "x" else 1] -= value
    return None if place is None else (float(place[0]), float(place[1]))


def noises(problem: Problem) -> Iterator[tuple[Cause, Problem]]:
    """The problem with larger noise of the ranges, and of the odometry."""
    table, segments = problem.ranges, problem.segments
    for factor in NOISE:
        square = factor**2
        wider = table._replace(
            variance=square * table.variance, weight_variance=square * table.weight_variance
        )
        yield Cause("range noise", (), factor), replace(problem, ranges=wider)
        looser = segments._replace(
            var_v=square * segments.var_v, var_omega=square * segments.var_omega
        )
        yield Cause("odometry noise", (), factor), replace(problem, segments=looser)


def gross_changes(case: Case, names: Sequence[str]) -> Iterator[tuple[Cause, Problem]]:
    """Nodes interchanged, turn rates of the other sign: of one robot, of all."""
    problem, segments = case.problem, case.problem.segments
    drivers = driving(problem)
    for chosen in [*([d] for d in drivers), *([drivers] if len(drivers) > 1 else [])]:
        omega = segments.omega.copy()
        for d in chosen:
            omega[segments.first[d] : segments.first[d + 1]] *= -1.0
        everyone = 1 < len(drivers) == len(chosen)
        who = () if everyone else (problem.drivers[chosen[0]],)
        yield Cause("sign", who), replace(problem, segments=segments._replace(omega=omega))
    ends = range_ends(problem)
    for one, other in combinations(ends if len(ends) <= MOST_SWAPPED else [], 2):
        if (one < 0) == (other < 0):
            pair = tuple(
                sorted((end_name(problem, e, names) for e in (one, other)), key=names.index)
            )
            yield Cause("swap", pair), swapped(problem, one, other)


def swapped(problem: Problem, one: int, other: int) -> Problem:
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
