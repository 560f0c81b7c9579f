"""Whether the ranges of a run fit what the filter believes, and what is likely wrong if not.

The innovations of a filter that knows its sensors are white, with mean zero and the variance that
it states. What is tested: their variance over all, and by pair variance, mean, correlation in time
and share rejected; values that stand still; odometry that is late. A misfit must be beyond chance
and large enough to do harm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtri

from clt.core.recording import Floats, Indices
from clt.estimation.causes import DELAYS, Cause, driving, end_name, in_world, likely_cause
from clt.estimation.frozen import Frozen, frozen_pairs
from clt.estimation.perturbed import Key, case_of, evidence, pair_key, rerun
from clt.estimation.restart import restarted
from clt.filters.kalman import eskf
from clt.metrics.residuals import (
    PairResiduals,
    nis_score,
    offset_score,
    pair_residuals,
    repeat_score,
)
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution

BY_CHANCE = 1e-3
"""Probability that a consistent filter shows any of what is tested by pair, or its mean NIS ..."""
NIS, PAIR_NIS, OFFSET, REPEAT = 1.3, 1.5, 0.35, 0.25
"""... and what does harm: mean NIS, that of a pair, mean and correlation of its residuals over
their standard deviation and variance."""
HINT, BODY_HINT = 0.25, 0.7
"""A cause is looked for from this share of what does harm; in body frames, where linearization
shifts residuals a little, from the second."""
REJECTED, LEAST_REJECTED = 0.25, 8
"""Share of a pair's ranges, and number of them, whose rejection says that something is wrong."""
WHITE = 0.7
"""Ranges of a pair that are worth less than this each are correlated, as the settings know."""
LATE, LATE_SCORE = 0.05, 5.0
"""Delay of odometry that does harm, s, and how many standard deviations it must stand out."""
QUICK, THOROUGH = 4000, 8000
"""Ranges that are looked at for late odometry, and for causes ..."""
FEW_NUMBERS = 20
"""... with so many numbers in the state; fewer ranges with more."""
MOST_DRIVERS = 10
"""Larger teams are not tested for late odometry."""


@dataclass(frozen=True)
class PairMisfit:
    """A pair whose residuals do not fit."""

    pair: tuple[str, str]
    count: int
    mean: float
    """m."""
    autocorrelation: float
    nis: float
    rejected: float
    """Share of its ranges."""


@dataclass(frozen=True)
class Misfit:
    """What does not fit, and why that may be."""

    nis: float
    """Mean over the accepted ranges; NaN without any."""
    chance: float
    """Largest mean NIS by chance."""
    scattered: bool
    """The mean NIS is too large."""
    pairs: tuple[PairMisfit, ...]
    frozen: tuple[Frozen, ...]
    cause: Cause | None
    vague: bool
    """The start was too uncertain for a filter that linearizes: that may be all that is wrong."""


@dataclass(frozen=True)
class Trial:
    """What causes are looked for in."""

    problem: Problem
    """Begun where every pose is known well."""
    solution: Solution
    settings: FilterSettings
    source: Indices


def find_misfit(
    problem: Problem,
    solution: Solution,
    settings: FilterSettings,
    source: Indices,
    names: Sequence[str],
) -> Misfit | None:
    """What does not fit in a run; None where everything does.

    `source` holds who measured each row of the recording's ranges, `names` the team's robots.
    """
    table, used = problem.ranges, solution.verdict == eskf.USED
    finite = np.isfinite(solution.residual) & np.isfinite(solution.variance)
    if not np.any(finite & (solution.variance > 0.0)):
        return None
    sigma = np.sqrt(np.where(solution.variance > 0.0, solution.variance, np.nan))
    key = pair_key(table)
    figures = pair_residuals(key, solution.residual, sigma, used)
    worth = worth_of(problem, key, figures)
    nis, chance = mean_nis(problem, solution)
    wrong = misfits(figures, worth)
    frozen = frozen_pairs(table, key, solution.residual, sigma)
    begun = restarted(problem, solution)
    vague = begun is not problem and solution.share is None
    trial = None if begun is None or vague else Trial(begun, solution, settings, source)
    known = begun is problem  # Marginals of a later time are too coarse for what is subtle.
    late = late_odometry(trial) if trial is not None and known else None
    scattered = nis > max(chance, NIS)
    hard = scattered or bool(np.any(wrong)) or len(frozen) > 0
    hint = HINT if in_world(problem) else BODY_HINT
    if not (hard or late is not None or (known and hinted(figures, worth, hint))):
        return None
    cause = None
    if trial is not None and len(frozen) == 0:
        cause = explain(trial, names, gross=hard)
    if cause is None and late is not None:
        cause = late
    if not hard and (cause is None or not harmful(cause, problem)):
        return None
    pairs = tuple(
        PairMisfit(
            ends_of(problem, key, int(k), names),
            int(figures.total[i]),
            float(figures.mean[i]),
            float(figures.autocorrelation[i]),
            float(figures.nis[i]),
            1.0 - float(figures.accepted[i] / figures.total[i]),
        )
        for i, k in enumerate(figures.pair)
        if wrong[i]
    )
    pairs = tuple(sorted(pairs, key=badness, reverse=True))
    return Misfit(nis, chance, scattered, pairs, frozen, cause, vague)


def badness(pair: PairMisfit) -> tuple[float, float]:
    """To sort pairs by: the share rejected, where that is too large, then the mean NIS."""
    rejected = pair.rejected if pair.rejected > REJECTED else 0.0
    return rejected, pair.nis if np.isfinite(pair.nis) else np.inf


def ends_of(problem: Problem, key: Indices, pair: int, names: Sequence[str]) -> tuple[str, str]:
    """The robots of a pair."""
    row = int(np.argmax(key == pair))
    ends = int(problem.ranges.a[row]), int(problem.ranges.b[row])
    first, second = sorted((end_name(problem, end, names) for end in ends), key=names.index)
    return first, second


def mean_nis(problem: Problem, solution: Solution) -> tuple[float, float]:
    """Mean NIS of the accepted ranges, NaN without any, and the largest by chance."""
    table, used = problem.ranges, solution.verdict == eskf.USED
    if not used.any():
        return float("nan"), float("nan")
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        nis = float(np.mean(solution.residual[used] ** 2 / solution.variance[used]))
    count = float(np.sum(table.variance[used] / table.weight_variance[used]))
    return nis, float(chdtri(count, BY_CHANCE)) / count


def worth_of(problem: Problem, key: Indices, figures: PairResiduals) -> Floats:
    """How many independent ranges each one of a pair is worth, (P,): less than 1 if correlated."""
    table = problem.ranges
    where = np.searchsorted(figures.pair, key)
    total = np.bincount(where, table.variance / table.weight_variance, figures.pair.size)
    worth: Floats = total / figures.total
    return worth


def misfits(figures: PairResiduals, worth: Floats) -> NDArray[np.bool_]:
    """Which pairs (P,) do not fit beyond chance and harmlessness."""
    limit = -float(ndtri(BY_CHANCE / (8.0 * max(figures.pair.size, 1))))
    with np.errstate(invalid="ignore"):
        shifted = (np.abs(offset_score(figures, worth)) > limit) & (np.abs(figures.offset) > OFFSET)
        repeated = (repeat_score(figures) > limit) & (figures.repeat > REPEAT) & (worth > WHITE)
        wide = (nis_score(figures, worth) > limit) & (figures.nis > PAIR_NIS)
    refused = figures.total - figures.accepted
    refused_often = (refused > REJECTED * figures.total) & (refused >= LEAST_REJECTED)
    return np.asarray(shifted | repeated | wide | refused_often)


def hinted(figures: PairResiduals, worth: Floats, hint: float) -> bool:
    """Whether any pair shows a share of what does harm, beyond chance."""
    limit = -float(ndtri(BY_CHANCE / (8.0 * max(figures.pair.size, 1))))
    with np.errstate(invalid="ignore"):
        shifted = np.abs(figures.offset) > hint * OFFSET
        repeated = (figures.repeat > hint * REPEAT) & (worth > WHITE)
        wide = figures.nis > 1.0 + hint * (PAIR_NIS - 1.0)
    return bool(
        np.any(shifted & (np.abs(offset_score(figures, worth)) > limit))
        or np.any(repeated & (repeat_score(figures) > limit))
        or np.any(wide & (nis_score(figures, worth) > limit))
    )


def budget(problem: Problem, most: int) -> int:
    """How many ranges to run through again: `most` for small teams."""
    return max(int(most * min(1.0, (FEW_NUMBERS / problem.mean.size) ** 2)), 200)


def late_odometry(trial: Trial) -> Cause | None:
    """The robot whose odometry is late against the ranges, or all, where that is beyond doubt.

    Looked for with the ranges that were accepted: lateness hides in trajectories that fit them.
    """
    problem = trial.problem
    drivers = driving(problem)
    use = (trial.solution.verdict == eskf.USED) & (problem.ranges.stamp > problem.start)
    if not 0 < len(drivers) <= MOST_DRIVERS or not np.any(use):
        return None
    case = case_of(problem, trial.settings, trial.source, use, budget(problem, QUICK))
    base = rerun(case, case.problem)
    if not np.isfinite(base.cost):
        return None
    found = evidence(case, base, [Key("late", d) for d in drivers])
    best: tuple[float, Cause] | None = None
    groups = [*((key,) for key in found.keys), *([found.keys] if len(drivers) > 1 else [])]
    for keys in groups:
        value, sigma = found.along(dict.fromkeys(keys, 1.0))
        who = (problem.drivers[keys[0].of],) if len(keys) == 1 else ()
        if abs(value) > max(LATE, LATE_SCORE * sigma) and (
            best is None or abs(value / sigma) > best[0]
        ):
            best = abs(value / sigma), Cause("late", who, value)
    return None if best is None else best[1]


def explain(trial: Trial, names: Sequence[str], *, gross: bool) -> Cause | None:
    """The likely cause of a misfit, from runs over the beginning of the log.

    `gross`: so much is wrong that rejected ranges may be right.
    """
    problem = trial.problem
    use = problem.ranges.stamp > problem.start
    if gross:
        use &= problem.ranges.stamp > problem.start + round(max(DELAYS) * 1e9)
    else:
        use &= trial.solution.verdict == eskf.USED
    if not np.any(use):
        return None
    case = case_of(problem, trial.settings, trial.source, use, budget(problem, THOROUGH))
    base = rerun(case, case.problem)
    return likely_cause(case, base, names, gross=gross) if np.isfinite(base.cost) else None


def harmful(cause: Cause, problem: Problem) -> bool:
    """Whether a cause is large enough to matter."""
    sigma = float(np.sqrt(np.median(problem.ranges.variance)))
    least = {
        "offset": max(0.03, 0.5 * sigma),
        "gain": 0.015,
        "late": LATE,
        "clock": LATE,
        "anchor": max(0.1, sigma),
        "scale": 0.03,
        "turn scale": 0.05,
        "bias": 0.02,
        "range noise": 1.5,
        "odometry noise": 1.5,
    }
    return abs(cause.value) >= least.get(cause.kind, 0.0)
