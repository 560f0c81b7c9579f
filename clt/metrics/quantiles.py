"""Quantiles of the normal and the chi-square distribution.

As scipy.special has them; importing that takes longer than all that clt does with them.
"""

from __future__ import annotations

import math
from statistics import NormalDist

ROUNDING = 2.220446049250313e-16
"""Of one operation, relative."""
TINY = 1e-300
"""Instead of zero, in a denominator."""
STEPS = 200
"""Most steps towards a quantile; ten are usual."""


def normal_quantile(p: float) -> float:
    """Where the standard normal distribution function is p, 0 < p < 1."""
    return NormalDist().inv_cdf(p)


def chi_square_quantile(p: float, freedom: float) -> float:
    """Where the distribution function of chi-square is p, 0 < p < 1; `freedom` is any above 0."""
    a = 0.5 * freedom
    low, high = 0.0, math.inf
    z, c = normal_quantile(p), 1.0 / (9.0 * a)
    x = a * max(1.0 - c + z * math.sqrt(c), 0.0) ** 3  # Wilson and Hilferty (1931)
    if x <= 0.0 or a < 1.0:
        x = math.exp((math.log(p) + math.lgamma(a + 1.0)) / a)
    if x == 0.0:  # So small that it is no number.
        return 0.0
    for _ in range(STEPS):
        below, above = gamma_shares(a, x)
        wrong = below - p if p < 0.5 else (1.0 - p) - above
        low, high = (x, high) if wrong < 0.0 else (low, x)
        slope = math.exp(a * math.log(x) - x - math.lgamma(a))  # of P over log x
        step = wrong / slope if slope > 0.0 else math.copysign(1.0, wrong)
        step /= 1.0 - min(max(0.5 * step * (a - x), -0.5), 0.5)  # Halley's
        new = x * math.exp(-min(max(step, -1.0), 1.0))
        if not low < new < high:
            new = 2.0 * x if high == math.inf else 0.5 * (low + high)
        if abs(new - x) <= 4.0 * ROUNDING * x:
            return 2.0 * new
        x = new
    return 2.0 * x


def gamma_shares(a: float, x: float) -> tuple[float, float]:
    """The regularized incomplete gamma functions P(a, x) and Q(a, x) = 1 - P(a, x).

    By the series of P up to x = a + 1, by the continued fraction of Q (Lentz) beyond.
    """
    if x <= 0.0:
        return 0.0, 1.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1.0:
        term = total = 1.0 / a
        n = a
        while term > ROUNDING * total:
            n += 1.0
            term *= x / n
            total += term
        return scale * total, 1.0 - scale * total
    b = x + 1.0 - a
    c, d = 1.0 / TINY, 1.0 / b
    h, k, change = d, 0.0, 0.0
    while abs(change - 1.0) > 4.0 * ROUNDING:
        k += 1.0
        factor = k * (a - k)
        b += 2.0
        d = 1.0 / (factor * d + b)
        c = b + factor / c
        change = d * c
        h *= change
    return 1.0 - scale * h, scale * h
