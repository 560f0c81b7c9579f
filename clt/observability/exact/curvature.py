"""Directions that ranges miss to first order only, as of a robot exactly on the anchors' line.

Where the rank drops at a special state, its null space may hold more than what never shows. Let
F be all functions of all pairs. A motion v t + w t^2 / 2 leaves F the same to second order if and
only if dF v = 0 and dF w = -v^T (d2F) v; where that has no solution w, ranges determine v to second
order: little at such a state, and the more the further the team is from it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from clt.observability.exact.codistribution import PairKind, lie_derivatives
from clt.observability.exact.polynomial import Polynomial, gradient
from clt.observability.exact.rank import (
    PRIME,
    MatrixBlock,
    Residues,
    SimilarPairs,
    evaluate_polynomial,
    group_similar_pairs,
    matrix_blocks,
    null_spaces,
    pair_powers,
)
from clt.observability.exact.setup import Setup
from clt.observability.exact.states import ExactPose

Hessian = tuple[tuple[Polynomial, ...], ...]


@lru_cache(maxsize=128)
def hessians(kind: PairKind) -> tuple[Hessian, ...]:
    """Second derivatives of the functions of a pair, (6, 6) in the order of their gradients."""
    return tuple(tuple(gradient(entry) for entry in row.gradient) for row in lie_derivatives(kind))


def is_special(setup: Setup) -> bool:
    """Whether states are none of general position, so that ranks may drop at them."""
    return len(setup.in_line) > 0 or len(setup.parallel) > 0


def second_order_test(setup: Setup, state: Sequence[ExactPose]) -> Callable[[Residues], bool]:
    """Make the test whether a null direction (dimension,) stays open to second order as well.

    In general position it does: there the rank is the same at all states nearby.
    """
    if not is_special(setup):
        return lambda _: True
    blocks = matrix_blocks(setup, state)
    seconds = [second_derivatives(setup, state, part) for part in group_similar_pairs(setup)]
    linear = [np.zeros((), np.int64) for _ in blocks[len(seconds) :]]  # what fixes the frame
    return lambda v: _solvable(blocks, [*seconds, *linear], v)


def second_derivatives(setup: Setup, state: Sequence[ExactPose], part: SimilarPairs) -> Residues:
    """v^T H v of pairs that are alike is made of these, shape (pairs, rows, m, m)."""
    powers = pair_powers(setup, part.pairs, state)
    values = [
        [[evaluate_polynomial(hessian[j][k], powers) for k in part.entries] for j in part.entries]
        for hessian in hessians(part.kind)
    ]
    return np.ascontiguousarray(np.array(values).transpose(3, 0, 1, 2))


def _solvable(blocks: Sequence[MatrixBlock], seconds: Sequence[Residues], v: Residues) -> bool:
    """Whether dF w = -v^T (d2F) v for some w: whether the null space of (dF, bend) reaches bend."""
    bent, straight = [], []
    for block, H in zip(blocks, seconds, strict=True):
        bend = np.zeros(block.rows.shape[:2], np.int64)
        touched = np.flatnonzero(np.any(v[block.columns] != 0, axis=1))
        if H.ndim > 0 and touched.size > 0:
            own = v[block.columns[touched]]
            once = np.sum(H[touched] * own[:, None, None, :] % PRIME, axis=3) % PRIME
            bend[touched] = np.sum(once * own[:, None, :] % PRIME, axis=2) % PRIME
        column = np.full((len(block.columns), 1), v.size)
        whole = MatrixBlock(
            np.concatenate([block.columns, column], axis=1),
            np.concatenate([block.rows, bend[:, :, None]], axis=2),
        )
        first = np.any(bend != 0, axis=1)
        bent.append(MatrixBlock(whole.columns[first], whole.rows[first]))
        straight.append(MatrixBlock(whole.columns[~first], whole.rows[~first]))
    return all(np.any(space[-1]) for space in null_spaces([*bent, *straight], v.size + 1))
