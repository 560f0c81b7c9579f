"""The papers' printed matrices, row by row."""

from __future__ import annotations

import numpy as np
import pytest

from clt.observability.exact.codistribution import Motion, PairKind, lie_derivatives
from clt.observability.exact.matrix import evaluate_as_float
from clt.observability.exact.polynomial import (
    add_polynomials,
    lie_derivative,
    multiply_polynomials,
    reduce_by_basis,
    turn_field,
    variable,
)

FREE, STRAIGHT, STEADY, REST = Motion.FREE, Motion.STRAIGHT, Motion.STEADY, Motion.REST


def numbers(seed):
    """x, y, theta of both ends and the ten variables."""
    rng = np.random.default_rng(seed)
    pose, speeds = rng.uniform(-5.0, 5.0, 6), rng.uniform(0.1, 2.0, 2)
    (xi, yi, ti), (xj, yj, tj) = pose[:3], pose[3:]
    i, j = [xi, yi, np.cos(ti), np.sin(ti)], [xj, yj, np.cos(tj), np.sin(tj)]
    return pose, np.array([*i, *j, *speeds])


def gradients(kind, variables):
    return np.array(
        [
            [evaluate_as_float(entry, variables) for entry in row.gradient]
            for row in lie_derivatives(kind)
        ]
    )


def shi_two(pose):
    """O_ij as Shi prints it before lemma 1."""
    (xi, yi, ti), (xj, yj, tj) = pose[:3], pose[3:]
    dx, dy = xi - xj, yi - yj
    ci, si, cj, sj = np.cos(ti), np.sin(ti), np.cos(tj), np.sin(tj)
    Dim, Djm = si * dx - ci * dy, sj * dx - cj * dy
    Dip, Djp = ci * dx + si * dy, cj * dx + sj * dy
    s, c = np.sin(ti - tj), np.cos(ti - tj)
    return np.array(
        [
            [dx, dy, 0, -dx, -dy, 0],
            [ci, si, -Dim, -ci, -si, 0],
            [-cj, -sj, 0, cj, sj, Djm],
            [0, 0, s, 0, 0, -s],
            [-si, ci, -Dip, si, -ci, 0],
            [sj, -cj, 0, -sj, cj, Djp],
            [0, 0, c, 0, 0, -c],
        ]
    )


@pytest.mark.parametrize("seed", range(5))
def test_two_moving_robots_give_the_matrix_that_shi_prints(seed):
    pose, variables = numbers(seed)
    assert gradients(PairKind(FREE, FREE), variables) == pytest.approx(shi_two(pose), abs=1e-12)
    assert [row.order for row in lie_derivatives(PairKind(FREE, FREE))] == [0, 1, 1, 2, 2, 2, 3]


@pytest.mark.parametrize("seed", range(5))
def test_its_echelon_form_is_that_of_lemma_1(seed):
    pose, variables = numbers(seed)
    matrix = gradients(PairKind(FREE, FREE), variables)
    dx, dy = pose[0] - pose[3], pose[1] - pose[4]
    G = np.array([[-1, 0, dy], [0, -1, -dx], [0, 0, -1]])
    assert np.linalg.matrix_rank(matrix) == 3
    both = np.vstack([matrix, np.hstack([np.eye(3), G])])
    assert np.linalg.matrix_rank(both) == 3


@pytest.mark.parametrize("seed", range(5))
def test_one_static_robot_gives_the_matrix_before_lemma_4(seed):
    pose, variables = numbers(seed)
    dx, dy, t = pose[0] - pose[3], pose[1] - pose[4], pose[2]
    c, s = np.cos(t), np.sin(t)
    printed = [[dx, dy, 0], [c, s, -(s * dx - c * dy)], [-s, c, -(c * dx + s * dy)]]
    found = gradients(PairKind(FREE, REST), variables)[:, :3]
    assert found == pytest.approx(np.array(printed), abs=1e-12)
    assert np.linalg.matrix_rank(found) == 2


@pytest.mark.parametrize("seed", range(5))
def test_the_ego_frame_gives_arakis_codistribution(seed):
    pose, variables = numbers(seed)
    x, y, theta = pose[3:]
    c, s = np.cos(theta), np.sin(theta)
    found = gradients(PairKind(FREE, FREE, ego=True), variables)[:, 3:]
    printed = np.array([[x, y, 0], [-1, 0, 0], [c, s, -x * s + y * c]])
    assert found[:3] == pytest.approx(printed, abs=1e-12)
    # The errata: the printed rows have determinant a y ...
    assert np.linalg.det(printed) == pytest.approx((y * c - x * s) * y)
    # ... and the ego's turn adds [0, -1, 0].
    assert np.min(np.abs(found - [0.0, -1.0, 0.0]).sum(axis=1)) == pytest.approx(0.0, abs=1e-12)
    # There are no more functions of a relative pose than of both poses in the world.
    assert [row.order for row in lie_derivatives(PairKind(FREE, FREE, ego=True))] == [
        0,
        1,
        1,
        2,
        2,
        2,
        3,
    ]


@pytest.mark.parametrize("kind", [PairKind(FREE, FREE), PairKind(FREE, FREE, ego=True)])
def test_gradients_are_those_of_the_functions(kind):
    _, variables = numbers(7)
    step = 1e-6
    for row in lie_derivatives(kind):
        for k, entry in enumerate(row.gradient):
            ends = []
            for sign in (1.0, -1.0):
                moved = variables.copy()
                base = 4 * (k // 3)
                if k % 3 < 2:
                    moved[base + k % 3] += sign * step
                else:
                    angle = np.arctan2(moved[base + 3], moved[base + 2]) + sign * step
                    moved[base + 2], moved[base + 3] = np.cos(angle), np.sin(angle)
                ends.append(evaluate_as_float(row.function, moved))
            assert evaluate_as_float(entry, variables) == pytest.approx(
                (ends[0] - ends[1]) / (2 * step), abs=1e-7
            )


def test_without_inputs_only_the_range_itself_is_seen():
    assert len(lie_derivatives(PairKind(REST, REST))) == 1


def test_tied_robots_have_fewer_functions_than_free_ones():
    assert len(lie_derivatives(PairKind(STRAIGHT, STRAIGHT, tied=True))) == 3
    assert len(lie_derivatives(PairKind(STRAIGHT, STRAIGHT))) == 4


@pytest.mark.parametrize("seed", range(5))
def test_constant_speeds_show_the_course_relative_to_each_other(seed):
    """d^2 / 2, d . u and u^2 with the relative velocity u."""
    (xi, yi, ti, xj, yj, tj), variables = numbers(seed)
    v, w = variables[8:]
    d = np.array([xj - xi, yj - yi])
    u = w * np.array([np.cos(tj), np.sin(tj)]) - v * np.array([np.cos(ti), np.sin(ti)])
    found = lie_derivatives(PairKind(STEADY, STEADY))
    values = [evaluate_as_float(row.function, variables) for row in found]
    assert values == pytest.approx([d @ d / 2, d @ u, u @ u])
    assert [row.order for row in found] == [0, 1, 2]


def test_polynomials_know_that_cosine_and_sine_are_one():
    c, s = variable(2), variable(3)
    one = add_polynomials(multiply_polynomials(c, c), multiply_polynomials(s, s))
    assert one == {(0,) * 10: 1}
    assert lie_derivative(one, turn_field(0)) == {}
    assert lie_derivative(lie_derivative(s, turn_field(0)), turn_field(0)) == add_polynomials(
        {}, s, -1
    )
    assert reduce_by_basis(add_polynomials(c, s), [s, c]) == {}
