"""The observability matrix of a team in floating point, for people and for comparisons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clt.core.arrays import Floats
from clt.observability.exact.codistribution import lie_derivatives
from clt.observability.exact.polynomial import Polynomial
from clt.observability.exact.rank import state_entries
from clt.observability.exact.setup import Setup
from clt.observability.exact.states import ExactPose


def evaluate_as_float(p: Polynomial, numbers: Floats) -> float:
    """A polynomial at (x, y, c, s) of end a, then of end b, then the speeds of both."""
    return float(sum(float(factor) * np.prod(numbers ** np.array(m)) for m, factor in p.items()))


def observability_matrix(setup: Setup, state: Sequence[ExactPose]) -> Floats:
    """Rows: gradients of Lie derivatives, pair by pair and by order; columns: the state."""
    parts = [np.zeros((0, len(setup.columns)))]
    for pair in setup.pairs:
        ends = [state[k] for k in setup.ordered(pair)]
        poses = [value for p in ends for value in (p.x, p.y, p.c, p.s)]
        numbers = np.array([*poses, *(p.v for p in ends)], dtype=np.float64)
        found = lie_derivatives(setup.kind(pair))
        entries, columns = state_entries(setup, pair)
        block = np.zeros((len(found), len(setup.columns)))
        for r, row in enumerate(found):
            block[r, list(columns)] = [evaluate_as_float(row.gradient[k], numbers) for k in entries]
        parts.append(block)
    return np.concatenate(parts)
