from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.initialization.motion.heading import (
    bilaterate,
    fit_heading,
    position_fixes,
    track_position_fixes,
)

coordinate = st.floats(-20.0, 20.0)


@given(coordinate, coordinate, st.floats(0.5, 20.0))
@settings(max_examples=200)
def test_two_ranges_are_inverted_exactly(x, y, baseline):
    d1, d2 = np.array([np.hypot(x, y)]), np.array([np.hypot(x - baseline, y)])
    found_x, found_y = bilaterate(d1, d2, baseline)
    assert found_x[0] == pytest.approx(x, abs=1e-8)
    assert found_y[0] == pytest.approx(abs(y), abs=2e-4)


def test_the_printed_formula_is_wrong():
    d1, d2, baseline = 5.0, 4.0, 6.0
    phi = (d1**2 + d2**2 - baseline**2) / (2 * d1 * baseline)
    x, y = bilaterate(np.array([d1]), np.array([d2]), baseline)
    assert abs(d1 * np.cos(phi) - x[0]) > 1.0
    assert abs(d2 * np.sin(phi) - y[0]) > 1.0


def test_ranges_that_make_no_triangle_lie_on_the_baseline():
    x, y = bilaterate(np.array([1.0]), np.array([2.0]), 4.0)
    assert (x[0], y[0]) == (pytest.approx(1.625), 0.0)


def test_two_anchors_leave_two_places_and_three_one():
    anchors = np.array([[0.0, 0.0], [8.0, 0.0], [3.0, 7.0]])
    place = np.array([2.0, 3.0])
    d = np.hypot(*(place - anchors).T)
    sigma = np.full(3, 0.05)
    both = position_fixes(anchors[:2], d[:2], sigma[:2])
    found = sorted(fix.position.tolist() for fix in both)
    np.testing.assert_allclose(found, [[2.0, -3.0], [2.0, 3.0]], atol=1e-8)
    alone = position_fixes(anchors, d, sigma)
    assert len(alone) == 1
    np.testing.assert_allclose(alone[0].position, place, atol=1e-8)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_positions_scatter_as_their_covariance_says(count):
    rng = np.random.default_rng(count)
    anchors = np.array([[0, 0], [9, 0], [9, 8], [0, 8], [4, -2]], float)[:count]
    place = np.array([3.0, 2.5])
    d = np.hypot(*(place - anchors).T) + 0.05 * rng.normal(size=(2000, count))
    found = track_position_fixes(anchors, d, np.full(d.shape, 0.05), 1.0)
    e = found.position - place
    nees = np.einsum("ni,ni->n", e, np.linalg.solve(found.covariance, e[:, :, None])[:, :, 0])
    assert np.mean(nees) / 2 == pytest.approx(1.0, abs=0.06)


def test_a_missing_distance_is_done_without():
    anchors = np.array([[0.0, 0.0], [9.0, 0.0], [4.0, 6.0]])
    place = np.array([3.0, 2.5])
    d = np.tile(np.hypot(*(place - anchors).T), (2, 1))
    d[1, 2] = np.nan
    found = track_position_fixes(anchors, d, np.full(d.shape, 0.05), 1.0)
    np.testing.assert_allclose(found.position, [place, place], atol=1e-8)


def driven(rng, heading, curve, noise):
    """Positions of a drive of 2 m, 60 samples, their odometry displacements and covariances."""
    s = np.linspace(0.0, 2.0, 60)
    turn = curve * s
    step = np.diff(s, prepend=0.0)
    body = np.stack([np.cumsum(step * np.cos(turn)), np.cumsum(step * np.sin(turn))], axis=1)
    c, sn = np.cos(heading), np.sin(heading)
    place = np.array([1.0, 2.0]) + body @ np.array([[c, sn], [-sn, c]])
    sigma = np.array([0.05, 0.1]) * noise
    return (
        place + sigma * rng.normal(size=place.shape),
        body,
        np.tile(np.diag(sigma**2), (60, 1, 1)),
    )


@given(st.floats(-np.pi, np.pi), st.floats(-1.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_a_drive_without_noise_gives_the_exact_heading(heading, curve):
    place, body, _ = driven(np.random.default_rng(0), heading, curve, 0.0)
    found = fit_heading(place, np.tile(0.01 * np.eye(2), (60, 1, 1)), body)
    assert np.cos(found.heading - heading) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(found.origin, [1.0, 2.0], atol=1e-9)


def test_the_variance_of_a_heading_is_true():
    rng = np.random.default_rng(1)
    z = []
    for _ in range(600):
        place, body, covariance = driven(rng, 0.7, 0.0, 1.0)
        found = fit_heading(place, covariance, body)
        z.append((found.heading - 0.7) / np.sqrt(found.variance))
    assert np.std(z) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(z)) < 0.2


def test_regression_beats_a_line_fit():
    """The principal axis of slow, noisy positions is worse by far."""
    rng = np.random.default_rng(2)
    regressed, fitted = [], []
    for _ in range(300):
        place, body, covariance = driven(rng, 0.7, 0.0, 8.0)
        regressed.append(fit_heading(place, covariance, body).heading - 0.7)
        axis = np.linalg.svd(place - place.mean(axis=0))[2][0]
        axis = axis if axis @ [np.cos(0.7), np.sin(0.7)] > 0 else -axis
        fitted.append(np.arctan2(axis[1], axis[0]) - 0.7)
    assert np.mean(np.square(fitted)) > 1.1**2 * np.mean(np.square(regressed))


def test_standing_still_gives_no_heading():
    assert fit_heading(np.zeros((9, 2)), np.tile(np.eye(2), (9, 1, 1)), np.zeros((9, 2))) is None
