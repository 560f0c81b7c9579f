"""Joint Kalman update with many scalar measurements of one instant, in place.

All measurements share the linearization point, as in the textbook batch update: m rows with two
blocks of three non-zero entries each (a range touches two robots). `sequential` and `batch` give
the same posterior; their costs grow as m N^2 and N^3.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clt.filters.compiled import kernel
from clt.streams import Floats, Indices


@kernel
def index(a: int, b: int, k: int) -> int:
    """State index of entry k (0 .. 5) of a range's two blocks a and b."""
    return 3 * a + k if k < 3 else 3 * b + k - 3


@kernel
def add_rows(P: Floats, block: int, H: Floats, m: int, offset: int, out: Floats) -> None:
    """Add P[:, block] H_m[block]^T to `out` (N,), reading rows as P is symmetric."""
    p = 3 * block
    hx, hy, ht = H[m, offset], H[m, offset + 1], H[m, offset + 2]
    for c in range(out.size):
        out[c] += hx * P[p, c] + hy * P[p + 1, c]
    if ht != 0.0:
        for c in range(out.size):
            out[c] += ht * P[p + 2, c]


@kernel
def dot(vector: Floats, a: int, b: int, H: Floats, m: int) -> float:
    """H_m vector; a, b are block indices, negative for an end outside the state."""
    total = 0.0
    for k in range(3):
        if a >= 0:
            total += H[m, k] * vector[3 * a + k]
        if b >= 0:
            total += H[m, 3 + k] * vector[3 * b + k]
    return total


@kernel
def block_form(P: Floats, a: int, b: int, H: Floats, m: int, i: int, j: int) -> float:
    """H_m[i : i + 3] P[a, b] H_m[j : j + 3]^T of two 3 x 3 blocks' worth of P."""
    p, q = 3 * a, 3 * b
    total = 0.0
    for r in range(3):
        row = P[p + r, q] * H[m, j] + P[p + r, q + 1] * H[m, j + 1] + P[p + r, q + 2] * H[m, j + 2]
        total += H[m, i + r] * row
    return total


@kernel
def projected_variance(P: Floats, a: int, b: int, H: Floats, m: int) -> float:
    """H_m P H_m^T from the blocks of both ends alone."""
    total = 0.0
    if a >= 0:
        total += block_form(P, a, a, H, m, 0, 0)
    if b >= 0:
        total += block_form(P, b, b, H, m, 3, 3)
    if a >= 0 and b >= 0:
        total += 2.0 * block_form(P, a, b, H, m, 0, 3)
    return total


@kernel
def sequential(
    P: Floats, a: Indices, b: Indices, H: Floats, residual: Floats, R: Floats, used: Indices
) -> Floats:
    """One scalar update after the other. Returns the error state delta (N,); P is updated.

    K = P H^T / S, delta += K (r - H delta), P -= K S K^T. Rows with used == 0 are left out.
    """
    N = P.shape[0]
    delta, column = np.zeros(N), np.empty(N)
    for m in range(residual.size):
        if used[m] == 0:
            continue
        for c in range(N):
            column[c] = 0.0
        if a[m] >= 0:
            add_rows(P, a[m], H, m, 0, column)
        if b[m] >= 0:
            add_rows(P, b[m], H, m, 3, column)
        S = dot(column, a[m], b[m], H, m) + R[m]
        gain = (residual[m] - dot(delta, a[m], b[m], H, m)) / S
        for r in range(N):
            delta[r] += column[r] * gain
            K = column[r] / S
            for c in range(N):
                P[r, c] -= K * column[c]
    return delta


@kernel
def normal_equations(
    a: Indices, b: Indices, H: Floats, residual: Floats, R: Floats, used: Indices, N: int
) -> tuple[Floats, Floats, Indices, Indices]:
    """A = H^T R^-1 H (T, T) and g = H^T R^-1 r (T,) in the columns that H touches.

    Returns also those columns (T,) and the others (N - T,).
    """
    place = np.full(N, -1)
    for m in range(residual.size):
        for k in range(6):
            if used[m] != 0 and H[m, k] != 0.0:
                place[index(a[m], b[m], k)] = 0
    touched, others = np.flatnonzero(place == 0), np.flatnonzero(place < 0)
    for t in range(touched.size):
        place[touched[t]] = t
    A, g = np.zeros((touched.size, touched.size)), np.zeros(touched.size)
    for m in range(residual.size):
        for k in range(6):
            if used[m] == 0 or H[m, k] == 0.0:
                continue
            p = place[index(a[m], b[m], k)]
            weight = H[m, k] / R[m]
            g[p] += weight * residual[m]
            for j in range(6):
                if H[m, j] != 0.0:
                    A[p, place[index(a[m], b[m], j)]] += weight * H[m, j]
    return A, g, touched, others


@kernel
def put_symmetric(
    P: Floats, rows: Indices, columns: Indices, block: NDArray[np.floating[Any]]
) -> None:
    """Write a block of P and its mirror image; a block on the diagonal is made symmetric."""
    for r in range(rows.size):
        for c in range(columns.size):
            p, q = rows[r], columns[c]
            P[q, p] = P[p, q] = block[r, c] if p != q else block[r, r]


@kernel
def batch(
    P: Floats, a: Indices, b: Indices, H: Floats, residual: Floats, R: Floats, used: Indices
) -> Floats:
    """The same in information form, with A, g of the touched columns t and the others o.

    P_t' = (I + P_tt A)^-1 P_t, P_oo' = P_oo - P_ot A P_to', delta = P_t'^T g. The solve has the
    size of t, two of three columns where no antenna has a lever arm.
    """
    A, g, t, o = normal_equations(a, b, H, residual, R, used, P.shape[0])
    P_t = P[t]
    P_to = P_t[:, o]
    M = P_t[:, t] @ A
    for k in range(t.size):
        M[k, k] += 1.0
    after = np.linalg.solve(M, P_t)
    delta = after.T @ g
    P_tt, P_to_new = after[:, t], after[:, o]
    put_symmetric(P, t, t, 0.5 * (P_tt + P_tt.T))
    put_symmetric(P, t, o, P_to_new)
    P_oo = P_to.T @ (A @ P_to_new)
    for r in range(o.size):
        for c in range(o.size):
            P[o[r], o[c]] -= 0.5 * (P_oo[r, c] + P_oo[c, r])
    return delta
