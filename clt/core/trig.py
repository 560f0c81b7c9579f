"""Sine and cosine with the same bits on every machine.

The C library's and numpy's differ in the last bit between processors, and equal seeds shall give
equal logs. Here every operation is one that IEEE 754 rounds exactly.
"""

from __future__ import annotations

import math

import numpy as np

from clt.core.arrays import Floats

# pi/2 in three parts of 33 bits, so that a whole multiple of each of the first two is exact.
HALF_PI_PARTS = (1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21)
SINE_COEFFICIENTS = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(9))
COSINE_COEFFICIENTS = tuple((-1) ** k / math.factorial(2 * k) for k in range(9))
MAX_EXACT_ANGLE = 1e6
"""Up to here (rad) whole multiples of the parts of pi/2 are exact."""


def cos_sin(angle: Floats) -> tuple[Floats, Floats]:
    """Cosine and sine of finite angles (rad, any shape), good to 4e-16 up to MAX_EXACT_ANGLE."""
    if np.max(np.abs(angle), initial=0.0) > MAX_EXACT_ANGLE:
        angle = np.fmod(angle, 2.0 * np.pi)
    turns = np.rint(angle * (2.0 / np.pi))
    rest = ((angle - turns * HALF_PI_PARTS[0]) - turns * HALF_PI_PARTS[1]) - turns * HALF_PI_PARTS[
        2
    ]
    square = rest * rest
    cosine, sine = (
        _polynomial(COSINE_COEFFICIENTS, square),
        rest * _polynomial(SINE_COEFFICIENTS, square),
    )
    quadrant = turns.astype(np.int64) & 3
    odd = (quadrant & 1) == 1
    cos, sin = np.where(odd, sine, cosine), np.where(odd, cosine, sine)
    negative_cos = ((quadrant + 1) & 2) == 2
    return np.where(negative_cos, -cos, cos), np.where(quadrant >= 2, -sin, sin)


def _polynomial(coefficients: tuple[float, ...], square: Floats) -> Floats:
    """Horner's scheme, coefficients from the lowest power."""
    total = np.full_like(square, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        total = total * square + coefficient
    return total
