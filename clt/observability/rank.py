"""Rank and null space of a team's observability matrix at an exact state, modulo a prime.

All entries are rational, so that arithmetic modulo a prime is exact, and a rank found there is
the true one unless the prime divides a minor, which for random states has a chance of about
1e-9 times the degree; several states are tried. The null space is found by cutting the whole
state space with one pair's few rows after the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.observability.codistribution import PairKind, rows
from clt.observability.polynomial import Polynomial
from clt.observability.setup import Setup
from clt.observability.states import Place

PRIME = 2**31 - 1
Residues = NDArray[np.int64]
"""Numbers modulo PRIME; products of two fit into 63 bits."""


def residue(value: Fraction | int) -> int:
    """A rational number modulo PRIME."""
    fraction = Fraction(value)
    return fraction.numerator * pow(fraction.denominator, -1, PRIME) % PRIME


def evaluate(p: Polynomial, powers: Residues) -> Residues:
    """A polynomial at many pairs: powers (degree + 1, 8, n) of the variables -> (n,)."""
    total = np.zeros(powers.shape[2], np.int64)
    for monomial, value in p.items():
        term = np.full(powers.shape[2], residue(value), np.int64)
        for place, power in enumerate(monomial):
            if power > 0:
                term = term * powers[power, place] % PRIME
        total = (total + term) % PRIME
    return total


def powers_of(
    setup: Setup, pairs: Sequence[tuple[int, int]], state: Sequence[Place], degree: int = 8
) -> Residues:
    """Powers 0 .. degree of the eight variables of each pair, shape (degree + 1, 8, n)."""
    numbers = np.array(
        [[residue(value) for value in (place.x, place.y, place.c, place.s)] for place in state]
    ).reshape(-1, 4)
    ends = np.array([setup.ordered(pair) for pair in pairs]).reshape(-1, 2)
    base = np.concatenate([numbers[ends[:, 0]], numbers[ends[:, 1]]], axis=1).T
    powers = np.ones((degree + 1, *base.shape), np.int64)
    for k in range(degree):
        powers[k + 1] = powers[k] * base % PRIME
    return powers


def by_kind(setup: Setup) -> Mapping[PairKind, list[tuple[int, int]]]:
    """The pairs that share their functions."""
    found: dict[PairKind, list[tuple[int, int]]] = {}
    for pair in setup.pairs:
        found.setdefault(setup.kind(pair), []).append(pair)
    return found


class Block(NamedTuple):
    """Rows (pairs, r, k) of pairs whose functions are the same, and their columns (pairs, k)."""

    columns: Residues
    rows: Residues


def matrix_blocks(setup: Setup, state: Sequence[Place]) -> list[Block]:
    """The observability matrix at a state: what touches the state of each pair's rows."""
    blocks = []
    for kind, pairs in by_kind(setup).items():
        powers = powers_of(setup, pairs, state)
        values = np.array(
            [[evaluate(entry, powers) for entry in row.gradient] for row in rows(kind)]
        )  # (rows, 6, pairs)
        alike: dict[tuple[int, ...], list[int]] = {}
        places = [touched(setup, pair) for pair in pairs]
        for k, (entries, _) in enumerate(places):
            alike.setdefault(tuple(entries), []).append(k)
        for chosen, own in alike.items():
            if len(chosen) > 0:
                columns = np.array([places[k][1] for k in own])
                part = values[:, list(chosen)][:, :, own]
                blocks.append(Block(columns, np.ascontiguousarray(part.transpose(2, 0, 1))))
    if setup.framed:
        first, second = (setup.first_column[k] for k in setup.frame_robots)
        fixed = np.array([[first, first + 1, second + 1]])
        blocks.append(Block(fixed, np.eye(3, dtype=np.int64)[None]))
    return blocks


def touched(setup: Setup, pair: tuple[int, int]) -> tuple[list[int], tuple[int, ...]]:
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


def null_space(setup: Setup, state: Sequence[Place]) -> Residues:
    """Basis of the directions that no row sees, shape (dimension, nullity), modulo PRIME."""
    space = np.eye(len(setup.columns), dtype=np.int64)
    for block in matrix_blocks(setup, state):
        alone = 2 * len(setup.nodes)
        for k in range(min(alone, len(block.columns))):
            space = cut(space, block, k)
        rest = np.arange(alone, len(block.columns))
        while rest.size > 0 and space.shape[1] > 0:  # as a rule these see nothing more
            seen = product(block.rows[rest], space[block.columns[rest]])
            rest = rest[np.any(seen != 0, axis=(1, 2))]
            if rest.size > 0:
                space = cut(space, block, int(rest[0]))
    return space


def cut(space: Residues, block: Block, k: int) -> Residues:
    """The part of a space (d, m) that one pair's rows do not see."""
    seen = product(block.rows[k], space[block.columns[k]])
    while np.any(seen):
        r, j = np.argwhere(seen)[0]
        share = seen[r] * pow(int(seen[r, j]), -1, PRIME) % PRIME
        share[j] = 0
        space = np.delete((space - space[:, [j]] * share) % PRIME, j, axis=1)
        seen = np.delete((seen - seen[:, [j]] * share) % PRIME, j, axis=1)
    return space


def product(A: Residues, B: Residues) -> Residues:
    """A B modulo PRIME, shapes (..., r, k) and (..., k, m), for a small k."""
    terms = A[..., :, :, None] * B[..., None, :, :] % PRIME
    return np.asarray(np.sum(terms, axis=-2) % PRIME)


def echelon(space: Residues) -> tuple[Residues, list[int]]:
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
