"""Polynomials in the ten numbers that describe a pair of robots, with exact coefficients.

Variables: x, y, c = cos(theta), s = sin(theta) of end a, then of end b; then the constant speeds
of both, which are no part of the state and matter where both are steady. Every polynomial is kept
in normal form modulo c^2 + s^2 = 1 (no power of s above one), so that equal functions are equal
dictionaries. Heading enters through c and s alone: d/dtheta = c d/ds - s d/dc.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction

Monomial = tuple[int, ...]
"""Exponents of the ten variables."""
Polynomial = Mapping[Monomial, Fraction]

VARIABLES = 10
X, Y, C, S = 0, 1, 2, 3
"""Places of end a's variables; end b's come END_B later."""
END_B = 4
SPEED_A, SPEED_B = 8, 9


def variable(place: int) -> Polynomial:
    """One of the ten variables."""
    return {tuple(int(k == place) for k in range(VARIABLES)): Fraction(1)}


def constant(value: int | Fraction) -> Polynomial:
    """A number."""
    return {} if value == 0 else {(0,) * VARIABLES: Fraction(value)}


def add_polynomials(p: Polynomial, q: Polynomial, factor: int | Fraction = 1) -> Polynomial:
    """Compute p + factor q."""
    total = dict(p)
    for monomial, value in q.items():
        total[monomial] = total.get(monomial, Fraction(0)) + factor * value
    return {monomial: value for monomial, value in total.items() if value != 0}


def multiply_polynomials(p: Polynomial, q: Polynomial) -> Polynomial:
    """Multiply and bring into normal form."""
    total: dict[Monomial, Fraction] = {}
    for m, a in p.items():
        for n, b in q.items():
            monomial = tuple(i + j for i, j in zip(m, n, strict=True))
            total[monomial] = total.get(monomial, Fraction(0)) + a * b
    return normal_form(total)


def normal_form(p: Polynomial) -> Polynomial:
    """Replace s^2 by 1 - c^2 for both ends until no power of s is above one."""
    for end in (0, END_B):
        while any(monomial[end + S] > 1 for monomial in p):
            total: dict[Monomial, Fraction] = {}
            for monomial, value in p.items():
                parts = [(monomial, value)]
                if monomial[end + S] > 1:
                    lower = list(monomial)
                    lower[end + S] -= 2
                    higher = lower.copy()
                    higher[end + C] += 2
                    parts = [(tuple(lower), value), (tuple(higher), -value)]
                for key, part in parts:
                    total[key] = total.get(key, Fraction(0)) + part
            p = total
    return {monomial: value for monomial, value in p.items() if value != 0}


def derivative(p: Polynomial, place: int) -> Polynomial:
    """Partial derivative with respect to one of the ten variables."""
    result: dict[Monomial, Fraction] = {}
    for monomial, value in p.items():
        power = monomial[place]
        if power > 0:
            lower = list(monomial)
            lower[place] -= 1
            result[tuple(lower)] = value * power
    return result


def lie_derivative(p: Polynomial, field: Mapping[int, Polynomial]) -> Polynomial:
    """Lie derivative of p along a vector field: variable -> its rate of change."""
    total: Polynomial = {}
    for place, rate in field.items():
        total = add_polynomials(total, multiply_polynomials(derivative(p, place), rate))
    return total


def turn_field(end: int) -> Mapping[int, Polynomial]:
    """The field d/dtheta of one end: c -> -s, s -> c."""
    return {end + C: scale_polynomial(variable(end + S), -1), end + S: variable(end + C)}


def scale_polynomial(p: Polynomial, factor: int | Fraction) -> Polynomial:
    """Compute factor p."""
    return add_polynomials({}, p, factor)


def gradient(p: Polynomial) -> tuple[Polynomial, ...]:
    """Derivatives with respect to (x, y, theta) of end a, then of end b."""
    return tuple(
        entry
        for end in (0, END_B)
        for entry in (
            derivative(p, end + X),
            derivative(p, end + Y),
            lie_derivative(p, turn_field(end)),
        )
    )


def reduce_by_basis(p: Polynomial, basis: Sequence[Polynomial]) -> Polynomial:
    """What is left of p after subtracting multiples of basis elements; zero if p depends on them.

    Each element is led by its largest monomial, and the basis is sorted by them, largest first.
    """
    for element in basis:
        lead = max(element)
        if lead in p:
            p = add_polynomials(p, element, -p[lead] / element[lead])
    return p
