"""The unscented transform in halves: sigma points in pairs, their moments, a joint update.

Merwe's 2 N + 1 points are the mean x and x +- s L_k, for the columns L_k of a Cholesky factor of P
and s = alpha sqrt(N + kappa). With y_k+- their images, o_k = (y_k+ - y_k-) / 2 s the odd and
q_k = (y_k+ + y_k- - 2 y_0) / 2 s the even half of each pair, his weighted sums are

    mean = y_0 + m,  m = sum_k q_k / s,
    covariance = sum_k (o_k o_k^T + q_k q_k^T) + (beta - alpha^2) m m^T,
    cross-covariance with x = sum_k L_k o_k^T:

half the work, and nothing is lost to cancellation between large weights. A heading's difference
from the central point is kept along its own turn, not cut at half a turn: on the circle the mean
is the same, and a point far out on one side is not taken for one on the other side.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.jit.compiled import compiled_noalloc, inlined
from clt.model.settings import UkfSettings

MACHINE_EPSILON = 2.220446049250313e-16
"""Of one operation, relative."""


class SigmaPoints(NamedTuple):
    """The pairs of sigma points of a state of N numbers, and scratch."""

    L: Floats
    """Row k holds L_k, zero before its k-th number, shape (N, N)."""
    plus: Floats
    """Row k is x + s L_k; after `center_sigma_points` o_k."""
    minus: Floats
    """Row k is x - s L_k; after `center_sigma_points` q_k."""
    m: Floats
    """What curvature adds to the mean, shape (N,)."""
    s: float
    excess: float
    """beta - alpha^2."""


def make_sigma_points(N: int, settings: UkfSettings) -> SigmaPoints:
    """Room for the sigma points of a state of N numbers."""
    L, plus, minus = (np.zeros((N, N)) for _ in range(3))
    s = settings.alpha * math.sqrt(N + settings.kappa)
    return SigmaPoints(L, plus, minus, np.zeros(N), s, settings.beta - settings.alpha**2)


@compiled_noalloc
def cholesky_upper(P: Floats, U: Floats, n: int) -> None:
    """U with U^T U = P, upper triangular, of the first n rows of a covariance; P's upper half.

    A pivot of no more than rounding makes a row of zeros: P may be singular.
    """
    for r in range(n):
        for c in range(r, n):
            U[r, c] = P[r, c]
    for k in range(n):
        pivot = U[k, k]
        if pivot <= n * MACHINE_EPSILON * P[k, k]:
            for c in range(k, n):
                U[k, c] = 0.0
            continue
        scale = 1.0 / math.sqrt(pivot)
        for c in range(k, n):
            U[k, c] *= scale
        for r in range(k + 1, n):
            f = U[k, r]
            if f != 0.0:
                for c in range(r, n):
                    U[r, c] -= f * U[k, c]


@compiled_noalloc
def draw_sigma_points(x: Floats, P: Floats, points: SigmaPoints) -> None:
    """The pairs of sigma points of a mean and a covariance."""
    L, plus, minus, _, s, _ = points
    cholesky_upper(P, L, x.size)
    for k in range(x.size):
        for c in range(x.size):
            plus[k, c] = x[c] + s * L[k, c]
            minus[k, c] = x[c] - s * L[k, c]


@inlined
def mirror_upper(P: Floats) -> None:
    """Copy the upper half of P to the lower."""
    for r in range(P.shape[0]):
        for c in range(r):
            P[r, c] = P[c, r]


@compiled_noalloc
def center_sigma_points(y: Floats, points: SigmaPoints, blocks: bool) -> None:
    """Turn the moved pairs into their halves about the moved mean y, and m.

    `blocks`: what is before the block of its k-th number has no part in pair k, and is not read.
    """
    _, plus, minus, m, s, _ = points
    scale = 0.5 / s
    for c in range(y.size):
        m[c] = 0.0
    for k in range(y.size):
        for c in range(k - k % 3 if blocks else 0, y.size):
            p, q = plus[k, c] - y[c], minus[k, c] - y[c]
            plus[k, c], minus[k, c] = scale * (p - q), scale * (p + q)
            m[c] += minus[k, c] / s


@compiled_noalloc
def sigma_point_covariance(points: SigmaPoints, P: Floats, blocks: bool) -> None:
    """P, its upper half, from the halves of the pairs; `blocks` as in `center_sigma_points`."""
    _, odd, even, m, _, excess = points
    for r in range(m.size):
        for c in range(r, m.size):
            P[r, c] = excess * m[r] * m[c]
    for k in range(m.size):
        for r in range(k - k % 3 if blocks else 0, m.size):
            o, q = odd[k, r], even[k, r]
            for c in range(r, m.size):
                P[r, c] += o * odd[k, c] + q * even[k, c]


class MeasurementMoments(NamedTuple):
    """What the sigma points say of the measurements of one instant; M of them at most."""

    odd: Floats
    """o_k of each, shape (N, M)."""
    even: Floats
    """q_k."""
    m: Floats
    """Shape (M,)."""
    residual: Floats
    """z less the mean."""
    R: Floats
    S: Floats
    """Covariance of the residuals, upper half, shape (M, M)."""
    U: Floats
    """Its factor."""
    V: Floats
    """U^-T times the cross-covariance with x, shape (M, N)."""


def make_measurement_moments(M: int, N: int) -> MeasurementMoments:
    """Room for M measurements of a state of N numbers."""
    pair = np.zeros((N, M)), np.zeros((N, M))
    square = np.zeros((M, M)), np.zeros((M, M))
    return MeasurementMoments(
        *pair, np.zeros(M), np.zeros(M), np.zeros(M), *square, np.zeros((M, N))
    )


@compiled_noalloc
def innovation_covariance(measured: MeasurementMoments, count: int, excess: float) -> None:
    """S of the first `count` measurements, its upper half."""
    odd, even, m, _, R, S, _, _ = measured
    for i in range(count):
        for j in range(i, count):
            S[i, j] = excess * m[i] * m[j]
        S[i, i] += R[i]
    for k in range(odd.shape[0]):
        for i in range(count):
            o, q = odd[k, i], even[k, i]
            for j in range(i, count):
                S[i, j] += o * odd[k, j] + q * even[k, j]


@compiled_noalloc
def cross_covariance(L: Floats, odd: Floats, V: Floats, count: int) -> None:
    """Of the first `count` measurements (rows) with x, sum_k o_k L_k^T, into V."""
    for j in range(count):
        for c in range(V.shape[1]):
            V[j, c] = 0.0
        for k in range(V.shape[1]):
            for c in range(k, V.shape[1]):
                V[j, c] += odd[k, j] * L[k, c]


@compiled_noalloc
def fuse_jointly(
    x: Floats, P: Floats, L: Floats, measured: MeasurementMoments, count: int, excess: float
) -> None:
    """Joint update with the first `count` measurements: x += K r, P -= K S K^T, in place.

    With S = U^T U and V = U^-T times the cross-covariance: x += V^T U^-T r, P -= V^T V.
    """
    odd, _, _, residual, _, S, U, V = measured
    innovation_covariance(measured, count, excess)
    cholesky_upper(S, U, count)
    cross_covariance(L, odd, V, count)
    for i in range(count):
        scale = 1.0 / U[i, i] if U[i, i] > 0.0 else 0.0
        residual[i] *= scale
        for c in range(x.size):
            V[i, c] *= scale
            x[c] += V[i, c] * residual[i]
        for j in range(i + 1, count):
            residual[j] -= U[i, j] * residual[i]
            for c in range(x.size):
                V[j, c] -= U[i, j] * V[i, c]
        for r in range(x.size):
            for c in range(r, x.size):
                P[r, c] -= V[i, r] * V[i, c]
    mirror_upper(P)
