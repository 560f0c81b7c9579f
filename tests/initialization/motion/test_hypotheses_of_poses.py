"""The bank of hypotheses and what becomes of its modes, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from clt.initialization.motion.heading import fit_heading, widest_anchors
from clt.initialization.motion.heading_hypotheses import (
    SAME_MODE_M,
    SAME_MODE_RAD,
    START_HEADINGS,
    PoseMode,
    RefinedStart,
    merge_modes,
    probabilities,
    same_mode,
    start_hypotheses,
)
from clt.initialization.motion.search import (
    DECIDED_HEADING_SIGMA,
    Candidate,
    PoseSearch,
    _decided,
    _distinct,
    distance_travelled,
    same_pose,
)
from clt.initialization.motion.team import MAX_COMBINATIONS, _merged, likely_combinations
from clt.model.dead_reckoning import ReckonedPath


def mode(x, y, heading, log_likelihood=0.0, sigma=0.01, turn_sigma=0.01):
    end = np.array([x, y, heading])
    P = np.diag([sigma**2 / 2, sigma**2 / 2, turn_sigma**2])
    return PoseMode(end, end, P, log_likelihood, 1.0)


def refined(x=0.0, y=0.0, heading=0.0, sigma=0.01, turn_sigma=0.01, log_likelihood=0.0):
    mean = np.array([x, y, heading])
    P = np.diag([sigma**2 / 2, sigma**2 / 2, turn_sigma**2])
    return RefinedStart(mean, P, log_likelihood, 1.0, mean, P)


def test_hypotheses_put_the_antenna_at_every_place_with_every_heading():
    lever = np.array([0.3, -0.1])
    extra = [np.array([9.0, 9.0, 1.0])]
    places = [np.array([1.0, 2.0]), np.array([-3.0, 0.0])]
    found = start_hypotheses(places, lever, extra)
    assert len(found) == 2 * START_HEADINGS + 1
    assert found[-1] is extra[0]
    for k, pose in enumerate(found[:-1]):
        x, y, heading = pose
        c, s = np.cos(heading), np.sin(heading)
        antenna = [x + c * 0.3 + s * 0.1, y + s * 0.3 - c * 0.1]
        assert antenna == pytest.approx(places[k // START_HEADINGS], abs=1e-12)
    headings = np.sort([pose[2] for pose in found[:START_HEADINGS]])
    np.testing.assert_allclose(np.diff(headings), 2.0 * np.pi / START_HEADINGS, atol=1e-12)
    assert np.all(np.abs(headings) <= np.pi)


@pytest.mark.parametrize(
    ("a", "b", "same"),
    [
        # 3 sigma and SAME_MODE_M beside it, in place ...
        (mode(0, 0, 0, sigma=0.1), mode(0.3 + SAME_MODE_M - 1e-6, 0, 0), True),
        (mode(0, 0, 0, sigma=0.1), mode(0.3 + SAME_MODE_M + 1e-6, 0, 0), False),
        # ... where a sigma of more than 0.2 m counts for no more ...
        (mode(0, 0, 0, sigma=9.0), mode(0, 0.6 + SAME_MODE_M + 1e-6, 0), False),
        # ... and in heading, also across pi.
        (mode(0, 0, 0, turn_sigma=0.05), mode(0, 0, 0.15 + SAME_MODE_RAD - 1e-6), True),
        (mode(0, 0, 0, turn_sigma=0.05), mode(0, 0, 0.15 + SAME_MODE_RAD + 1e-6), False),
        (mode(0, 0, 0, turn_sigma=9.0), mode(0, 0, -0.3 - SAME_MODE_RAD - 1e-6), False),
        (mode(0, 0, 3.13), mode(0, 0, -3.13), True),
    ],
)
def test_hypotheses_that_end_at_one_pose(a, b, same):
    assert same_mode(a, b) == same


def test_a_mode_has_the_probability_of_all_its_hypotheses():
    best, other = mode(1, 0, 0, np.log(0.5)), mode(2, 0, 0, np.log(0.25))
    found = merge_modes([best, other])
    assert found.log_likelihood == pytest.approx(np.log(0.75))
    assert found.end is best.end


def test_probabilities_are_flatter_where_ranges_scatter_more():
    np.testing.assert_allclose(probabilities([0.0, np.log(3.0)]), [0.25, 0.75])
    np.testing.assert_allclose(probabilities([-1e4, -1e4 + 2.0 * np.log(3.0)], 2.0), [0.25, 0.75])
    np.testing.assert_allclose(probabilities([0.0, np.log(3.0)], 0.5), [0.25, 0.75])


@pytest.mark.parametrize(
    ("b", "same"),
    [
        # The wider of two unequal poses counts: 3 * 0.1 m, and 2 cm beside that.
        (refined(0.3 + 0.019, sigma=0.1), True),
        (refined(0.3 + 0.021, sigma=0.1), False),
        (refined(0.2, sigma=0.001), False),
        (refined(heading=0.3 * 0.1 / 0.1 + 0.019, turn_sigma=0.1), True),
        (refined(heading=0.3 + 0.021, turn_sigma=0.1), False),
        (refined(heading=0.3 + 0.021, turn_sigma=0.9), False),
        (refined(heading=2.0 * np.pi), True),
    ],
)
def test_refined_poses_that_differ_by_less_than_the_wider_ones_uncertainty(b, same):
    a = refined()
    assert same_pose(a, b) == same
    assert same_pose(b, a) == same


def test_poses_that_refinement_brought_together_count_once_per_frame():
    a, near = refined(log_likelihood=1.0), refined(0.01, log_likelihood=3.0)
    far = refined(5.0, log_likelihood=2.0)
    found = _distinct([(0, a), (0, near), (0, far), (1, a)])
    assert [(frame, pose.mean[0]) for frame, pose in found] == [(0, 0.01), (0, 5.0), (1, 0.0)]


@pytest.mark.parametrize(
    ("probability", "turn_sigma", "decided"),
    [
        (1.0 - 1e-7, 0.99 * DECIDED_HEADING_SIGMA, True),
        (1.0 - 1e-5, 0.01, False),
        (1.0, 1.01 * DECIDED_HEADING_SIGMA, False),
    ],
)
def test_a_search_ends_with_one_sharp_pose(probability, turn_sigma, decided):
    best = Candidate(0, refined(turn_sigma=turn_sigma), probability)
    assert _decided([best, Candidate(0, refined(9.0), 1e-6)]) == decided


def test_the_way_that_a_robot_has_driven():
    second = 1_000_000_000
    stamp = 5 * second + np.arange(4) * second
    none = np.zeros(4)
    path = ReckonedPath(stamp, none, none, none, np.array([0.0, 1.0, 1.0, 3.0]))
    assert distance_travelled(path, 5 * second) == 0.0
    assert distance_travelled(path, 7 * second + second // 2) == pytest.approx(2.0)
    assert distance_travelled(path, 99 * second) == 3.0


def candidates(*items):
    return PoseSearch(
        tuple(Candidate(f, refined(float(k)), p) for k, (f, p) in enumerate(items)), 0
    )


def test_combinations_are_of_one_frame_and_come_by_their_probability():
    searches = {
        "A": candidates((0, 0.6), (0, 0.3), (1, 0.1)),
        "B": candidates((0, 0.5), (1, 0.5)),
    }
    found = likely_combinations(searches, 2)
    chosen = [(one["A"].probability, one["B"].probability, one["A"].frame) for one in found]
    assert chosen == [(0.6, 0.5, 0), (0.3, 0.5, 0), (0.1, 0.5, 1)]
    assert all(one["A"].frame == one["B"].frame for one in found)
    none = likely_combinations({"A": candidates((0, 1.0)), "B": candidates((1, 1.0))}, 2)
    assert none == []


def test_no_more_combinations_than_so_many_the_most_probable_ones():
    shares = 0.5 ** np.arange(1, 12)
    searches = {n: candidates(*((0, p) for p in shares)) for n in "AB"}
    found = likely_combinations(searches, 1)
    assert len(found) == MAX_COMBINATIONS
    weight = [one["A"].probability * one["B"].probability for one in found]
    assert weight == sorted(weight, reverse=True)
    every = np.sort(np.outer(shares, shares).ravel())[::-1]
    np.testing.assert_allclose(weight, every[:MAX_COMBINATIONS])


def test_poses_that_are_the_same_in_several_frames_stand_there_once():
    a = Candidate(0, refined(), 0.5)
    same = Candidate(1, refined(0.01), 0.2)
    far = Candidate(1, refined(5.0), 0.3)
    found = _merged([(a, 0.4), (far, 0.35), (same, 0.25)])
    assert [(one.pose.mean[0], p) for one, p in found] == [(0.0, pytest.approx(0.65)), (5.0, 0.35)]


def test_three_positions_give_a_heading_and_two_do_not():
    """Regression of p = o + R d: four unknowns."""
    body = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.5]])
    c, s = np.cos(0.7), np.sin(0.7)
    place = np.array([1.0, 2.0]) + body @ np.array([[c, s], [-s, c]])
    P = np.tile(0.01 * np.eye(2), (3, 1, 1))
    found = fit_heading(place, P, body)
    assert found.heading == pytest.approx(0.7)
    np.testing.assert_allclose(found.origin, [1.0, 2.0])
    assert fit_heading(place[:2], P[:2], body[:2]) is None
    # The variance that (c, s) has across the heading: 0.01 / sum of |d - mean d|^2.
    spread = np.sum((body - body.mean(axis=0)) ** 2)
    assert found.variance == pytest.approx(0.01 / spread)


def test_the_anchors_that_lie_furthest_apart():
    anchors = np.array([[0.0, 0.0], [1.0, 5.0], [-3.0, -3.0], [2.0, 0.0]])
    assert widest_anchors(anchors) == (1, 2)
    assert widest_anchors(anchors[:2]) == (0, 1)


def test_the_first_robot_of_a_joint_start():
    rng = np.random.default_rng(1)
    P, Q = np.cov(rng.normal(size=(6, 30))), np.cov(rng.normal(size=(6, 30)))
    joint = RefinedStart(np.arange(6.0), P, -3.0, 1.2, np.arange(6.0) + 10.0, Q)
    first = joint.first
    assert first.mean.tolist() == [0.0, 1.0, 2.0]
    assert first.end.tolist() == [10.0, 11.0, 12.0]
    np.testing.assert_array_equal(first.covariance, P[:3, :3])
    np.testing.assert_array_equal(first.end_covariance, Q[:3, :3])
    assert (first.log_likelihood, first.nis) == (-3.0, 1.2)
