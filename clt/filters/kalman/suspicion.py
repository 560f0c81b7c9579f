"""Which robots look lost: many of their ranges, with several partners, were rejected of late.

A gate keeps outliers out, but also the truth once an estimate has gone astray while its covariance
is small. Only where several partners contradict: one alone may be the one that is wrong.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Indices, Stamps
from clt.jit.compiled import compiled_noalloc

NEXT_CHECK, ACCEPTED_COUNT, REJECTED_COUNT, REJECTING_PARTNER, SEARCH_COUNT, FOUND_COUNT = (
    0,
    1,
    2,
    3,
    4,
    5,
)
"""Columns of the record: when the robot is judged next (ns), its ranges accepted and rejected since
it was judged last, who disagreed, how often it was searched for and how often that was right."""
NO_PARTNER, SEVERAL_PARTNERS = -1_000_000, -1_000_001
"""Who contradicts a robot, where it is not one partner."""
LOST_REJECTED_SHARE = 0.4
"""A robot looks lost when more than this share of its ranges is rejected: of two that are lost in
the same way, and of four partners, each is contradicted by two."""


def new_verdict_record(n: int, due: int) -> Indices:
    """The record of n robots that are judged at the time `due` (ns) first, shape (n, 6)."""
    return np.tile(np.array([due, 0, 0, NO_PARTNER, 0, 0]), (n, 1))


def reset_verdict_record(record: Indices, robots: NDArray[np.bool_], due: int) -> None:
    """Forget in place what the ranges of some `robots` (n,) said; they are judged next when due."""
    record[robots, :SEARCH_COUNT] = due, 0, 0, NO_PARTNER


def robots_that_look_lost(record: Indices) -> NDArray[np.bool_]:
    """Whether its ranges contradict each robot, whenever it is judged, shape (n,)."""
    many = record[:, REJECTED_COUNT] > LOST_REJECTED_SHARE * (
        record[:, ACCEPTED_COUNT] + record[:, REJECTED_COUNT]
    )
    lost: NDArray[np.bool_] = many & (record[:, REJECTING_PARTNER] == SEVERAL_PARTNERS)
    return lost


@compiled_noalloc
def count_verdict(record: Indices, i: int, partner: int, used: bool) -> None:
    """Enter for robot i (none if negative) that a range with `partner` was accepted or rejected."""
    if i < 0:
        return
    if used:
        record[i, ACCEPTED_COUNT] += 1
        return
    record[i, REJECTED_COUNT] += 1
    if record[i, REJECTING_PARTNER] == NO_PARTNER:
        record[i, REJECTING_PARTNER] = partner
    elif record[i, REJECTING_PARTNER] != partner:
        record[i, REJECTING_PARTNER] = SEVERAL_PARTNERS


@compiled_noalloc
def find_next_lost(
    record: Indices, a: Indices, b: Indices, stamp: Stamps, verdict: Indices, m: int, patience: int
) -> int:
    """Go on through the verdicts on ranges from row m; the first row by which a robot looks lost.

    Robots are judged every `patience` ns, where a range comes, by what came before it. Ends with
    the number of rows where nobody looks lost; verdict: 0 for a range that was rejected.
    """
    while m < stamp.size:
        now, lost = stamp[m], False
        for i in range(record.shape[0]):
            if now <= record[i, NEXT_CHECK]:
                continue
            rejected = record[i, REJECTED_COUNT]
            many = rejected > LOST_REJECTED_SHARE * (record[i, ACCEPTED_COUNT] + rejected)
            if many and record[i, REJECTING_PARTNER] == SEVERAL_PARTNERS:
                lost = True
            else:
                record[i, NEXT_CHECK], record[i, REJECTING_PARTNER] = now + patience, NO_PARTNER
                record[i, ACCEPTED_COUNT] = record[i, REJECTED_COUNT] = 0
        if lost:
            return m
        while m < stamp.size and stamp[m] == now:
            count_verdict(record, a[m], b[m], verdict[m] != 0)
            count_verdict(record, b[m], a[m], verdict[m] != 0)
            m += 1
    return m
