"""Observability codistribution of one pair: gradients of all Lie derivatives of its range output.

The output is h = d^2 / 2 (Shi, "Observability with only dynamic vehicles"; Araki III-C). Its Lie
derivatives along the unicycle's input fields span a space of functions of finite dimension; they
are computed symbolically, order by order, until that space is closed. A Lie derivative of a pair's
range along the inputs of a third robot is zero, so the rows of a team are those of its pairs, and
closing the space of functions makes the rank exact at every state, the degenerate ones too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction
from functools import lru_cache

from clt.observability.exact.polynomial import (
    END_B,
    SPEED_A,
    SPEED_B,
    C,
    Polynomial,
    S,
    X,
    Y,
    add_polynomials,
    constant,
    gradient,
    lie_derivative,
    multiply_polynomials,
    reduce_by_basis,
    scale_polynomial,
    turn_field,
    variable,
)

VectorField = Mapping[int, Polynomial]


class Motion(Enum):
    """What a robot may do: its input fields."""

    FREE = "free"
    """It drives and turns."""
    STRAIGHT = "straight"
    """It drives at any speeds and does not turn."""
    STEADY = "steady"
    """It drives at one constant speed and does not turn: no input, but drift."""
    REST = "rest"
    """It does neither."""


@dataclass(frozen=True)
class PairKind:
    """All that the functions of a pair depend on."""

    a: Motion
    b: Motion
    tied: bool = False
    """Both ends drive with one common speed: a single input."""
    ego: bool = False
    """The state is the pose of b in the body frame of a (Araki), else both poses in the world."""


@dataclass(frozen=True)
class LieDerivative:
    """A Lie derivative and its gradient."""

    order: int
    function: Polynomial
    gradient: tuple[Polynomial, ...]
    """With respect to (x, y, theta) of end a, then of end b."""


@lru_cache(maxsize=128)
def lie_derivatives(kind: PairKind) -> tuple[LieDerivative, ...]:
    """Lie derivatives of h, linearly independent as functions and up to constants, by order."""
    inputs = input_fields(kind)
    order, fresh = 0, [range_output(kind)]
    found: list[LieDerivative] = []
    basis: list[Polynomial] = []
    while len(fresh) > 0:
        kept = []
        for function in fresh:
            if _extend(basis, function):
                kept.append(function)
                found.append(LieDerivative(order, function, gradient(function)))
        fresh = [lie_derivative(function, field) for function in kept for field in inputs]
        order += 1
    return tuple(found)


def _extend(basis: list[Polynomial], function: Polynomial) -> bool:
    """Add a function to a basis unless it depends on it linearly, up to a constant."""
    (one,) = constant(1)
    rest = reduce_by_basis({m: value for m, value in function.items() if m != one}, basis)
    if len(rest) == 0:
        return False
    basis.append(rest)
    basis.sort(key=max, reverse=True)
    return True


def range_output(kind: PairKind) -> Polynomial:
    """Half the squared range."""
    total: Polynomial = {}
    for place in (X, Y):
        apart = variable(END_B + place)
        if not kind.ego:
            apart = add_polynomials(variable(place), apart, -1)
        total = add_polynomials(total, multiply_polynomials(apart, apart), Fraction(1, 2))
    return total


def input_fields(kind: PairKind) -> tuple[VectorField, ...]:
    """Input fields in the order v_a, v_b, omega_a, omega_b (a tied pair has one, v_a + v_b).

    Two steady robots cannot be distinguished: their drift is one field.
    """
    v_a, omega_a = (
        (ego_drive_field(), ego_turn_field()) if kind.ego else (drive_field(0), turn_field(0))
    )
    v_b, omega_b = drive_field(END_B), turn_field(END_B)
    if kind.tied:
        return (sum_of_fields((v_a, v_b)),)
    if kind.a is kind.b is Motion.STEADY:
        return (sum_of_fields((field_at_speed(v_a, SPEED_A), field_at_speed(v_b, SPEED_B))),)
    speeds = [v for v, m in ((v_a, kind.a), (v_b, kind.b)) if m is not Motion.REST]
    turns = [w for w, m in ((omega_a, kind.a), (omega_b, kind.b)) if m is Motion.FREE]
    return (*speeds, *turns)


def drive_field(end: int) -> VectorField:
    """f_v = (cos theta, sin theta, 0)."""
    return {end + X: variable(end + C), end + Y: variable(end + S)}


def field_at_speed(field: VectorField, speed: int) -> VectorField:
    """A field times one of the speeds."""
    return {place: multiply_polynomials(rate, variable(speed)) for place, rate in field.items()}


def ego_drive_field() -> VectorField:
    """g_1 = (-1, 0, 0): the ego drives, b comes nearer. Araki after eq. (3)."""
    return {END_B + X: constant(-1)}


def ego_turn_field() -> VectorField:
    """g_2 = (y, -x, -1): the ego turns, b goes round the other way. Araki after eq. (3)."""
    return {
        END_B + X: variable(END_B + Y),
        END_B + Y: scale_polynomial(variable(END_B + X), -1),
        **{place: scale_polynomial(rate, -1) for place, rate in turn_field(END_B).items()},
    }


def sum_of_fields(parts: Sequence[VectorField]) -> VectorField:
    """Sum of fields."""
    total: dict[int, Polynomial] = {}
    for part in parts:
        for place, rate in part.items():
            total[place] = add_polynomials(total.get(place, {}), rate)
    return total
