from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.errors import CltError
from clt.metrics.align import (
    MIRROR_Y,
    Transform,
    fit_transform,
    fits_better_mirrored,
    rms_residual,
    transform_of_pose,
)

metres = st.floats(-100.0, 100.0)
angles = st.floats(-3.1, 3.1)
SHAPE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 3.0], [2.0, 5.0]])


@given(metres, metres, angles)
def test_fit_recovers_any_motion(x, y, rotation):
    found = fit_transform(SHAPE, Transform(x, y, rotation).points(SHAPE))
    assert (found.x, found.y) == pytest.approx((x, y), abs=1e-9)
    assert np.cos(found.rotation - rotation) == pytest.approx(1.0, abs=1e-15)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_no_other_motion_fits_better(seed):
    rng = np.random.default_rng(seed)
    source, target, weight = rng.normal(size=(7, 2)), rng.normal(size=(7, 2)), rng.random(7) + 0.1
    best = rms_residual(source, target, weight)
    found = fit_transform(source, target, weight)
    for step in 1e-3 * rng.normal(size=(20, 3)):
        other = Transform(found.x + step[0], found.y + step[1], found.rotation + step[2])
        left = np.sum((other.points(source) - target) ** 2, axis=1)
        assert np.sqrt(np.average(left, weights=weight)) >= best


def test_two_points_and_a_line_are_enough():
    line = np.array([[0.0, 0.0], [1.0, 0.0]])
    for points in (line, np.linspace([0, 0], [3, 1], 9)):
        found = fit_transform(points, Transform(1.0, 2.0, 0.7).points(points))
        assert (found.x, found.y, found.rotation) == pytest.approx((1.0, 2.0, 0.7))


@pytest.mark.parametrize("points", [np.ones((1, 2)), np.ones((50, 2))])
def test_one_place_shows_no_rotation(points):
    with pytest.raises(CltError, match="no rotation can be fitted"):
        fit_transform(points, points)


def test_nothing_to_fit():
    with pytest.raises(CltError, match="no matched positions"):
        fit_transform(np.empty((0, 2)), np.empty((0, 2)))


def test_transform_turns_poses_and_covariances():
    quarter = Transform(1.0, 2.0, np.pi / 2)
    assert quarter.poses(np.array([[3.0, 0.0, 3.0]])) == pytest.approx(
        np.array([[1.0, 5.0, 3.0 + np.pi / 2 - 2 * np.pi]])
    )
    P = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, 0.3], [0.5, 0.3, 1.0]])
    turned = [[2.0, -1.0, -0.3], [-1.0, 4.0, 0.5], [-0.3, 0.5, 1.0]]
    assert quarter.covariances(P[None])[0] == pytest.approx(np.array(turned))


def test_first_brings_pose_on_pose():
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-4.0, 0.5, -3.0])
    assert transform_of_pose(a, b).poses(a[None])[0] == pytest.approx(b)
    with pytest.raises(CltError, match="headings"):
        transform_of_pose(a, np.array([0.0, 0.0, np.nan]))


def test_mirror_is_seen_and_only_then():
    noise = 0.01 * np.random.default_rng(1).normal(size=SHAPE.shape)
    target = Transform(3.0, 1.0, 2.0).points(SHAPE)
    assert fits_better_mirrored(SHAPE * MIRROR_Y + noise, target)
    assert not fits_better_mirrored(SHAPE + noise, target)
    assert not fits_better_mirrored(target, target)


@pytest.mark.parametrize("points", [np.linspace([0, 0], [3, 1], 9), np.ones((9, 2)), SHAPE[:2]])
def test_what_is_its_own_mirror_image_is_not_mirrored(points):
    assert not fits_better_mirrored(points * MIRROR_Y, points)


def test_proper_alignment_does_not_hide_a_mirror():
    assert rms_residual(SHAPE * MIRROR_Y, SHAPE) > 0.5
