"""How a filter's residuals change when one thing about a log is otherwise, by running it again.

Each parameter (an offset of one node's ranges, a delay of one robot's odometry, ...) is taken out
of the problem by a small step and the error-state Kalman filter is run once more: the difference of
the residuals is their derivative. What best explains the residuals that are there then follows from
linear least squares (generalized likelihood ratio, Willsky and Jones 1976).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices
from clt.filters.kalman import gaussian
from clt.model.filter_inputs import Outputs
from clt.model.known_odometry import segments_after
from clt.model.problem import Problem
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings

MAX_RESIDUAL_SIGMAS = 4.0
"""A residual of more standard deviations is not evidence of how things change a little."""

ParameterKind = Literal[
    "offset", "pair", "gain", "late", "ranges late", "x", "y", "scale", "turn scale", "bias"
]
DERIVATIVE_STEPS: dict[ParameterKind, float] = {
    "offset": 0.01,
    "pair": 0.01,
    "gain": 0.002,
    "late": 0.02,
    "ranges late": 0.02,
    "x": 0.01,
    "y": 0.01,
    "scale": 0.01,
    "turn scale": 0.01,
    "bias": 0.002,
}
"""Of the derivatives: m, m, share, s, s, m, m, share, share, rad/s."""
PAIR_KEY_FACTOR = 1_000_003
"""More than there are range ends."""
SEGMENT_COLUMNS = {"late": "end", "scale": "v", "turn scale": "omega", "bias": "omega"}
"""The column of a driver's twist segments that a parameter changes."""


class LogParameter(NamedTuple):
    """A parameter."""

    kind: ParameterKind
    of: int = 0
    """Its driver (late, scale, turn scale, bias), range end (offset, x, y), pair (`range_pair_key`
    says) or the team index of the robot that measured (ranges late)."""


@dataclass(frozen=True)
class RerunCase:
    """A problem to run again and again, without outputs; every range is accepted."""

    problem: Problem
    settings: FilterSettings
    source: Indices
    """Team index of the robot that measured each row of the recording's ranges."""


@dataclass(frozen=True)
class RunResiduals:
    """What one run leaves, in the order of the rows of the recording's ranges."""

    predicted: Floats
    """The range that was expected, m."""
    residual: Floats
    """m."""
    sigma: Floats
    """As the filter weighs it, m: larger than predicted where errors are correlated in time."""

    @property
    def z(self) -> Floats:
        """Residuals in standard deviations."""
        return self.residual / self.sigma

    @property
    def cost(self) -> float:
        """Twice the negative log-likelihood but for a constant, no range counting beyond 4 sigma.

        Infinite where the run does not hold numbers.
        """
        z = np.minimum(np.abs(self.z), MAX_RESIDUAL_SIGMAS)
        total = float(np.sum(z * z + 2.0 * np.log(self.sigma)))
        return total if np.isfinite(total) else np.inf


def make_rerun_case(
    problem: Problem, settings: FilterSettings, source: Indices, use: NDArray[np.bool_], most: int
) -> RerunCase:
    """The first `most` of the ranges `use` (M,) of a problem, all of them to be accepted."""
    rows = np.flatnonzero(use)[:most]
    table = RangeTable._make(column[rows] for column in problem.ranges)
    end = int(table.stamp[-1]) if rows.size > 0 else problem.start
    none = Outputs(np.empty(0, np.int64), np.empty(0, np.int64))
    accepting = problem.errors._replace(outliers=problem.errors.outliers._replace(active=0))
    short = replace(problem, ranges=table, errors=accepting, outputs=none, end=end, memory=None)
    free = settings.model_copy(update={"gate": 0.0, "process": "exact"})
    return RerunCase(short, free, source)


def range_pair_key(table: RangeTable) -> Indices:
    """One number for each pair of range ends, shape (M,)."""
    keys: Indices = np.minimum(table.a, table.b) * PAIR_KEY_FACTOR + np.maximum(table.a, table.b)
    return keys


def rerun_filter(case: RerunCase, problem: Problem) -> RunResiduals:
    """Run the error-state Kalman filter on a problem that holds the case's ranges."""
    table = problem.ranges
    solution = gaussian.solve_eskf(problem, case.settings)
    weighed = solution.variance + table.weight_variance - table.variance
    sigma = np.sqrt(np.where(weighed > 0.0, weighed, np.nan))
    order = np.argsort(table.row, kind="stable")
    columns = (table.range - solution.residual, solution.residual, sigma)
    return RunResiduals(*(column[order] for column in columns))


def remove_effects(
    case: RerunCase, base: RunResiduals, values: dict[LogParameter, float]
) -> Problem:
    """The problem with parameters of these values taken out of what was measured.

    `base`: of the problem as it is; a gain acts on what it predicts, for measured ranges are noisy.
    """
    problem = case.problem
    for key, value in values.items():
        if key.kind in SEGMENT_COLUMNS:
            problem = _odometry(problem, key, value)
        elif key.kind == "ranges late":
            problem = _earlier(problem, case.source[problem.ranges.row] == key.of, value)
        else:
            problem = _ranged(problem, base, key, value)
    return problem


def _odometry(problem: Problem, key: LogParameter, value: float) -> Problem:
    """The segments of one driver changed."""
    segments = problem.segments
    own = slice(segments.first[key.of], segments.first[key.of + 1])
    name = SEGMENT_COLUMNS[key.kind]
    column = getattr(segments, name).copy()
    if key.kind == "late":
        column[own] -= round(value * 1e9)
        return replace(
            problem, segments=segments_after(segments._replace(end=column), problem.start)
        )
    if key.kind == "bias":
        column[own] -= value
    else:
        column[own] *= 1.0 - value
    return replace(problem, segments=segments._replace(**{name: column}))


def _earlier(problem: Problem, mine: NDArray[np.bool_], seconds: float) -> Problem:
    """Some of the ranges stamped earlier, not before the start."""
    table = problem.ranges
    stamp = np.maximum(table.stamp - np.where(mine, round(seconds * 1e9), 0), problem.start + 1)
    order = np.argsort(stamp, kind="stable")
    table = RangeTable._make(column[order] for column in table._replace(stamp=stamp))
    return replace(problem, ranges=table)


def _ranged(problem: Problem, base: RunResiduals, key: LogParameter, value: float) -> Problem:
    """The ranges, or the anchors that they reach to, changed."""
    table = problem.ranges
    if key.kind == "gain":
        at = np.argsort(np.argsort(table.row, kind="stable"), kind="stable")
        return replace(
            problem, ranges=table._replace(range=table.range - value * base.predicted[at])
        )
    meets = (table.a == key.of) | (table.b == key.of)
    if key.kind == "pair":
        meets = range_pair_key(table) == key.of
    if key.kind in {"offset", "pair"}:
        return replace(problem, ranges=table._replace(range=table.range - value * meets))
    anchor = table.anchor.copy()
    anchor[meets, 0 if key.kind == "x" else 1] -= value
    return replace(problem, ranges=table._replace(anchor=anchor))


@dataclass(frozen=True)
class ParameterEvidence:
    """Normal equations of the parameters that were tried."""

    keys: tuple[LogParameter, ...]
    information: Floats
    """Shape (p, p)."""
    score: Floats
    """Shape (p,)."""

    def along(self, weights: dict[LogParameter, float]) -> tuple[float, float]:
        """Estimate of a common factor of some parameters, and its standard deviation.

        Infinite deviation where nothing is known of it.
        """
        c = np.array([weights.get(key, 0.0) for key in self.keys])
        known = float(c @ self.information @ c)
        return (float(c @ self.score) / known, known**-0.5) if known > 0.0 else (0.0, np.inf)


def parameter_evidence(
    case: RerunCase, base: RunResiduals, keys: Sequence[LogParameter]
) -> ParameterEvidence:
    """What the residuals of the base run say about parameters, each by one more run."""
    inside = np.abs(base.z) <= MAX_RESIDUAL_SIGMAS
    G = np.zeros((len(keys), base.residual.size))
    for row, key in zip(G, keys, strict=True):
        step = DERIVATIVE_STEPS[key.kind]
        other = rerun_filter(case, remove_effects(case, base, {key: step}))
        row[inside] = ((base.residual - other.residual) / step / base.sigma)[inside]
    G[~np.isfinite(G)] = 0.0
    z = np.where(inside, base.z, 0.0)
    return ParameterEvidence(tuple(keys), G @ G.T, G @ z)
