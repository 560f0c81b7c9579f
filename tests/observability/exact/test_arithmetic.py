"""Polynomials, residues and null spaces against plain fractions and floating point."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.observability.exact.codistribution import Motion, PairKind, lie_derivatives
from clt.observability.exact.curvature import hessians
from clt.observability.exact.directions import _combined, _without
from clt.observability.exact.matrix import evaluate_as_float, observability_matrix
from clt.observability.exact.polynomial import (
    END_B,
    VARIABLES,
    C,
    S,
    X,
    add_polynomials,
    constant,
    derivative,
    gradient,
    lie_derivative,
    multiply_polynomials,
    normal_form,
    reduce_by_basis,
    scale_polynomial,
    turn_field,
    variable,
)
from clt.observability.exact.rank import (
    PRIME,
    MatrixBlock,
    column_echelon,
    cut_null_space,
    evaluate_polynomial,
    group_similar_pairs,
    multiply_modulo_prime,
    null_space,
    null_spaces,
    pair_powers,
    pairs_by_kind,
    residue,
    residues_of,
    state_entries,
)
from clt.observability.exact.setup import Setup, every_pair, setup_robots
from clt.observability.exact.states import random_state

MONOMIALS = st.tuples(*[st.integers(0, 3)] * 4)
POLYNOMIALS = st.dictionaries(MONOMIALS, st.integers(-5, 5).filter(bool), max_size=4).map(
    lambda p: {(*m, 0, 0, 0, 0, 0, 0): Fraction(value) for m, value in p.items()}
)


def at_angle(t=Fraction(1, 3)):
    """A point with c^2 + s^2 = 1 at both ends."""
    c, s = (1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)
    return [Fraction(2), Fraction(-3), c, s, Fraction(1, 2), Fraction(5), s, -c, 2, 7]


def value_at(p, point):
    total = Fraction(0)
    for monomial, factor in p.items():
        term = factor
        for number, power in zip(point, monomial, strict=True):
            term *= number**power
        total += term
    return total


@settings(max_examples=60, deadline=None)
@given(POLYNOMIALS, POLYNOMIALS, st.integers(-3, 3))
def test_sums_and_products_have_the_values_of_numbers(p, q, factor):
    point = at_angle()
    total = value_at(p, point) + factor * value_at(q, point)
    assert value_at(add_polynomials(p, q, factor), point) == total
    product = multiply_polynomials(p, q)
    assert value_at(product, point) == value_at(p, point) * value_at(q, point)
    assert all(monomial[S] <= 1 and monomial[END_B + S] <= 1 for monomial in product)
    assert all(value != 0 for value in product.values())
    assert value_at(scale_polynomial(p, factor), point) == factor * value_at(p, point)


@settings(max_examples=40, deadline=None)
@given(POLYNOMIALS)
def test_a_normal_form_has_the_same_values_and_is_unique(p):
    s = variable(S)
    longer = add_polynomials(p, multiply_polynomials(s, s))
    longer = add_polynomials(longer, multiply_polynomials(variable(C), variable(C)))
    longer = add_polynomials(longer, constant(1), -1)
    assert value_at(normal_form(p), at_angle()) == value_at(p, at_angle())
    assert normal_form(longer) == normal_form(p)


@settings(max_examples=40, deadline=None)
@given(POLYNOMIALS)
def test_derivatives_are_those_of_powers(p):
    point = at_angle()
    for place in range(4):
        expected = Fraction(0)
        for monomial, factor in p.items():
            if monomial[place] > 0:
                lower = list(monomial)
                lower[place] -= 1
                expected += monomial[place] * value_at({tuple(lower): factor}, point)
        assert value_at(derivative(p, place), point) == expected
    turned = value_at(lie_derivative(p, turn_field(0)), point)
    c, s = point[C], point[S]
    assert turned == c * value_at(derivative(p, S), point) - s * value_at(derivative(p, C), point)


def test_gradients_come_in_the_order_of_both_ends():
    x, s_b = variable(X), variable(END_B + S)
    found = gradient(multiply_polynomials(x, s_b))
    assert found[0] == s_b
    assert found[1] == found[2] == found[3] == found[4] == {}
    assert found[5] == multiply_polynomials(x, variable(END_B + C))


def test_what_depends_on_a_basis_leaves_nothing():
    x, y, c = variable(0), variable(1), variable(2)
    basis = sorted([add_polynomials(x, y), add_polynomials(y, c, 2)], key=max, reverse=True)
    total = add_polynomials(scale_polynomial(basis[0], 3), basis[1], -7)
    assert reduce_by_basis(total, basis) == {}
    assert reduce_by_basis(x, basis) == {next(iter(c)): Fraction(2)}
    assert constant(0) == {}
    assert constant(3) == {(0,) * VARIABLES: 3}


def test_second_derivatives_are_gradients_of_gradients():
    kind = PairKind(Motion.FREE, Motion.REST)
    for row, hessian in zip(lie_derivatives(kind), hessians(kind), strict=True):
        assert len(hessian) == 6
        for j, entry in enumerate(row.gradient):
            assert hessian[j] == gradient(entry)


@pytest.mark.parametrize("value", [Fraction(1, 3), Fraction(-7, 5), 0, -1, Fraction(PRIME, 2)])
def test_a_residue_times_its_denominator_is_its_numerator(value):
    fraction = Fraction(value)
    found = residue(value)
    assert 0 <= found < PRIME
    assert (found * fraction.denominator - fraction.numerator) % PRIME == 0


def team(moving=2, static=1, known=1, **keys):
    nodes = setup_robots(moving, static, known)
    return Setup(nodes, every_pair(len(nodes)), **keys)


def test_polynomials_at_pairs_are_exact():
    setup = team()
    state = random_state(setup, 3)
    powers = pair_powers(setup, setup.pairs, state)
    p = lie_derivatives(setup.kind(setup.pairs[0]))[3].function
    found = evaluate_polynomial(p, powers)
    for n, (a, b) in enumerate(setup.pairs):
        ends = [state[a], state[b]]
        point = [value for e in ends for value in (e.x, e.y, e.c, e.s)]
        assert found[n] == residue(value_at(p, [*point, ends[0].v, ends[1].v]))
    assert residues_of(state).shape == (3, 5)
    assert residues_of(state)[1].tolist() == [
        residue(v) for v in (state[1].x, state[1].y, state[1].c, state[1].s, state[1].v)
    ]


def test_the_ego_is_the_first_end_of_its_pairs():
    setup = team(moving=3, static=0, known=0, ego=1)
    assert [setup.ordered(pair) for pair in setup.pairs] == [(1, 0), (0, 2), (1, 2)]
    kinds = pairs_by_kind(setup)
    assert sorted(map(len, kinds.values())) == [1, 2]
    assert {kind.ego for kind in kinds} == {True, False}
    powers = pair_powers(setup, [(0, 1)], random_state(setup, 0))
    numbers = residues_of(random_state(setup, 0))
    assert powers[1, :4, 0].tolist() == numbers[1, :4].tolist()
    assert powers[1, 4:8, 0].tolist() == numbers[0, :4].tolist()
    assert powers[1, 8:, 0].tolist() == numbers[[1, 0], 4].tolist()
    assert powers[2, 4, 0] == int(numbers[0, 0]) ** 2 % PRIME


def test_entries_that_belong_to_the_state():
    setup = team(moving=2, static=2, known=1)
    assert setup.columns[0] == ("R1", "x")
    assert setup.columns[-1] == ("S2", "y")
    assert len(setup.columns) == 8
    assert state_entries(setup, (0, 1)) == ([0, 1, 2, 3, 4, 5], (0, 1, 2, 3, 4, 5))
    assert state_entries(setup, (1, 2)) == ([0, 1, 2], (3, 4, 5))
    assert state_entries(setup, (0, 3)) == ([0, 1, 2, 3, 4], (0, 1, 2, 6, 7))
    assert state_entries(setup, (2, 3)) == ([3, 4], (6, 7))
    parts = group_similar_pairs(setup)
    assert sorted(len(part.pairs) for part in parts) == [1, 1, 2, 2]


def integers(rng, *shape):
    return rng.integers(0, PRIME, shape)


def test_products_modulo_the_prime_do_not_overflow():
    rng = np.random.default_rng(1)
    A, B = integers(rng, 2, 3, 4), integers(rng, 2, 4, 5)
    found = multiply_modulo_prime(A, B)
    for n in range(2):
        for r in range(3):
            for m in range(5):
                exact = sum(int(A[n, r, k]) * int(B[n, k, m]) for k in range(4))
                assert found[n, r, m] == exact % PRIME
    v, M = integers(rng, 4), integers(rng, 3, 4)
    assert _combined(M, v).tolist() == [
        sum(int(M[r, k]) * int(v[k]) for k in range(4)) % PRIME for r in range(3)
    ]
    assert _combined(M, B[0])[1, 2] == sum(int(M[1, k]) * int(B[0, k, 2]) for k in range(4)) % PRIME


def test_a_space_is_cut_by_what_rows_see_and_keeps_the_rest():
    rng = np.random.default_rng(2)
    space = np.eye(6, dtype=np.int64)
    block = MatrixBlock(np.array([[1, 2, 4], [0, 3, 5]]), integers(rng, 2, 2, 3))
    cut = cut_null_space(space, block, 0)
    assert cut.shape == (6, 4)
    assert not multiply_modulo_prime(block.rows[0], cut[block.columns[0]]).any()
    again = cut_null_space(cut, block, 1)
    assert again.shape == (6, 2)
    for k in range(2):
        assert not multiply_modulo_prime(block.rows[k], again[block.columns[k]]).any()
    assert cut_null_space(again, block, 0) is again
    *_, last = null_spaces([block], 6)
    assert last.shape == (6, 2)


def test_an_echelon_form_spans_the_same_space():
    rng = np.random.default_rng(3)
    space = integers(rng, 6, 3)
    space[0] = 0
    reduced, pivots = column_echelon(space)
    assert len(set(pivots)) == 3
    assert np.array_equal(reduced[pivots], np.eye(3))
    assert np.array_equal(multiply_modulo_prime(reduced, space[pivots]), space)


def test_directions_that_are_found_are_taken_out_of_what_is_left():
    """The dual coordinates that remain vanish on every direction found so far."""
    rng = np.random.default_rng(4)
    left, found = np.eye(4, dtype=np.int64), []
    for _ in range(3):
        direction = integers(rng, 4)
        found.append(direction)
        seen = _combined(direction[None], left)[0]
        left = _without(left, seen, int(np.flatnonzero(seen)[0]))
        for one in found:
            assert not _combined(one[None], left).any()
    assert left.shape == (4, 1)
    assert left.any()


@pytest.mark.parametrize(
    ("counts", "keys"),
    [
        ((3, 2, 2), {}),
        ((2, 2, 1), {}),
        ((2, 1, 0), {}),
        ((3, 1, 0), {"ego": 0}),
        ((3, 0, 0), {"ego": 2}),
        ((3, 0, 0), {"parallel": frozenset({0, 1, 2})}),
        ((2, 2, 2), {"in_line": frozenset({0, 2, 3})}),
        ((2, 2, 0), {"framed": True}),
    ],
)
def test_ranks_and_matrices_are_those_of_floating_point(counts, keys):
    setup = team(*counts, **keys)
    state = random_state(setup, 5)
    A = observability_matrix(setup, state)
    if setup.framed:
        first, second = (setup.first_column[k] for k in setup.frame_robots)
        A = np.vstack([A, np.eye(len(setup.columns))[[first, first + 1, second + 1]]])
    rank = len(setup.columns) - null_space(setup, state).shape[1]
    assert np.linalg.matrix_rank(A, tol=1e-8 * np.abs(A).max()) == rank


def test_a_polynomial_in_floating_point():
    p = {(2, 0, 1, 0, 0, 0, 0, 0, 0, 1): Fraction(3, 2), (0,) * 10: Fraction(-1)}
    numbers = np.array([2.0, 0, 0.5, 0, 0, 0, 0, 0, 0, 7.0])
    assert evaluate_as_float(p, numbers) == pytest.approx(1.5 * 4.0 * 0.5 * 7.0 - 1.0)
