"""Ranges that fit to nothing: a few wild ones shall not hide the pose that explains all others."""

from __future__ import annotations

import numpy as np

from clt.init.pair_expansion import work_for
from clt.init.pair_likelihood import Pair
from clt.init.pair_solutions import best_found, chosen, fewer

MISFIT = 3.0
"""Standard deviations by which residuals may exceed their noise before that is not believed."""
WILD = 5
"""One range in as many may be wild."""


def fits(cost: float, n: int, turns: bool) -> bool:
    """Whether n squared residuals of a best pose (in units of their variance) may be noise."""
    free = n - (3 if turns else 2)
    return free <= 0 or cost <= free + MISFIT * np.sqrt(2.0 * free)


def without_wild(pair: Pair, turns: bool) -> Pair | None:
    """A pair without the ranges that keep all others from being explained.

    One after the other, that without which the rest fits best. None where one in WILD is not
    enough, or too few are left to tell.
    """
    n = pair.z.size
    for _ in range(n // WILD):
        left = [chosen(pair, np.delete(np.arange(pair.z.size), k)) for k in range(pair.z.size)]
        cost = [best_found(rest, fewer(rest), turns, work_for(rest)) for rest in left]
        pair = left[int(np.argmin(cost))]
        if fits(min(cost), pair.z.size, turns):
            return pair if pair.z.size > (4 if turns else 3) else None
    return None
