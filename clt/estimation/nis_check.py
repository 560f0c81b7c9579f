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

from clt.core.arrays import Floats, Indices
from clt.estimation.causes import (
    CLOCK_DELAYS_S,
    Cause,
    is_world_frame,
    likely_cause,
    moving_drivers,
    range_end_name,
)
from clt.estimation.frozen import FrozenPair, frozen_pairs
from clt.estimation.perturbed import (
    LogParameter,
    make_rerun_case,
    parameter_evidence,
    range_pair_key,
    rerun_filter,
)
from clt.estimation.restart import restart_problem
from clt.filters.kalman import eskf_state
from clt.metrics.quantiles import chi_square_quantile, normal_quantile
from clt.metrics.residuals import (
    PairResiduals,
    correlation_score,
    nis_score,
    offset_score,
    pair_residuals,
)
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution

FALSE_ALARM_PROBABILITY = 1e-3
"""Probability that a consistent filter shows what is tested by pair, or its MAX_MEAN_NIS ..."""
MAX_MEAN_NIS, MAX_PAIR_NIS, MAX_OFFSET_SIGMAS, MAX_AUTOCORRELATION = 1.3, 1.5, 0.35, 0.25
"""... and what does harm: MAX_MEAN_NIS, that of a pair, mean and correlation of its residuals over
their standard deviation and variance."""
HINT_SHARE, BODY_FRAME_HINT_SHARE = 0.25, 0.7
"""A cause is looked for from this share of what does harm; in body frames, where linearization
shifts residuals a little, from the second."""
MAX_PAIR_REJECTED_SHARE, MAX_PAIR_BLOCKED_SHARE, MIN_PAIR_REJECTED = 0.25, 0.4, 8
"""Share of a pair's ranges whose rejection says that something is wrong, by a gate and by a model
of outliers that last, which rejects more of them; and how many these are at least."""
MIN_WHITE_SHARE = 0.7
"""Ranges of a pair that are worth less than this each are correlated, as the settings know."""
MIN_HARMFUL_DELAY_S, MIN_DELAY_SIGMAS = 0.05, 5.0
"""Delay of odometry that does harm, s, and how many standard deviations it must stand out."""
MAX_DELAY_RANGES, MAX_CAUSE_RANGES = 4000, 8000
"""Ranges that are looked at for late odometry, and for causes ..."""
SMALL_STATE_SIZE = 20
"""... with so many numbers in the state; fewer ranges with more."""
MAX_DELAY_DRIVERS = 10
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
    """Largest mean MAX_MEAN_NIS by chance."""
    scattered: bool
    """The mean MAX_MEAN_NIS is too large."""
    pairs: tuple[PairMisfit, ...]
    frozen: tuple[FrozenPair, ...]
    cause: Cause | None
    vague: bool
    """The start was too uncertain for a filter that linearizes: that may be all that is wrong."""


@dataclass(frozen=True)
class CauseSearch:
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
    table, used = problem.ranges, solution.verdict == eskf_state.RANGE_USED
    finite = np.isfinite(solution.residual) & np.isfinite(solution.variance)
    if not np.any(finite & (solution.variance > 0.0)):
        return None
    sigma = np.sqrt(np.where(solution.variance > 0.0, solution.variance, np.nan))
    key = range_pair_key(table)
    figures = pair_residuals(key, solution.residual, sigma, used)
    worth = independent_share(problem, key, figures)
    nis, chance = mean_nis_and_limit(problem, solution)
    blocked = problem.errors.outliers.active != 0
    limit = MAX_PAIR_BLOCKED_SHARE if blocked else MAX_PAIR_REJECTED_SHARE
    wrong = misfit_pairs(figures, worth, limit)
    frozen = frozen_pairs(table, key, solution.residual, sigma)
    begun = restart_problem(problem, solution)
    vague = begun is not problem and solution.share is None
    trial = None if begun is None or vague else CauseSearch(begun, solution, settings, source)
    known = begun is problem  # Marginals of a later time are too coarse for what is subtle.
    late = late_odometry(trial) if trial is not None and known else None
    scattered = nis > max(chance, MAX_MEAN_NIS)
    hard = scattered or bool(np.any(wrong)) or len(frozen) > 0
    hint = HINT_SHARE if is_world_frame(problem) else BODY_FRAME_HINT_SHARE
    if not (hard or late is not None or (known and has_misfit_hint(figures, worth, hint))):
        return None
    cause = None
    if trial is not None and len(frozen) == 0:
        cause = explain_misfit(trial, names, gross=hard)
    if cause is None and late is not None:
        cause = late
    if not hard and (cause is None or not is_harmful(cause, problem)):
        return None
    pairs = tuple(
        PairMisfit(
            robots_of_pair(problem, key, int(k), names),
            int(figures.total[i]),
            float(figures.mean[i]),
            float(figures.autocorrelation[i]),
            float(figures.nis[i]),
            1.0 - float(figures.accepted[i] / figures.total[i]),
        )
        for i, k in enumerate(figures.pair)
        if wrong[i]
    )
    pairs = tuple(sorted(pairs, key=misfit_rank, reverse=True))
    return Misfit(nis, chance, scattered, pairs, frozen, cause, vague)


def misfit_rank(pair: PairMisfit) -> tuple[float, float]:
    """To sort pairs by: the share rejected, where that is too large, then the mean MAX_MEAN_NIS."""
    rejected = pair.rejected if pair.rejected > MAX_PAIR_REJECTED_SHARE else 0.0
    return rejected, pair.nis if np.isfinite(pair.nis) else np.inf


def robots_of_pair(
    problem: Problem, key: Indices, pair: int, names: Sequence[str]
) -> tuple[str, str]:
    """The robots of a pair."""
    row = int(np.argmax(key == pair))
    ends = int(problem.ranges.a[row]), int(problem.ranges.b[row])
    first, second = sorted((range_end_name(problem, end, names) for end in ends), key=names.index)
    return first, second


def mean_nis_and_limit(problem: Problem, solution: Solution) -> tuple[float, float]:
    """Mean MAX_MEAN_NIS of the accepted ranges, NaN without any, and the largest by chance."""
    table, used = problem.ranges, solution.verdict == eskf_state.RANGE_USED
    if not used.any():
        return float("nan"), float("nan")
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        nis = float(np.mean(solution.residual[used] ** 2 / solution.variance[used]))
    count = float(np.sum(table.variance[used] / table.weight_variance[used]))
    return nis, chi_square_quantile(1.0 - FALSE_ALARM_PROBABILITY, count) / count


def independent_share(problem: Problem, key: Indices, figures: PairResiduals) -> Floats:
    """How many independent ranges each one of a pair is worth, (P,): less than 1 if correlated.

    Where slow errors are states their correlation is known as well.
    """
    table = problem.ranges
    where = np.searchsorted(figures.pair, key)
    total = np.bincount(where, table.variance / table.weight_variance, figures.pair.size)
    worth: Floats = total / figures.total
    slow = bool(np.any(problem.errors.slow >= 0))
    return np.minimum(worth, MIN_WHITE_SHARE) if slow else worth


def misfit_pairs(
    figures: PairResiduals, worth: Floats, max_rejected: float = MAX_PAIR_REJECTED_SHARE
) -> NDArray[np.bool_]:
    """Which pairs (P,) do not fit beyond chance and harmlessness."""
    limit = -normal_quantile(FALSE_ALARM_PROBABILITY / (8.0 * max(figures.pair.size, 1)))
    with np.errstate(invalid="ignore"):
        shifted = (np.abs(offset_score(figures, worth)) > limit) & (
            np.abs(figures.offset) > MAX_OFFSET_SIGMAS
        )
        repeated = (
            (correlation_score(figures) > limit)
            & (figures.repeat > MAX_AUTOCORRELATION)
            & (worth > MIN_WHITE_SHARE)
        )
        wide = (nis_score(figures, worth) > limit) & (figures.nis > MAX_PAIR_NIS)
    refused = figures.total - figures.accepted
    refused_often = (refused > max_rejected * figures.total) & (refused >= MIN_PAIR_REJECTED)
    return np.asarray(shifted | repeated | wide | refused_often)


def has_misfit_hint(figures: PairResiduals, worth: Floats, hint: float) -> bool:
    """Whether any pair shows a share of what does harm, beyond chance."""
    limit = -normal_quantile(FALSE_ALARM_PROBABILITY / (8.0 * max(figures.pair.size, 1)))
    with np.errstate(invalid="ignore"):
        shifted = np.abs(figures.offset) > hint * MAX_OFFSET_SIGMAS
        repeated = (figures.repeat > hint * MAX_AUTOCORRELATION) & (worth > MIN_WHITE_SHARE)
        wide = figures.nis > 1.0 + hint * (MAX_PAIR_NIS - 1.0)
    return bool(
        np.any(shifted & (np.abs(offset_score(figures, worth)) > limit))
        or np.any(repeated & (correlation_score(figures) > limit))
        or np.any(wide & (nis_score(figures, worth) > limit))
    )


def rerun_budget(problem: Problem, most: int) -> int:
    """How many ranges to run through again: `most` for small teams."""
    return max(int(most * min(1.0, (SMALL_STATE_SIZE / problem.mean.size) ** 2)), 200)


def late_odometry(trial: CauseSearch) -> Cause | None:
    """The robot whose odometry is late against the ranges, or all, where that is beyond doubt.

    Looked for with the ranges that were accepted: lateness hides in trajectories that fit them.
    """
    problem = trial.problem
    drivers = moving_drivers(problem)
    use = (trial.solution.verdict == eskf_state.RANGE_USED) & (problem.ranges.stamp > problem.start)
    if not 0 < len(drivers) <= MAX_DELAY_DRIVERS or not np.any(use):
        return None
    case = make_rerun_case(
        problem, trial.settings, trial.source, use, rerun_budget(problem, MAX_DELAY_RANGES)
    )
    base = rerun_filter(case, case.problem)
    if not np.isfinite(base.cost):
        return None
    found = parameter_evidence(case, base, [LogParameter("late", d) for d in drivers])
    best: tuple[float, Cause] | None = None
    groups = [*((key,) for key in found.keys), *([found.keys] if len(drivers) > 1 else [])]
    for keys in groups:
        value, sigma = found.along(dict.fromkeys(keys, 1.0))
        who = (problem.drivers[keys[0].of],) if len(keys) == 1 else ()
        if abs(value) > max(MIN_HARMFUL_DELAY_S, MIN_DELAY_SIGMAS * sigma) and (
            best is None or abs(value / sigma) > best[0]
        ):
            best = abs(value / sigma), Cause("late", who, value)
    return None if best is None else best[1]


def explain_misfit(trial: CauseSearch, names: Sequence[str], *, gross: bool) -> Cause | None:
    """The likely cause of a misfit, from runs over the beginning of the log.

    `gross`: so much is wrong that rejected ranges may be right.
    """
    problem = trial.problem
    use = problem.ranges.stamp > problem.start
    if gross:
        use &= problem.ranges.stamp > problem.start + round(max(CLOCK_DELAYS_S) * 1e9)
    else:
        use &= trial.solution.verdict == eskf_state.RANGE_USED
    if not np.any(use):
        return None
    case = make_rerun_case(
        problem, trial.settings, trial.source, use, rerun_budget(problem, MAX_CAUSE_RANGES)
    )
    base = rerun_filter(case, case.problem)
    return likely_cause(case, base, names, gross=gross) if np.isfinite(base.cost) else None


def is_harmful(cause: Cause, problem: Problem) -> bool:
    """Whether a cause is large enough to matter."""
    sigma = float(np.sqrt(np.median(problem.ranges.variance)))
    least = {
        "offset": max(0.03, 0.5 * sigma),
        "gain": 0.015,
        "late": MIN_HARMFUL_DELAY_S,
        "clock": MIN_HARMFUL_DELAY_S,
        "anchor": max(0.1, sigma),
        "scale": 0.03,
        "turn scale": 0.05,
        "bias": 0.02,
        "range noise": 1.5,
        "odometry noise": 1.5,
    }
    return abs(cause.value) >= least.get(cause.kind, 0.0)
