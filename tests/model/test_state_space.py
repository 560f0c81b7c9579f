"""State spaces: exact motion in every frame, and covariances that are its derivatives."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.errors import UsageError
from clt.core.geometry import relative_pose, wrap_angle
from clt.model.choices import FrameSpec, parse_frame_spec
from clt.model.covariance_propagation import propagate_blocks
from clt.model.state_space import (
    WORLD_REFERENCE,
    make_state_space,
    move_blocks,
    poses_to_blocks,
    samples_to_blocks,
    world_state_space,
)

POSES = st.lists(st.floats(-4, 4), min_size=9, max_size=9).map(lambda p: np.array(p).reshape(3, 3))
TWIST = st.tuples(st.floats(-2, 2), st.floats(-2, 2))
EGO = make_state_space((1, 2), (0, 0))
MUTUAL = make_state_space((1, 0), (0, 1))


def blocks(poses, space):
    """The relative poses of some world poses, stacked."""
    return np.concatenate(
        [
            poses[j] if i == WORLD_REFERENCE else relative_pose(poses[i], poses[j])
            for j, i in zip(space.who, space.base, strict=True)
        ]
    )


@pytest.mark.parametrize("space", [EGO, MUTUAL, world_state_space(3)])
@given(POSES, TWIST, st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=40)
def test_every_frame_describes_the_same_motion(space, poses, twist, dt):
    x = blocks(poses, space)
    moved = poses.copy()
    for d in range(space.first.size - 1):
        move_blocks(x, space, d, *twist, dt)
        own = moved[d].copy()
        move_blocks(own, world_state_space(1), 0, *twist, dt)
        moved[d] = own
    difference = (x - blocks(moved, space)).reshape(-1, 3)
    np.testing.assert_allclose(difference[:, :2], 0.0, atol=1e-9)
    np.testing.assert_allclose(wrap_angle(difference[:, 2]), 0.0, atol=1e-9)


def araki(x, u):
    """Araki's eq. (1): the rate of T_ji for the ego's and the neighbour's twist (v, w)."""
    (v_i, w_i), (v_j, w_j) = u
    return np.array(
        [
            v_j * np.cos(x[2]) - v_i + w_i * x[1],
            v_j * np.sin(x[2]) - w_i * x[0],
            w_j - w_i,
        ]
    )


def test_the_exact_step_is_what_runge_kutta_converges_to():
    u, dt, n = ((0.7, 0.6), (0.9, -0.4)), 0.5, 50
    x = np.array([2.0, -1.0, 0.4])
    exact = x.copy()
    # Both move at once: in the limit of small turns, the one after the other.
    for _ in range(1000):
        move_blocks(exact, make_state_space((1,), (0,)), 0, *u[0], dt / 1000)
        move_blocks(exact, make_state_space((1,), (0,)), 1, *u[1], dt / 1000)
    whole = x.copy()
    move_blocks(whole, make_state_space((1,), (0,)), 0, *u[0], dt)
    move_blocks(whole, make_state_space((1,), (0,)), 1, *u[1], dt)
    for _ in range(n):
        h = dt / n
        k1 = araki(x, u)
        k2 = araki(x + 0.5 * h * k1, u)
        k3 = araki(x + 0.5 * h * k2, u)
        k4 = araki(x + h * k3, u)
        x = x + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    np.testing.assert_allclose(exact, x, atol=1e-9)
    np.testing.assert_allclose(whole, x, atol=1e-9)


@pytest.mark.parametrize(
    ("who", "base"),
    [((1, 2), (0, 0)), ((1, 0), (0, 1)), ((0, 1, 2), (WORLD_REFERENCE,) * 3), ((0, 1), (1, 2))],
)
@pytest.mark.parametrize("calibrated", [False, True])
@pytest.mark.parametrize("driver", [0, 1])
def test_the_covariance_moves_with_the_derivatives_of_the_motion(who, base, calibrated, driver):
    space = make_state_space(
        who, base, (1, driver) if calibrated and driver != 1 else [1] * calibrated
    )
    rng = np.random.default_rng(3)
    N = 3 * len(who) + 3 * int(np.sum(space.calibration >= 0))
    x = rng.normal(size=N)
    if calibrated:
        x[3 * len(who) :] *= 0.05
    A = rng.normal(size=(N, N))
    P = A @ A.T
    v, omega, dt, qv, qw = 0.8, 0.5, 0.02, 0.03, 0.2

    def step(state, dv=0.0, dw=0.0):
        state = state.copy()
        s = 3 * len(who) + 3 * (driver != 1)
        a, b, bias = state[s : s + 3] if calibrated else (0.0, 0.0, 0.0)
        move_blocks(state, space, driver, (1 + a) * v + dv, (1 + b) * omega + bias + dw, dt)
        return state

    e = 1e-6
    F = np.stack([(step(x + e * u) - step(x - e * u)) / (2 * e) for u in np.eye(N)], axis=1)
    G = np.stack(
        [(step(x, dv=e) - step(x, dv=-e)) / (2 * e), (step(x, dw=e) - step(x, dw=-e)) / (2 * e)],
        axis=1,
    )
    wanted = F @ P @ F.T + G @ np.diag([qv, qw]) @ G.T / dt
    ours_x, ours = x.copy(), P.copy()
    propagate_blocks(
        ours_x, ours, np.zeros((len(who), 2)), np.zeros((N, 2)), np.zeros((len(who), 2)), space,
        driver, v, omega, dt, qv, qw,
    )  # fmt: skip
    np.testing.assert_allclose(ours_x, step(x), atol=1e-12)
    np.testing.assert_allclose(ours, wanted, rtol=2e-4, atol=2e-4)
    np.testing.assert_array_equal(ours, ours.T)


def test_relative_poses_have_the_covariance_of_samples():
    rng = np.random.default_rng(0)
    mean = np.array([[1.0, 2.0, 0.5], [4.0, -1.0, 2.0], [0.0, 0.0, -3.0]])
    A = 0.002 * rng.normal(size=(9, 9))
    x, P = poses_to_blocks(mean, A @ A.T, (1, 0), (0, 1))
    samples = mean + (rng.normal(size=(200_000, 9)) @ A.T).reshape(-1, 3, 3)
    drawn = samples_to_blocks(samples, (1, 0), (0, 1))
    np.testing.assert_allclose(drawn.mean(axis=0), x, atol=2e-3)
    scale = np.sqrt(np.outer(P.diagonal(), P.diagonal()))
    np.testing.assert_allclose(np.cov(drawn.T) / scale, P / scale, atol=0.02)
    assert np.linalg.matrix_rank(P, tol=1e-9) == 3


@pytest.mark.parametrize(
    ("text", "view"),
    [
        ("world", FrameSpec("world")),
        ("ego:R1", FrameSpec("ego", ("R1",))),
        ("mutual:A,B", FrameSpec("mutual", ("A", "B"))),
    ],
)
def test_frames_are_read(text, view):
    assert parse_frame_spec(text) == view


@pytest.mark.parametrize("text", ["", "ego", "ego:", "mutual:A", "mutual:A,A", "world:R1", "odd"])
def test_other_frames_are_refused(text):
    with pytest.raises(UsageError, match="--frame"):
        parse_frame_spec(text)


def test_wheels_at_rest_have_no_errors():
    space = make_state_space((1,), (0,), (0, 1))
    x, P = np.arange(9.0), np.eye(9)
    x[3:] = 0.1
    before = x.copy()
    scratch = np.zeros((1, 2)), np.zeros((9, 2)), np.zeros((1, 2))
    propagate_blocks(x, P, *scratch, space, 0, 0.004, -0.009, 1.0, 0.0, 0.0)
    move_blocks(before, space, 0, 0.004, -0.009, 1.0)
    np.testing.assert_array_equal(x, before)
    assert not np.any(P[:3, 3:])
    propagate_blocks(x, P, *scratch, space, 0, 0.02, 0.0, 1.0, 0.0, 0.0)
    assert np.any(P[:3, 3:])
