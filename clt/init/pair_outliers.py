"""Ranges that fit to nothing: a few wild ones shall not hide the pose that explains all others."""

from __future__ import annotations

import numpy as np

from clt.init.pair_expansion import work_for
from clt.init.pair_likelihood import Pair
from clt.init.pair_solutions import best_found, chosen, fewer

MISFIT = 3.0
"""Standard deviations by which squared residuals may exceed their noise to be believed."""
WILD = 5
"""One range in as many may be wild ..."""
OFF = 6.0
"""... and is off by at least so many standard deviations: noise that is merely larger is not."""


def plausible(squared: float, count: int) -> bool:
    """Whether squares of so many numbers, in units of their variance, may add up to as much."""
    return squared <= count + MISFIT * float(np.sqrt(2.0 * count))


def spare(n: int, turns: bool) -> int:
    """How many of n ranges are more than a pose has unknowns."""
    return n - (3 if turns else 2)


def fits(cost: float, n: int, turns: bool) -> bool:
    """Whether n squared residuals of a best pose (in units of their variance) may be noise.

    Also as few as a pose can follow: those that contradict each other no pose explains.
    """
    left = spare(n, turns)
    return plausible(cost, left) if left > 0 else cost <= MISFIT * MISFIT


def without_wild(pair: Pair, turns: bool, cost: float) -> Pair | None:
    """A pair, which costs so much, without the ranges that keep all others from being explained.

    One after the other, that without which the rest fits best. None where one in WILD is not
    enough, where they are not OFF, or too few are left to tell.
    """
    n = pair.z.size
    for out in range(1, n // WILD + 1):
        left = [chosen(pair, np.delete(np.arange(pair.z.size), k)) for k in range(pair.z.size)]
        costs = [best_found(rest, fewer(rest), turns, work_for(rest)) for rest in left]
        pair = left[int(np.argmin(costs))]
        if fits(min(costs), pair.z.size, turns):
            told = spare(pair.z.size, turns) > 1 and cost - min(costs) >= OFF * OFF * out
            return pair if told else None
    return None
