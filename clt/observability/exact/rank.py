"""Rank and null space of a team's observability matrix at an exact state, modulo a prime.

All entries are rational, so that arithmetic modulo a prime is exact, and a rank found there is
the true one unless the prime divides a minor, which for random states has a chance of about
1e-9 times the degree; several states are tried. The null space is found by cutting the whole
state space with one pair's few rows after the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.observability.exact.codistribution import PairKind, lie_derivatives
from clt.observability.exact.polynomial import Polynomial
from clt.observability.exact.setup import Setup
from clt.observability.exact.states import ExactPose

PRIME = 2**31 - 1
Residues = NDArray[np.int64]
"""Numbers modulo PRIME; products of two fit into 63 bits."""


def residue(value: Fraction | int) -> int:
    """A rational number modulo PRIME."""
    fraction = Fraction(value)
    return fraction.numerator * pow(fraction.denominator, -1, PRIME) % PRIME


def evaluate_polynomial(p: Polynomial, powers: Residues) -> Residues:
    """A polynomial at many pairs: powers (degree + 1, 10, n) of the variables -> (n,)."""
    total = np.zeros(powers.shape[2], np.int64)
    for monomial, value in p.items():
        term = np.full(powers.shape[2], residue(value), np.int64)
        for place, power in enumerate(monomial):
            if power > 0:
                term = term * powers[power, place] % PRIME
        total = (total + term) % PRIME
    return total


@lru_cache(maxsize=4)
def residues_of(state: tuple[ExactPose, ...]) -> Residues:
    """The five numbers of each place, shape (places, 5)."""
    numbers = [[residue(value) for value in (p.x, p.y, p.c, p.s, p.v)] for p in state]
    return np.array(numbers).reshape(-1, 5)


def pair_powers(
    setup: Setup, pairs: Sequence[tuple[int, int]], state: Sequence[ExactPose], degree: int = 8
) -> Residues:
    """Powers 0 .. degree of the ten variables of each pair, shape (degree + 1, 10, n)."""
    numbers = residues_of(tuple(state))
    ends = np.array([setup.ordered(pair) for pair in pairs]).reshape(-1, 2)
    a, b = numbers[ends[:, 0]].T, numbers[ends[:, 1]].T
    base = np.stack([*a[:4], *b[:4], a[4], b[4]])
    powers = np.ones((degree + 1, *base.shape), np.int64)
    for k in range(degree):
        powers[k + 1] = powers[k] * base % PRIME
    return powers


def pairs_by_kind(setup: Setup) -> Mapping[PairKind, list[tuple[int, int]]]:
    """The pairs that share their functions."""
    found: dict[PairKind, list[tuple[int, int]]] = {}
    for pair in setup.pairs:
        found.setdefault(setup.kind(pair), []).append(pair)
    return found


class SimilarPairs(NamedTuple):
    """Pairs with the same functions, of which the same entries touch the state."""

    kind: PairKind
    pairs: list[tuple[int, int]]
    entries: tuple[int, ...]
    """Of the gradient, shape (k,)."""
    columns: Residues
    """Where they stand in the state, shape (pairs, k)."""


def group_similar_pairs(setup: Setup) -> list[SimilarPairs]:
    """All pairs that touch the state."""
    found = []
    for kind, pairs in pairs_by_kind(setup).items():
        parts: dict[tuple[int, ...], list[tuple[tuple[int, int], tuple[int, ...]]]] = {}
        for pair in pairs:
            entries, places = state_entries(setup, pair)
            parts.setdefault(tuple(entries), []).append((pair, places))
        for chosen, own in parts.items():
            if len(chosen) > 0:
                columns = np.array([places for _, places in own])
                found.append(SimilarPairs(kind, [pair for pair, _ in own], chosen, columns))
    return found


class MatrixBlock(NamedTuple):
    """Rows (pairs, r, k) of pairs whose functions are the same, and their columns (pairs, k)."""

    columns: Residues
    rows: Residues


def matrix_blocks(setup: Setup, state: Sequence[ExactPose]) -> list[MatrixBlock]:
    """The observability matrix at a state: what touches the state, as `group_similar_pairs` has it.

    Where the first static robots span the world, what that fixes comes last.
    """
    blocks = []
    for part in group_similar_pairs(setup):
        powers = pair_powers(setup, part.pairs, state)
        values = np.array(
            [
                [evaluate_polynomial(row.gradient[entry], powers) for entry in part.entries]
                for row in lie_derivatives(part.kind)
            ]
        )  # (rows, k, pairs)
        blocks.append(MatrixBlock(part.columns, np.ascontiguousarray(values.transpose(2, 0, 1))))
    if setup.framed:
        first, second = (setup.first_column[k] for k in setup.frame_robots)
        fixed = np.array([[first, first + 1, second + 1]])
        blocks.append(MatrixBlock(fixed, np.eye(3, dtype=np.int64)[None]))
    return blocks


def state_entries(setup: Setup, pair: tuple[int, int]) -> tuple[list[int], tuple[int, ...]]:
    """Entries of a pair's gradient that belong to the state, and their columns."""
    entries: list[int] = []
    columns: list[int] = []
    for k, robot in enumerate(setup.ordered(pair)):
        first = setup.first_column[robot]
        if first >= 0:
            size = 2 if setup.nodes[robot].static else 3
            entries += range(3 * k, 3 * k + size)
            columns += range(first, first + size)
    return entries, tuple(columns)


def null_space(setup: Setup, state: Sequence[ExactPose]) -> Residues:
    """Basis of the directions that no row sees, shape (dimension, nullity), modulo PRIME."""
    *_, space = null_spaces(matrix_blocks(setup, state), len(setup.columns))
    return space


def null_spaces(blocks: Sequence[MatrixBlock], dimension: int) -> Iterator[Residues]:
    """Bases of what rows do not see, from the whole space to the null space of all rows."""
    space = np.eye(dimension, dtype=np.int64)
    yield space
    for block in blocks:
        alone = 2 * dimension // 3
        for k in range(min(alone, len(block.columns))):
            space = cut_null_space(space, block, k)
            yield space
        rest = np.arange(alone, len(block.columns))
        while rest.size > 0 and space.shape[1] > 0:  # as a rule these see nothing more
            seen = multiply_modulo_prime(block.rows[rest], space[block.columns[rest]])
            rest = rest[np.any(seen != 0, axis=(1, 2))]
            if rest.size > 0:
                space = cut_null_space(space, block, int(rest[0]))
                yield space


def cut_null_space(space: Residues, block: MatrixBlock, k: int) -> Residues:
    """The part of a space (d, m) that one pair's rows do not see."""
    seen = multiply_modulo_prime(block.rows[k], space[block.columns[k]])
    while np.any(seen):
        r, j = np.argwhere(seen)[0]
        share = seen[r] * pow(int(seen[r, j]), -1, PRIME) % PRIME
        share[j] = 0
        space = np.delete((space - space[:, [j]] * share) % PRIME, j, axis=1)
        seen = np.delete((seen - seen[:, [j]] * share) % PRIME, j, axis=1)
    return space


def multiply_modulo_prime(A: Residues, B: Residues) -> Residues:
    """A B modulo PRIME, shapes (..., r, k) and (..., k, m), for a small k."""
    terms = A[..., :, :, None] * B[..., None, :, :] % PRIME
    return np.asarray(np.sum(terms, axis=-2) % PRIME)


def column_echelon(space: Residues) -> tuple[Residues, list[int]]:
    """The same column space with an identity in the pivot rows that are returned."""
    space = space.copy()
    pivots: list[int] = []
    for column in range(space.shape[1]):
        row = int(np.argmax(np.any(space[:, column:] != 0, axis=1)))
        best = column + int(np.argmax(space[row, column:] != 0))
        space[:, [column, best]] = space[:, [best, column]]
        space[:, column] = space[:, column] * pow(int(space[row, column]), -1, PRIME) % PRIME
        share = space[row].copy()
        share[column] = 0
        space = (space - space[:, [column]] * share) % PRIME
        pivots.append(row)
    return space, pivots
