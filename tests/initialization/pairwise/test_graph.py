"""Joint hypotheses of a team against numerical Jacobians and the information filter."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.geometry import relative_pose, rotation_matrix, wrap_angle
from clt.initialization.pairwise.graph import (
    MAX_JOINT_HYPOTHESES,
    JointHypothesis,
    _likely,
    _next_pair,
    append_robot,
    combine_pairs,
    invert_hypotheses,
    update_with_pair,
)
from clt.initialization.pairwise.hypotheses import PairHypotheses


def spd(rng, n, scale=0.1):
    root = scale * rng.standard_normal((n, n))
    return root @ root.T + 1e-4 * np.eye(n)


def hypotheses(means, probability, rng=None, support=None):
    """Of one pair, sharp ones by default."""
    means = np.array(means, float)
    P = np.array([1e-4 * np.eye(3) if rng is None else spd(rng, 3) for _ in means])
    p = np.array(probability, float)
    return PairHypotheses(means, P, p, p if support is None else np.array(support), 0.0, False)


def joint_of(rng, n):
    mean = np.column_stack([rng.uniform(-3.0, 3.0, (n, 2)), rng.uniform(-1.5, 1.5, n)])
    return JointHypothesis(-1.0, -2.0, mean, spd(rng, 3 * n))


def jacobian(function, at):
    step = 1e-6
    columns = []
    for e in np.eye(at.size) * step:
        off = function(at + e) - function(at - e)
        off[..., 2::3] = wrap_angle(off[..., 2::3])
        columns.append(off / (2.0 * step))
    return np.array(columns).T


def compose(a, b):
    """Pose b, given in the frame of a, in the frame of which a is given."""
    return np.append(a[:2] + rotation_matrix(a[2]) @ b[:2], a[2] + b[2])


@pytest.mark.parametrize("seed", range(4))
def test_the_inverse_of_a_relative_pose_and_its_covariance(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform(-4.0, 4.0, (2, 2)), rng.uniform(-3.0, 3.0, 2)])
    there = hypotheses(poses, [0.75, 0.25], rng)
    back = invert_hypotheses(there)
    for k in range(2):
        F = jacobian(lambda pose: relative_pose(pose, np.zeros(3)), there.mean[k])
        assert back.mean[k] == pytest.approx(relative_pose(there.mean[k], np.zeros(3)))
        np.testing.assert_allclose(back.covariance[k], F @ there.covariance[k] @ F.T, atol=1e-8)
    again = invert_hypotheses(back)
    np.testing.assert_allclose(again.mean, there.mean, atol=1e-12)
    np.testing.assert_allclose(again.covariance, there.covariance, atol=1e-12)
    assert again.probability.tolist() == [0.75, 0.25]


@pytest.mark.parametrize("i", [0, 1, 2])
def test_a_further_robot_stands_where_a_placed_one_sees_it(i):
    rng = np.random.default_rng(i)
    joint = joint_of(rng, 3)
    h = JointHypothesis(-0.5, -0.25, np.array([1.0, -2.0, 0.8]), spd(rng, 3))
    found = append_robot(joint, i, h)
    np.testing.assert_allclose(found.mean[3], compose(joint.mean[i], h.mean), atol=1e-12)
    np.testing.assert_array_equal(found.mean[:3], joint.mean)
    assert (found.log_weight, found.log_support) == (-1.5, -2.25)

    def all_poses(x):
        return np.concatenate([x[:9], compose(x[3 * i : 3 * i + 3], x[9:])])

    F = jacobian(all_poses, np.concatenate([joint.mean.ravel(), h.mean]))
    P = np.zeros((12, 12))
    P[:9, :9], P[9:, 9:] = joint.covariance, h.covariance
    np.testing.assert_allclose(found.covariance, F @ P @ F.T, atol=1e-8)


@pytest.mark.parametrize("turns", [True, False])
@pytest.mark.parametrize(("i", "j"), [(0, 2), (2, 1)])
def test_a_pair_of_placed_robots_is_a_measurement(i, j, turns):
    """Against the information filter with a numerical Jacobian."""
    rng = np.random.default_rng(10 * i + j)
    joint, size = joint_of(rng, 3), 3 if turns else 2
    seen = relative_pose(joint.mean[i], joint.mean[j])
    h = JointHypothesis(-0.5, -0.25, seen + np.array([0.1, -0.05, 0.08]), spd(rng, 3))
    found = update_with_pair(joint, i, j, h, turns)

    def sight(x):
        poses = x.reshape(-1, 3)
        return relative_pose(poses[i], poses[j])

    H = jacobian(sight, joint.mean.ravel())[:size]
    R, r = h.covariance[:size, :size], (h.mean - seen)[:size]
    P = np.linalg.inv(np.linalg.inv(joint.covariance) + H.T @ np.linalg.solve(R, H))
    mean = joint.mean.ravel() + P @ H.T @ np.linalg.solve(R, r)
    np.testing.assert_allclose(found.covariance, P, atol=1e-7)
    np.testing.assert_allclose(found.mean.ravel(), mean, atol=1e-6)
    S = H @ joint.covariance @ H.T + R
    squared = r @ np.linalg.solve(S, r)
    density = -0.5 * (squared + np.linalg.slogdet(2.0 * np.pi * S)[1])
    assert found.log_weight == pytest.approx(-1.0 - 0.5 + density, abs=1e-5)
    assert found.log_support == found.log_weight
    assert (found.mismatch, found.checks) == (pytest.approx(squared, rel=1e-4), size)
    twice = update_with_pair(found, i, j, h, turns)
    assert twice.checks == 2 * size
    assert twice.mismatch > found.mismatch


def test_a_turn_beyond_pi_is_the_short_one():
    joint = JointHypothesis(0.0, 0.0, np.array([[0, 0, 0], [0, 0, 3.1]], float), 0.01 * np.eye(6))
    h = JointHypothesis(0.0, 0.0, np.array([0.0, 0.0, -3.1]), 0.01 * np.eye(3))
    found = update_with_pair(joint, 0, 1, h, turns=True)
    assert found.mismatch < 1.0
    # A third of the difference goes to each of three equally uncertain numbers.
    off = 2.0 * np.pi - 6.2
    assert found.mean[0, 2] == pytest.approx(-off / 3.0)
    assert found.mean[1, 2] == pytest.approx(3.1 + off / 3.0)


def test_what_closes_a_cycle_goes_before_what_is_most_certain():
    sharp, vague = hypotheses([[1, 0, 0]], [0.9]), hypotheses([[1, 0, 0]], [0.4])
    left = {("A", "B"): vague, ("B", "C"): sharp, ("C", "D"): sharp}
    assert _next_pair(["A"], left, frozenset()) == ("A", "B")
    assert _next_pair(["A", "B"], {("B", "C"): vague, ("B", "D"): sharp}, frozenset()) == ("B", "D")
    closing = {("B", "C"): vague, ("B", "D"): sharp}
    assert _next_pair(["A", "B", "C"], closing, frozenset()) == ("B", "C")
    assert _next_pair(["A"], {("B", "C"): sharp}, frozenset()) is None
    assert _next_pair(["A", "S"], {("B", "S"): sharp}, frozenset({"S"})) is None
    assert _next_pair(["A", "S"], {("B", "S"): sharp}, frozenset()) == ("B", "S")


def test_only_so_many_combinations_are_kept_and_what_is_lost_is_known():
    weights = np.log(np.full(MAX_JOINT_HYPOTHESES + 16, 1.0))
    joints = [JointHypothesis(w, w, np.zeros((1, 3)), np.eye(3), cut=0.5) for w in weights]
    kept = _likely(joints)
    assert len(kept) == MAX_JOINT_HYPOTHESES
    lost = 16.0 / (MAX_JOINT_HYPOTHESES + 16)
    assert kept[0].cut == pytest.approx(1.0 - 0.5 * (1.0 - lost))
    few = [JointHypothesis(w, w, np.zeros((1, 3)), np.eye(3)) for w in np.log([1e-5, 2e-4, 1.0])]
    assert [one.log_weight for one in _likely(few)] == [0.0, np.log(2e-4)]
    assert _likely(few)[0].cut == 0.0


def test_a_cycle_shows_which_of_two_poses_is_true():
    edges = {
        ("A", "B"): hypotheses([[2, 0, 0], [-2, 0, 0]], [0.5, 0.5]),
        ("A", "C"): hypotheses([[0, 2, 0], [0, -2, 0]], [0.5, 0.5]),
        ("C", "B"): hypotheses([[2, -2, 0], [5, 5, 0]], [0.5, 0.5]),
    }
    names, joints = combine_pairs("A", edges, frozenset())
    assert names[0] == "A"
    best = dict(zip(names, joints[0].mean, strict=True))
    np.testing.assert_allclose(best["B"], [2, 0, 0], atol=1e-9)
    np.testing.assert_allclose(best["C"], [0, 2, 0], atol=1e-9)
    assert joints[0].checks == 3
    assert all(one.log_weight < joints[0].log_weight - 100.0 for one in joints[1:])


def test_a_pair_is_inverted_where_its_second_robot_is_placed():
    edges = {("B", "A"): hypotheses([[1.0, 0.0, np.pi / 2]], [1.0])}
    names, joints = combine_pairs("A", edges, frozenset())
    assert names == ("A", "B")
    np.testing.assert_allclose(joints[0].mean[1], [0.0, 1.0, -np.pi / 2], atol=1e-12)
    assert joints[0].checks == 0


def test_the_support_of_a_combination_is_that_of_its_pairs():
    edges = {("A", "B"): hypotheses([[1, 0, 0], [2, 0, 0]], [0.6, 0.4], support=[0.1, 0.3])}
    _, joints = combine_pairs("A", edges, frozenset())
    assert [one.log_support for one in joints] == pytest.approx(np.log([0.1, 0.3]))
    assert [one.log_weight for one in joints] == pytest.approx(np.log([0.6, 0.4]))
