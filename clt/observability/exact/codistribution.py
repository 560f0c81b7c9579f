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
    END,
    SPEED_A,
    SPEED_B,
    C,
    Polynomial,
    S,
    X,
    Y,
    add,
    constant,
    gradient,
    lie,
    multiply,
    reduce,
    scale,
    turning,
    variable,
)

Field = Mapping[int, Polynomial]


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
class Row:
    """A Lie derivative and its gradient."""

    order: int
    function: Polynomial
    gradient: tuple[Polynomial, ...]
    """With respect to (x, y, theta) of end a, then of end b."""


@lru_cache(maxsize=128)
def rows(kind: PairKind) -> tuple[Row, ...]:
    """Lie derivatives of h, linearly independent as functions and up to constants, by order."""
    inputs = fields(kind)
    order, fresh = 0, [output(kind)]
    found: list[Row] = []
    basis: list[Polynomial] = []
    while len(fresh) > 0:
        kept = []
        for function in fresh:
            if _extend(basis, function):
                kept.append(function)
                found.append(Row(order, function, gradient(function)))
        fresh = [lie(function, field) for function in kept for field in inputs]
        order += 1
    return tuple(found)


def _extend(basis: list[Polynomial], function: Polynomial) -> bool:
    """Add a function to a basis unless it depends on it linearly, up to a constant."""
    (one,) = constant(1)
    rest = reduce({m: value for m, value in function.items() if m != one}, basis)
    if len(rest) == 0:
        return False
    basis.append(rest)
    basis.sort(key=max, reverse=True)
    return True


def output(kind: PairKind) -> Polynomial:
    """Half the squared range."""
    total: Polynomial = {}
    for place in (X, Y):
        apart = variable(END + place)
        if not kind.ego:
            apart = add(variable(place), apart, -1)
        total = add(total, multiply(apart, apart), Fraction(1, 2))
    return total


def fields(kind: PairKind) -> tuple[Field, ...]:
    """Input fields in the order v_a, v_b, omega_a, omega_b (a tied pair has one, v_a + v_b).

    Of two steady robots neither can be told from the other: their drift is one field.
    """
    v_a, omega_a = (ego_drive(), ego_turn()) if kind.ego else (drive(0), turning(0))
    v_b, omega_b = drive(END), turning(END)
    if kind.tied:
        return (joined((v_a, v_b)),)
    if kind.a is kind.b is Motion.STEADY:
        return (joined((at_speed(v_a, SPEED_A), at_speed(v_b, SPEED_B))),)
    speeds = [v for v, m in ((v_a, kind.a), (v_b, kind.b)) if m is not Motion.REST]
    turns = [w for w, m in ((omega_a, kind.a), (omega_b, kind.b)) if m is Motion.FREE]
    return (*speeds, *turns)


def drive(end: int) -> Field:
    """f_v = (cos theta, sin theta, 0)."""
    return {end + X: variable(end + C), end + Y: variable(end + S)}


def at_speed(field: Field, speed: int) -> Field:
    """A field times one of the speeds."""
    return {place: multiply(rate, variable(speed)) for place, rate in field.items()}


def ego_drive() -> Field:
    """g_1 = (-1, 0, 0): the ego drives, b comes nearer. Araki after eq. (3)."""
    return {END + X: constant(-1)}


def ego_turn() -> Field:
    """g_2 = (y, -x, -1): the ego turns, b goes round the other way. Araki after eq. (3)."""
    return {
        END + X: variable(END + Y),
        END + Y: scale(variable(END + X), -1),
        **{place: scale(rate, -1) for place, rate in turning(END).items()},
    }


def joined(parts: Sequence[Field]) -> Field:
    """Sum of fields."""
    total: dict[int, Polynomial] = {}
    for part in parts:
        for place, rate in part.items():
            total[place] = add(total.get(place, {}), rate)
    return total
