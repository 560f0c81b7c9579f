"""The motion step against fine integration, its Jacobians against finite differences."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.model.unicycle import EXACT_NOISE, SHI_NOISE, exact_arc, process_noise, sinc

angle = st.floats(-math.pi, math.pi)
speed = st.floats(-3.0, 3.0)
turn = st.floats(-4.0, 4.0)
span = st.floats(1e-3, 0.5)


def step(state, v, omega, dt):
    dx, dy, _, _ = exact_arc(state[2], v, omega, dt)
    return np.array([state[0] + dx, state[1] + dy, state[2] + omega * dt])


@given(st.floats(-3.0, 3.0))
@settings(deadline=None)  # the first call may compile
def test_sinc_has_no_seam(x):
    assert math.isclose(sinc(x), np.sinc(x / math.pi), rel_tol=1e-14, abs_tol=1e-15)


@given(angle, speed, turn, span)
@settings(deadline=None)  # the first call may compile
def test_the_arc_is_the_integral_of_the_unicycle(theta, v, omega, dt):
    t = (np.arange(4000) + 0.5) * dt / 4000
    fine = [np.mean(f(theta + omega * t)) * v * dt for f in (np.cos, np.sin)]
    np.testing.assert_allclose(step([0, 0, theta], v, omega, dt)[:2], fine, atol=1e-6)


@given(angle, speed, turn, span, st.floats(0.0, 1.0))
@settings(deadline=None)  # the first call may compile
def test_steps_compose(theta, v, omega, dt, share):
    start = np.array([1.0, -2.0, theta])
    whole = step(start, v, omega, dt)
    parts = step(step(start, v, omega, share * dt), v, omega, (1 - share) * dt)
    np.testing.assert_allclose(parts, whole, atol=1e-12)


@given(angle, speed, turn, span)
@settings(deadline=None)  # the first call may compile
def test_transition_matches_finite_differences(theta, v, omega, dt):
    dx, dy, _, _ = exact_arc(theta, v, omega, dt)
    e = 1e-6
    gradient = (step([0, 0, theta + e], v, omega, dt) - step([0, 0, theta - e], v, omega, dt)) / (
        2 * e
    )
    np.testing.assert_allclose(gradient, [-dy, dx, 1.0], atol=1e-8)


@given(angle, st.floats(-1.5, 1.5), st.floats(-1.0, 1.0), st.floats(0.01, 0.1))
@settings(deadline=None)  # the first call may compile
def test_process_noise_is_that_of_the_twist(theta, v, omega, dt):
    var_v, var_w, interval, e = 0.04, 0.01, 0.05, 1e-6
    _, _, c, s = exact_arc(theta, v, omega, dt)
    xx, xy, yy, xt, yt, tt = process_noise(v, dt, c, s, interval, var_v, var_w, EXACT_NOISE)
    Q = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    at = lambda a, b: step([0, 0, theta], v + a, omega + b, dt)  # noqa: E731
    G = np.stack([(at(e, 0) - at(-e, 0)) / (2 * e), (at(0, e) - at(0, -e)) / (2 * e)], axis=1)
    wanted = G @ np.diag([var_v, var_w]) @ G.T * interval / dt
    # The chord's shortening, second order in omega dt, is left out of Q.
    np.testing.assert_allclose(Q, wanted, rtol=2e-2, atol=2e-3 * np.trace(wanted))
    assert np.linalg.eigvalsh(Q)[0] > -1e-15


def test_noise_of_one_sample_adds_up_to_its_interval_however_it_is_cut():
    whole = process_noise(0.0, 0.05, 1.0, 0.0, 0.05, 0.04, 0.01, EXACT_NOISE)
    assert math.isclose(whole[0], 0.04 * 0.05**2)
    parts = [process_noise(0.0, dt, 1.0, 0.0, 0.05, 0.04, 0.01, EXACT_NOISE) for dt in (0.02, 0.03)]
    assert math.isclose(parts[0][0] + parts[1][0], whole[0])


def test_shi_keeps_the_diagonal_only():
    c, s = math.cos(0.7), math.sin(0.7)
    exact = process_noise(0.0, 0.05, c, s, 0.05, 0.04, 0.01, EXACT_NOISE)
    shi = process_noise(0.0, 0.05, c, s, 0.05, 0.04, 0.01, SHI_NOISE)
    assert shi[1] == 0.0
    assert exact[1] != 0.0
    np.testing.assert_allclose([shi[0], shi[2], shi[5]], [exact[0], exact[2], exact[5]])
