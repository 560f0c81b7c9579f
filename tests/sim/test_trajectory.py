import numpy as np
import pytest

from clt.sim.trajectory import MAX_KNOT_STEP_S, path_of_twists, refine_knots, state_at

START = (1.0, -2.0, 0.5)


def lively(seconds, seed=0):
    """A path whose twist has a kink at every knot."""
    draw = np.random.default_rng(seed)
    t = MAX_KNOT_STEP_S * np.arange(round(seconds / MAX_KNOT_STEP_S) + 1)
    v, omega = draw.uniform(-1.0, 1.0, len(t)), draw.uniform(-2.0, 2.0, len(t))
    return path_of_twists(t, v, omega, START)


def test_positions_agree_with_brute_force():
    path = lively(2.0)
    h = 2e-5
    t = h * np.arange(100_001)
    middle = state_at(path, t[:-1] + h / 2)
    x = START[0] + np.cumsum(h * middle.v * np.cos(middle.heading))
    y = START[1] + np.cumsum(h * middle.v * np.sin(middle.heading))
    state = state_at(path, t[1:])
    np.testing.assert_allclose(state.x, x, atol=1e-9)
    np.testing.assert_allclose(state.y, y, atol=1e-9)
    np.testing.assert_allclose(state.heading, START[2] + np.cumsum(h * middle.omega), atol=1e-9)
    np.testing.assert_allclose(state.s, np.cumsum(h * middle.v), atol=1e-9)


def test_knots_are_met():
    path = lively(5.0)
    for state in (state_at(path, path.t), state_at(path, path.t - 1e-12)):
        for name in ("x", "y", "heading", "s", "v", "omega"):
            np.testing.assert_allclose(getattr(state, name), getattr(path, name), atol=1e-9)


def test_backward_driving_shortens_the_arc_length():
    t, ones = np.array([0.0, MAX_KNOT_STEP_S]), np.ones(2)
    path = path_of_twists(t, -ones, 0 * ones, (0.0, 0.0, 0.0))
    assert path.s[-1] == pytest.approx(-MAX_KNOT_STEP_S)
    assert path.x[-1] == pytest.approx(-MAX_KNOT_STEP_S)


def test_refining_keeps_the_twist():
    t, v, omega = np.array([0.0, 0.5, 3.0]), np.array([0.0, 1.0, 1.0]), np.array([0.0, 0.4, -0.4])
    fine, fine_v, fine_omega = refine_knots(t, v, omega)
    assert np.diff(fine).max() <= MAX_KNOT_STEP_S + 1e-12
    assert np.isin(t, fine).all()
    np.testing.assert_allclose(fine_v, np.interp(fine, t, v))
    np.testing.assert_allclose(fine_omega, np.interp(fine, t, omega))
