"""When a filter is wrong about a robot: noticing it, and searching for the robot anew.

A gate keeps outliers out, but also the truth once the estimate has gone astray while its
covariance is small. A robot counts as lost when most of its ranges, with several partners, were
rejected for some seconds; its pose is then forgotten and estimated again from the next ranges.
"""

from __future__ import annotations

import numpy as np

from clt.filters.compiled import inlined, lean
from clt.streams import Floats, Indices

SINCE, ACCEPTED, CONTRADICTED, ACCUSER, LOST = 0, 1, 2, 3, 4
"""Columns of a filter's memory: ns, ranges accepted and rejected since then, who disagreed, and how
often the robot was lost."""
NOBODY, SEVERAL = -1_000_000, -1_000_001
"""Who contradicts a robot, where it is not one partner."""
LOST_HEADING = 1.0
"""Standard deviation of the heading of a robot that was lost, rad."""


@inlined
def widen(P: Floats, i: int, spread: float) -> None:
    """Forget where robot i is: position to `spread` m, heading to LOST_HEADING, no correlation."""
    for r in range(3 * i, 3 * i + 3):
        for c in range(P.shape[0]):
            P[r, c] = P[c, r] = 0.0
    P[3 * i, 3 * i] = P[3 * i + 1, 3 * i + 1] = spread * spread
    P[3 * i + 2, 3 * i + 2] = LOST_HEADING * LOST_HEADING


def fresh_memory(n: int, start: int) -> Indices:
    """Memory of n robots, shape (n, 5), at the time `start` (ns)."""
    return np.tile(np.array([start, 0, 0, NOBODY, 0]), (n, 1))


@lean
def remember(i: int, partner: int, used: bool, memory: Indices) -> None:
    """Note for robot i that a range with `partner` was accepted or rejected."""
    if i < 0:
        return
    if used:
        memory[i, ACCEPTED] += 1
        return
    memory[i, CONTRADICTED] += 1
    if memory[i, ACCUSER] == NOBODY:
        memory[i, ACCUSER] = partner
    elif memory[i, ACCUSER] != partner:
        memory[i, ACCUSER] = SEVERAL


@inlined
def worst(i: int, a: Indices, b: Indices, residual: Floats, m: int, last: int) -> float:
    """Largest absolute residual of robot i among the ranges m .. last - 1."""
    largest = 0.0
    for k in range(m, last):
        if a[k] == i or b[k] == i:
            largest = max(largest, abs(residual[k]))
    return largest


@lean
def reacquire(
    P: Floats, a: Indices, b: Indices, residual: Floats, m: int, last: int,
    now: int, memory: Indices, patience: int,
) -> bool:  # fmt: skip
    """Widen the robots that most of their ranges contradicted over the last `patience` ns.

    Ranges m .. last - 1 are those of the time `now` (ns). Only where several partners contradict:
    one alone may be the one that is wrong. Returns whether any robot was lost.
    """
    any_lost = False
    for i in range(memory.shape[0]):
        if now - memory[i, SINCE] <= patience:
            continue
        if memory[i, ACCUSER] == SEVERAL and memory[i, CONTRADICTED] > memory[i, ACCEPTED]:
            spread = worst(i, a, b, residual, m, last)
            if spread > 0.0:
                widen(P, i, spread)
                memory[i, LOST] += 1
                any_lost = True
        memory[i, SINCE], memory[i, ACCUSER] = now, NOBODY
        memory[i, ACCEPTED] = memory[i, CONTRADICTED] = 0
    return any_lost
