import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.geometry import rotation_matrix, wrap_angle
from clt.initialization.pairwise.pairwise import solve_pair
from tests.initialization.pairwise.winding import measured, still, track


def error(mean, pose):
    e = np.atleast_2d(mean) - pose
    e[:, 2] = wrap_angle(e[:, 2])
    return e


def inside(found, pose):
    """The pose lies in the 99.7 % region of a hypothesis."""
    e = error(found.mean, pose)
    return any(x @ np.linalg.solve(C, x) < 13.93 for x, C in zip(e, found.covariance, strict=True))


@pytest.mark.parametrize("seed", range(6))
def test_exact_ranges_along_curves_leave_the_true_pose(seed):
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(-5.0, 5.0, 2), rng.uniform(-np.pi, np.pi)])
    a, b = (track(rng.normal(0.0, 0.5, 12)) for _ in "ab")
    found = solve_pair(measured(a, b, pose, 0.0, 0.0, rng))
    assert found.unique
    np.testing.assert_allclose(error(found.mean[0], pose), 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_straight_tracks_leave_exactly_four_poses(seed):
    rng = np.random.default_rng(seed)
    pose = np.array([*rng.uniform(1.0, 4.0, 2), rng.uniform(0.5, 2.5)])
    straight = track(np.zeros(12))
    pair = measured(straight, straight, pose, 0.0, 0.0, rng)
    found = solve_pair(pair)
    assert not found.unique
    assert len(found.mean) == 4
    np.testing.assert_allclose(found.probability, 0.25, atol=0.06)
    assert np.min(np.max(np.abs(error(found.mean, pose)), axis=1)) < 1e-6
    for mean in found.mean:
        distance = np.hypot(*(mean[:2] + straight @ rotation_matrix(mean[2]).T - straight).T)
        np.testing.assert_allclose(distance, pair.z, atol=1e-6)


def test_noisy_curves_the_truth_is_reported_and_what_is_called_unique_is_right():
    rng = np.random.default_rng(5)
    covered, right, unique, wrong = 0, 0, 0, 0
    for _ in range(60):
        pose = np.array([*rng.uniform(-4.0, 4.0, 2), rng.uniform(-np.pi, np.pi)])
        a, b = (track(rng.normal(0.0, 0.5, 29)) for _ in "ab")
        found = solve_pair(measured(a, b, pose, 0.1, 0.1 / np.sqrt(15.0), rng))
        e = error(found.mean[0], pose)[0]
        good = np.hypot(e[0], e[1]) < 1.0 and abs(e[2]) < np.radians(20.0)
        covered += inside(found, pose)
        right += good
        unique += found.unique
        wrong += found.unique and not good
    assert covered >= 59
    assert right >= 59
    assert unique >= 40
    assert wrong == 0


def test_few_ranges_are_not_guessed_from():
    rng = np.random.default_rng(6)
    pose = np.array([3.0, 1.0, 0.7])
    a, b = (track(rng.normal(0.0, 0.5, 3)) for _ in "ab")
    found = solve_pair(measured(a, b, pose, 0.2, 0.05, rng))
    assert not found.unique
    assert inside(found, pose)
    assert found.probability[0] < 0.5
    assert found.probability.sum() == pytest.approx(1.0)


def test_a_static_robot_is_a_place_without_heading():
    rng = np.random.default_rng(7)
    pose = np.array([3.0, -2.0, 0.0])
    a = track(rng.normal(0.0, 0.5, 12))
    found = solve_pair(measured(a, np.zeros_like(a), pose, 0.05, 0.0, rng), turns=False)
    assert found.unique
    np.testing.assert_allclose(found.mean[0], pose, atol=0.2)
    assert found.mean[0, 2] == 0.0


def test_residuals_beyond_their_noise_widen_the_answer():
    rng = np.random.default_rng(8)
    pose = np.array([3.0, -2.0, 1.0])
    a, b = (track(rng.normal(0.0, 0.5, 29)) for _ in "ab")
    noisy = measured(a, b, pose, 0.2, 0.0, rng)
    bold = noisy._replace(variance=noisy.variance / 100.0)
    honest, found = solve_pair(noisy), solve_pair(bold)
    ratio = np.sqrt(np.trace(found.covariance[0]) / np.trace(honest.covariance[0]))
    assert 0.5 < ratio < 2.0


@pytest.mark.parametrize(
    ("first", "sigma", "across"),
    [(0.2, 0.05, 0.3), (0.5, 0.1, 0.5), (0.2, 0.1, 0.4), (1.0, 0.05, 0.7)],
)
def test_two_solutions_in_one_direction_are_distinguished(first, sigma, across):
    """Mirror images at the line that robot i drove along, both straight ahead of its start."""
    ys = np.linspace(-0.5, 0.5, 8)
    a = [(0.0, 0.0), *((2.0, y) for y in ys)]
    z = [2.0, *np.hypot(across, ys)]
    found = solve_pair(still(z, [first, *[sigma] * 8], a), turns=False)
    assert not found.unique
    np.testing.assert_allclose(found.probability[:2], 0.5, atol=0.02)
    np.testing.assert_allclose(np.sort(found.mean[:2, 0]), [2 - across, 2 + across], atol=0.03)
    np.testing.assert_allclose(found.mean[:2, 1], 0.0, atol=0.05)


@pytest.mark.parametrize(("row", "excess"), [(12, 100.0), (4, 300.0), (0, 300.0), (2, 1e5)])
def test_a_range_that_is_wildly_wrong_is_survived(row, excess):
    rng = np.random.default_rng(9)
    a, b = (track(rng.normal(0.0, 0.5, 12)) for _ in "ab")
    pair = measured(a, b, np.array([3.0, -2.0, 1.0]), 0.2, 0.0, rng)
    pair.z[row] += excess
    found = solve_pair(pair)
    assert np.all(np.isfinite(found.mean))
    assert np.all(np.isfinite(found.covariance))
    assert not found.unique


def test_a_search_that_is_cut_off_calls_nothing_unique():
    """Robots that all but touch along the same way, with ranges to a millimetre."""
    rng = np.random.default_rng(10)
    a = track(rng.normal(0.0, 0.5, 6))
    pair = measured(a, a, np.zeros(3), 0.001, 0.0, rng)
    found = solve_pair(
        pair._replace(z=np.array([1.0, *[0.001] * 6]), variance=np.array([1.0, *[1e-6] * 6]))
    )
    assert not found.complete
    assert not found.unique


@pytest.mark.parametrize("z", [[1.0, 5.0], [5.0, 1.0], [1.0, 1.0, 6.0], [1.0, 5.0, 1.0]])
def test_few_ranges_that_no_pose_explains_say_nothing(z):
    k = np.arange(len(z))
    pair = still(z, [0.05] * len(z), np.stack([0.6 * k, 0.0 * k], axis=1))
    moving = pair._replace(b=np.stack([0.6 * k, 0.1 * k**2], axis=1))
    assert not solve_pair(moving).unique
    assert not solve_pair(pair, turns=False).unique


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_a_first_range_of_nothing_is_survived(n):
    rng = np.random.default_rng(11)
    a, b = (track(rng.normal(0.0, 0.5, n - 1)) for _ in "ab")
    pair = measured(a, b, np.array([1.0, 1.0, 0.5]), 0.1, 0.0, rng)
    pair.z[0] = 0.0
    found = solve_pair(pair)
    assert np.all(np.isfinite(found.mean))
    assert np.all(np.isfinite(found.covariance))


@pytest.mark.parametrize("value", [0.0, np.inf, np.nan, 1e300])
def test_a_variance_that_says_nothing_harms_nothing(value):
    rng = np.random.default_rng(2)
    pose = np.array([2.0, 1.0, 0.7])
    a, b = (track(rng.normal(0.0, 0.5, 14)) for _ in "ab")
    pair = measured(a, b, pose, 0.01, 0.0, rng)
    variance = pair.variance.copy()
    variance[[3, 8]] = value
    found = solve_pair(pair._replace(variance=variance))
    assert np.abs(error(found.mean[0], pose)).max() < 0.2
    assert np.isfinite(found.covariance).all()


def test_a_pair_without_a_usable_range_is_refused():
    rng = np.random.default_rng(2)
    a, b = (track(rng.normal(0.0, 0.5, 5)) for _ in "ab")
    pair = measured(a, b, np.array([2.0, 1.0, 0.7]), 0.01, 0.0, rng)
    with pytest.raises(CltError, match="no range of the pair is usable"):
        solve_pair(pair._replace(variance=np.full(6, np.nan)))
