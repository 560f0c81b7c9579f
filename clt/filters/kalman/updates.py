"""Joint Kalman update with many scalar measurements of one instant, in place.

All measurements share the linearization point, as in the textbook batch update: `count` rows of H
with at most E entries that are not zero: six as a range touches two robots, and those of its
errors. `sequential_update` and `batch_update` give the same posterior; their costs grow as
count N^2 and N^3.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices
from clt.jit.compiled import compiled_noalloc, inlined, kernel

POSE_ENTRIES, ALL_ENTRIES = 6, 10
"""Entries of H for the poses of two robots; and for the lasting errors of the range as well."""


class UpdateWorkspace(NamedTuple):
    """Linearized measurements of one instant, in the first rows, and what they change."""

    J: Indices
    """State index of each entry of H, shape (rows, E); any index where the entry is zero."""
    H: Floats
    """Entries of the Jacobian, shape (rows, E)."""
    residual: Floats
    R: Floats
    """Variance of each measurement."""
    used: Indices
    """0 for a row to leave out."""
    delta: Floats
    """The error state after the update, shape (N,)."""
    gain: Floats
    """Scratch, shape (N,)."""


def make_update_workspace(rows: int, N: int, entries: int = POSE_ENTRIES) -> UpdateWorkspace:
    """Room for `rows` measurements of a state of N numbers, each with so many entries of H."""
    return UpdateWorkspace(
        np.zeros((rows, entries), np.int64),
        np.zeros((rows, entries)),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros(rows, np.int64),
        np.zeros(N),
        np.zeros(N),
    )


@inlined
def row_times_vector(vector: Floats, J: Indices, H: Floats, m: int) -> float:
    """H_m vector."""
    total = 0.0
    for k in range(H.shape[1]):
        total += H[m, k] * vector[J[m, k]]
    return total


@inlined
def covariance_times_row(P: Floats, J: Indices, H: Floats, m: int, out: Floats) -> None:
    """P H_m^T into `out` (N,), reading rows as P is symmetric."""
    for c in range(out.size):
        out[c] = 0.0
    for k in range(H.shape[1]):
        h, j = H[m, k], J[m, k]
        if h != 0.0:
            for c in range(out.size):
                out[c] += h * P[j, c]


@compiled_noalloc
def projected_variance(P: Floats, J: Indices, H: Floats, m: int) -> float:
    """H_m P H_m^T."""
    total = 0.0
    for k in range(H.shape[1]):
        if H[m, k] != 0.0:
            for c in range(H.shape[1]):
                total += H[m, k] * P[J[m, k], J[m, c]] * H[m, c]
    return total


@compiled_noalloc
def sequential_update(P: Floats, work: UpdateWorkspace, count: int) -> None:
    """One scalar update after the other, to P and work.delta.

    With g = P H^T / sqrt(S): delta += g (r - H delta) / sqrt(S) and P -= g g^T, which keeps P
    symmetric to the last bit. Rows with used == 0 are left out.
    """
    J, H, residual, R, used, delta, g = work
    for c in range(g.size):
        delta[c] = 0.0
    for m in range(count):
        if used[m] == 0:
            continue
        covariance_times_row(P, J, H, m, g)
        scale = 1.0 / math.sqrt(row_times_vector(g, J, H, m) + R[m])
        step = scale * (residual[m] - row_times_vector(delta, J, H, m))
        for r in range(g.size):
            g[r] *= scale
            delta[r] += g[r] * step
        for r in range(g.size):
            for c in range(g.size):
                P[r, c] -= g[r] * g[c]


@compiled_noalloc
def mark_columns(work: UpdateWorkspace, count: int, columns: Indices) -> None:
    """Set those columns to 1 that the used ones of the first `count` rows touch."""
    for m in range(count):
        for k in range(work.H.shape[1]):
            if work.used[m] != 0 and work.H[m, k] != 0.0:
                columns[work.J[m, k]] = 1


@kernel
def normal_equations(work: UpdateWorkspace, count: int) -> tuple[Floats, Floats, Indices, Indices]:
    """A = H^T R^-1 H (T, T) and g = H^T R^-1 r (T,) in the columns that H touches.

    Returns also those columns (T,) and the others (N - T,).
    """
    J, H, residual, R, used = work.J, work.H, work.residual, work.R, work.used
    place = np.zeros(work.delta.size, np.int64)
    mark_columns(work, count, place)
    touched, others = np.flatnonzero(place), np.flatnonzero(place == 0)
    for t in range(touched.size):
        place[touched[t]] = t
    A, g = np.zeros((touched.size, touched.size)), np.zeros(touched.size)
    for m in range(count):
        for k in range(H.shape[1]):
            if used[m] == 0 or H[m, k] == 0.0:
                continue
            p = place[J[m, k]]
            weight = H[m, k] / R[m]
            g[p] += weight * residual[m]
            for j in range(H.shape[1]):
                if H[m, j] != 0.0:
                    A[p, place[J[m, j]]] += weight * H[m, j]
    return A, g, touched, others


@compiled_noalloc
def store_symmetric(
    P: Floats, rows: Indices, columns: Indices, block: NDArray[np.floating[Any]]
) -> None:
    """Write a block of P and its mirror image; a block on the diagonal is made symmetric."""
    for r in range(rows.size):
        for c in range(columns.size):
            p, q = rows[r], columns[c]
            P[q, p] = P[p, q] = block[r, c] if p != q else block[r, r]


@kernel
def batch_update(P: Floats, work: UpdateWorkspace, count: int) -> None:
    """The same in information form, with A, g of the touched columns t and the others o.

    P_t' = (I + P_tt A)^-1 P_t, P_oo' = P_oo - P_ot A P_to', delta = P_t'^T g. The solve has the
    size of t, two of three columns where no antenna has a lever arm.
    """
    A, g, t, o = normal_equations(work, count)
    P_t = P[t]
    P_to = P_t[:, o]
    M = P_t[:, t] @ A
    for k in range(t.size):
        M[k, k] += 1.0
    after = np.linalg.solve(M, P_t)
    work.delta[:] = after.T @ g
    P_tt, P_to_new = after[:, t], after[:, o]
    store_symmetric(P, t, t, 0.5 * (P_tt + P_tt.T))
    store_symmetric(P, t, o, P_to_new)
    P_oo = P_to.T @ (A @ P_to_new)
    for r in range(o.size):
        for c in range(o.size):
            P[o[r], o[c]] -= 0.5 * (P_oo[r, c] + P_oo[c, r])
