"""The particle filters against the Kalman filter, each other, and what resampling promises."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.estimation.findings import MIN_UNIQUE_PROBABILITY
from clt.filters.kalman.gaussian import solve_ekf
from clt.filters.particle.gaussian_particles import draw_gaussians
from clt.filters.particle.particles import solve_pf
from clt.filters.particle.resampling import effective_sample_size, systematic_resampling
from clt.initialization.given.truth import from_truth
from clt.model import belief
from clt.model.belief import Belief
from clt.model.choices import FrameSpec
from clt.model.mixture_moments import ROWS, mixture_block_moments, particle_mode_probability
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from tests.filters.mixture.test_mixture import EGO, cut, mirrored, pair_problem, relative_error
from tests.filters.teams import team_recording

SIR = FilterSettings(pf={"kind": "sir", "particles": 4000})
GAUSSIAN = FilterSettings(pf={"kind": "gaussian", "gaussians": 60})
BOTH = pytest.mark.parametrize("settings", [SIR, GAUSSIAN], ids=["sir", "gaussian"])


@numba.njit
def drawn_often(log_weight, times, seed):
    """How often each particle is drawn, (times, K), and whether places agree with numbers."""
    np.random.seed(seed)  # noqa: NPY002  numba has no other
    K = log_weight.size
    copies, source = np.zeros(K, np.int64), np.zeros(K, np.int64)
    counts = np.zeros((times, K), np.int64)
    sound = True
    for t in range(times):
        systematic_resampling(log_weight, copies, source)
        counts[t] = copies
        for k in range(K):
            sound = sound and np.sum(source == k) == copies[k] and copies[source[k]] > 0
            sound = sound and (copies[k] == 0 or source[k] == k)
    return counts, sound


def test_resampling_is_unbiased_and_as_even_as_can_be():
    rng = np.random.default_rng(3)
    w = rng.random(50) ** 4
    w[7] = 0.0
    w /= w.sum()
    with np.errstate(divide="ignore"):
        counts, sound = drawn_often(np.log(w), 20_000, 5)
    assert sound
    np.testing.assert_array_equal(counts.sum(axis=1), 50)
    assert np.all(np.abs(counts - 50 * w) < 1.0 + 1e-9)
    np.testing.assert_allclose(counts.mean(axis=0), 50 * w, atol=4 * 0.5 / np.sqrt(20_000))


def test_effective_size():
    assert effective_sample_size(np.log(np.full(8, 0.125))) == pytest.approx(8.0)
    assert effective_sample_size(
        np.log(np.array([1.0 - 3e-12, 1e-12, 1e-12, 1e-12]))
    ) == pytest.approx(1.0)


def linear_problem(settings):
    """A robot on a line through its anchors, heading certain: all is linear and Gaussian."""
    recording = team_recording(seed=3, moving=1, seconds=5.0)
    stamp = recording.odometry["R1"].stamp
    rng = np.random.default_rng(3)
    v = 0.5 + 0.2 * rng.normal(size=stamp.size)
    straight = replace(recording.odometry["R1"], v=v, omega=np.zeros(stamp.size))
    at = 20.0 + 0.5 * recording.ranges.stamp * 1e-9
    measured = at - np.array([0.0, 12.0])[recording.ranges.source] + 0.1 * rng.normal(size=at.size)
    truth = recording.truth["R1"]
    zero = np.zeros(truth.stamp.size)
    recording = replace(
        recording,
        odometry={"R1": straight},
        ranges=replace(recording.ranges, range=measured),
        truth={"R1": replace(truth, x=20.0 + 0.5 * truth.stamp * 1e-9, y=zero, heading=zero)},
    )
    return build_problem(recording, from_truth(recording, settings.initial.sigma), settings)


def test_is_the_kalman_filter_where_the_world_is_linear():
    common = {"gate": 0.0, "initial": {"sigma": (0.3, 0.0, 0.0)}, "noise": {"sigma_omega": 1e-5}}
    settings = FilterSettings(**common, pf={"kind": "sir", "particles": 10_000})
    problem = linear_problem(settings)
    ours, theirs = solve_pf(problem, settings), solve_ekf(problem, settings)
    sigma = np.sqrt(theirs.covariance[:, 0, 0])
    difference = (ours.mean[:, 0] - theirs.mean[:, 0]) / sigma
    # The error of 10 000 samples is 0.01 sigma; resampled again and again, some times that.
    assert np.sqrt(np.mean(difference**2)) < 0.04
    spread = np.sqrt(ours.covariance[:, 0, 0]) / sigma
    assert abs(spread.mean() - 1.0) < 0.02
    np.testing.assert_allclose(ours.variance[20:] / theirs.variance[20:], 1.0, atol=0.15)


def test_gaussian_particles_are_the_ekf_where_nothing_is_wide():
    recording = team_recording(seed=2, moving=3, seconds=10.0)
    problem = build_problem(recording, from_truth(recording, (0.01,) * 3), GAUSSIAN, EGO)
    ours, theirs = solve_pf(problem, GAUSSIAN), solve_ekf(problem, GAUSSIAN)
    sigma = np.sqrt(np.einsum("oii->oi", theirs.covariance))
    difference = ours.mean - theirs.mean
    difference[:, 2] = wrap_angle(difference[:, 2])
    assert np.sqrt(np.mean((difference / sigma) ** 2)) < 0.2


@BOTH
def test_the_truth_wins_over_its_mirror_image(settings):
    recording = team_recording(seed=1, moving=2, seconds=30.0)
    problem = build_problem(recording, mirrored(recording), settings, EGO)
    solution = solve_pf(problem, settings)
    assert solution.share[0] == pytest.approx(0.5, abs=0.1)
    assert solution.share[-1] > 0.99
    assert np.hypot(*relative_error(recording, problem, solution)[-50:, :2].T).max() < 0.6


@BOTH
def test_a_seed_gives_the_same_bits_and_another_gives_others(settings):
    recording = team_recording(seed=6, moving=2, seconds=4.0)
    problem = pair_problem(recording, (0.5, 0.5, 0.5))
    first, second = (solve_pf(problem, settings) for _ in range(2))
    other = solve_pf(problem, settings.model_copy(
        update={"pf": settings.pf.model_copy(update={"seed": 2})}))  # fmt: skip
    for name in ("mean", "covariance", "share", "residual"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert np.any(first.mean != other.mean)


@BOTH
def test_goes_on_where_it_stopped(settings):
    recording = team_recording(seed=3, moving=2, seconds=20.0)
    problem = pair_problem(recording, (0.2, 0.2, 0.2))
    whole = solve_pf(problem, settings)
    early, late = cut(problem, 8_025_000_000)
    first = solve_pf(early, settings)
    rest = solve_pf(replace(late, prior=None, belief=first.belief, epoch=1), settings)
    sigma = np.sqrt(np.einsum("oii->oi", whole.covariance))
    joined = np.concatenate([first.mean, rest.mean])
    difference = joined - whole.mean
    difference[:, 2] = wrap_angle(difference[:, 2])
    assert np.sqrt(np.mean((difference / sigma) ** 2)) < 0.35
    again = solve_pf(replace(late, prior=None, belief=first.belief, epoch=2), settings)
    assert settings is GAUSSIAN or np.any(again.mean != rest.mean)


def test_few_poses_are_left_to_points_and_many_to_gaussians():
    recording = team_recording(seed=1, moving=2, seconds=1.0)
    pair = pair_problem(recording, (0.1, 0.1, 0.1))
    many = build_problem(recording, from_truth(recording, (0.1,) * 3), FilterSettings(), EGO)
    assert len(many.robots) == 3
    for problem, width in ((pair, 0), (many, 9)):
        belief = solve_pf(problem, FilterSettings()).belief
        assert belief.covariance.shape[1] == width


def test_mutual_particles_are_inverses():
    recording = team_recording(seed=1, moving=2, seconds=5.0)
    problem = pair_problem(recording, (0.5, 0.5, 1.0), view=FrameSpec("mutual", ("R1", "R2")))
    for settings in (SIR, GAUSSIAN):
        x = solve_pf(problem, settings).belief.mean
        c, s = np.cos(x[:, 2]), np.sin(x[:, 2])
        back = np.stack([-c * x[:, 0] - s * x[:, 1], s * x[:, 0] - c * x[:, 1]], axis=1)
        np.testing.assert_allclose(x[:, 3:5], back, atol=1e-9)
        np.testing.assert_allclose(wrap_angle(x[:, 2] + x[:, 5]), 0.0, atol=1e-9)


def cloud(rng, counts, centres, sigma=0.1):
    """Particles about some poses, shuffled, equally heavy."""
    parts = [c + sigma * rng.normal(size=(n, 3)) for n, c in zip(counts, centres, strict=True)]
    x = rng.permutation(np.concatenate(parts))
    return np.full(x.shape[0], -np.log(x.shape[0])), x


@pytest.mark.parametrize("minor", [0, 20, 100, 400])
def test_the_leading_mode_of_particles(minor):
    rng = np.random.default_rng(1)
    log_weight, x = cloud(
        rng, [1000 - minor, minor], [np.array([1, 2, 3.1]), np.array([1, -2, -2])]
    )
    mean, P = np.zeros(3), np.zeros((3, 3))
    mixture_block_moments(log_weight, x, np.zeros((1000, 0, 0)), 1000, 0, mean, P)
    share = particle_mode_probability(
        log_weight, x, np.zeros((x.shape[0], 0, 0)), 0, P, np.zeros((ROWS, 3))
    )
    assert share == pytest.approx(1.0 - minor / 1000, abs=0.001)


def test_a_gaussian_cloud_is_unique():
    """Its tails are no other place."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        log_weight, x = cloud(rng, [5000], [np.array([1, 2, 3.1])])
        none, scratch = np.zeros((5000, 0, 0)), np.zeros((ROWS, 3))
        share = particle_mode_probability(log_weight, x, none, 0, np.cov(x.T), scratch)
        assert share > MIN_UNIQUE_PROBABILITY


def test_headings_are_averaged_whichever_particle_comes_first():
    log_weight, x = cloud(np.random.default_rng(4), [5000], [np.zeros(3)])
    x[0, 2] = np.pi
    mean, P = np.zeros(3), np.zeros((3, 3))
    mixture_block_moments(log_weight, x, np.zeros((5000, 0, 0)), 5000, 0, mean, P)
    assert abs(mean[2]) < 0.01
    assert P[2, 2] < 0.02
    mean, P = belief.belief_block_moments(Belief(log_weight, x, np.zeros((5000, 0, 0))), 0)
    assert abs(mean[2]) < 0.01
    assert P[2, 2] < 0.02


def test_moments_are_those_of_the_belief_on_the_circle():
    rng = np.random.default_rng(2)
    x = np.array([0.0, 0.0, np.pi]) + 0.2 * rng.normal(size=(500, 3))
    x[::2, 2] -= 2 * np.pi
    log_weight = np.log(rng.dirichlet(np.ones(500)))
    mean, P = np.zeros(3), np.zeros((3, 3))
    mixture_block_moments(log_weight, x, np.zeros((500, 0, 0)), 500, 0, mean, P)
    w = np.exp(log_weight)
    assert abs(wrap_angle(mean[2] - np.angle(w @ np.exp(1j * x[:, 2])))) < 2e-3
    flat = x.copy()
    flat[::2, 2] += 2 * np.pi
    np.testing.assert_allclose(P, np.cov(flat.T, aweights=w, ddof=0), atol=1e-12)


def test_gaussians_are_drawn_in_proportion():
    belief = Belief(
        np.log([0.55, 0.0001, 0.4499]), np.arange(9.0).reshape(3, 3), np.zeros((3, 3, 3))
    )
    first = draw_gaussians(belief, 1000, 1).mean[:, 0]
    assert abs(np.mean(first == 0.0) - 0.55) < 0.002
    assert abs(np.mean(first == 6.0) - 0.4499) < 0.002
