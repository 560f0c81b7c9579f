"""Single distances that contradict a layout are left out of its fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices
from clt.initialization.motion.layout_fit import (
    LayoutProblem,
    cost_of_fit,
    fit_layout,
    is_contradictory,
    is_well_posed,
    select_pairs,
)

OUTLIER_WORK, MIN_TRIALS = 1_000_000_000, 2
"""Operations of a search for outliers, of which 10^9 take about half a second, and as many
distances are tried at a time whatever that allows."""


def fit_without_outliers(
    problem: LayoutProblem, best: tuple[Floats, float], other: Floats
) -> tuple[tuple[Floats, float], NDArray[np.bool_], bool]:
    """The fit without as few distances as make the rest agree; with all of them if none do.

    One after the other, that one is left out whose absence helps most, from two starts; where
    several would make the rest agree, the one that is off by least. At most half as many as there
    are more distances than unknowns: agreement must mean something. Of large layouts only the most
    suspicious distances are tried, and only so many; the last value says whether that was enough.
    """
    everything = np.ones(problem.pairs.a.size, np.bool_)
    used, fit = everything.copy(), best
    fits_left = max(16 * MIN_TRIALS, OUTLIER_WORK // (6 * problem.step_work))
    for _ in range((used.size - int(problem.free.sum())) // 2):
        trials, agreeing = [], []
        most = max(MIN_TRIALS, fits_left // 16)
        for k in most_suspicious(problem, used, fit[0], other)[:most].tolist():
            rest = used.copy()
            rest[k] = False
            kept = replace(problem, pairs=select_pairs(problem.pairs, rest))
            if is_well_posed(kept, fit[0]):
                found = min(
                    (fit_layout(kept, s) for s in (problem.place(fit[0]), other)), key=cost_of_fit
                )
                trials.append((found[1], rest, found))
                if not is_contradictory(kept, found):
                    off = abs(float((problem.residual(found[0]) * problem.pairs.sigma)[k]))
                    agreeing.append((off, rest, found))
            fits_left -= 2
        if len(trials) == 0:
            break
        _, used, fit = min(agreeing or trials, key=lambda trial: trial[0])
        if len(agreeing) > 0:
            return fit, used, True
        if fits_left <= 0:
            return best, everything, False
    return best, everything, True


def most_suspicious(
    problem: LayoutProblem, used: NDArray[np.bool_], parameters: Floats, other: Floats
) -> Indices:
    """The used distances, those first whose absence would lower a sum of squares most.

    That is r^2 / (1 - h) in the fit, h the leverage, and r^2 in the `other` layout (n, 2).
    """
    J = problem.jacobian(parameters)[used]
    leverage = np.sum(np.linalg.svd(J, full_matrices=False)[0] ** 2, axis=1)
    gain = problem.residual(parameters)[used] ** 2 / np.maximum(1.0 - leverage, 1e-6)
    gain = np.maximum(gain, problem.residual(other[problem.free])[used] ** 2)
    return np.asarray(np.flatnonzero(used)[np.argsort(-gain, kind="stable")])
