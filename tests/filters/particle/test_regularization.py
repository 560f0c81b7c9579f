"""Particles made distinct: the same moments, no new shapes, the variance of the mixture."""

from __future__ import annotations

from dataclasses import replace

import numba
import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.filters.mixture.mixture import solve_mixture
from clt.filters.particle.regularization import make_cell_workspace, regularize
from clt.filters.particle.sir import solve_sir
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

WIDE = (0.5, 0.5, 0.5)
EVEN = np.full(4000, -np.log(4000.0))


@numba.njit
def seed(number):
    """Seed the generator of the kernels."""
    np.random.seed(number)  # noqa: NPY002  numba has no other


def regularized(x, blocks=1):
    """The particles (K, N) after it; equal weights."""
    seed(3)
    y = x.copy()
    regularize(EVEN, y, blocks, x.shape[1], make_cell_workspace(*x.shape))
    return y


def test_copies_become_distinct_with_the_moments_that_they_had():
    rng = np.random.default_rng(1)
    A = np.array([[0.3, 0.0, 0.0], [0.2, 0.1, 0.0], [0.0, -0.05, 0.02]])
    few = rng.normal(size=(1000, 3)) @ A.T + (4.0, -2.0, 3.1)
    few[:, 2] = wrap_angle(few[:, 2])
    x = few[rng.integers(0, 1000, 4000)]
    y = regularized(x)
    assert np.unique(y[:, 0]).size == 4000
    d, e = (z - (4.0, -2.0, 3.1) for z in (x, y))
    d[:, 2], e[:, 2] = wrap_angle(d[:, 2]), wrap_angle(e[:, 2])
    sigma = d.std(axis=0)
    np.testing.assert_allclose(e.mean(axis=0), d.mean(axis=0), atol=0.05 * sigma.min())
    np.testing.assert_allclose(
        np.cov(e.T) / np.outer(sigma, sigma), np.cov(d.T) / np.outer(sigma, sigma), atol=0.05
    )


def test_what_is_certain_stays_so():
    x = np.random.default_rng(1).normal(size=(4000, 3)) * (0.1, 0.0, 0.2)
    y = regularized(x)
    np.testing.assert_array_equal(y[:, 1], 0.0)
    assert y[:, 0].std() == pytest.approx(0.1, rel=0.05)


def test_a_ring_stays_a_ring_and_two_modes_two():
    rng = np.random.default_rng(5)
    angle = rng.uniform(-np.pi, np.pi, 4000)
    radius = 5.0 + 0.1 * rng.normal(size=4000)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), angle], axis=1)
    y = regularized(ring)
    assert np.hypot(y[:, 0], y[:, 1]).std() < 0.3
    light = rng.random(4000) < 0.05
    modes = 0.05 * rng.normal(size=(4000, 3)) + np.outer(light, (6.0, 3.0, 1.0))
    y = regularized(modes)
    far = y[:, 0] > 3.0
    assert np.sum(far) == np.sum(light)
    assert np.all(np.abs(y[~far]) < 0.5)
    assert np.all(np.abs(y[far] - (6.0, 3.0, 1.0)) < 0.5)


def spreads(number):
    """Variances of position and heading over the second half: particle filter's by mixture's."""
    recording = simulate(load_scenario("araki-left-turns", {"seed": number}, {}))
    settings = FilterSettings(initial={"sigma": WIDE}, pf={"particles": 5000})
    start = from_truth(recording, WIDE)
    other = start.poses["car2"]
    off = np.random.default_rng(number).normal(size=3) * WIDE
    poses = {
        "car1": replace(start.poses["car1"], covariance=np.zeros((3, 3))),
        "car2": replace(other, mean=other.mean + off),
    }
    problem = build_problem(
        recording, replace(start, poses=poses), settings, parse_frame_spec("ego:car1")
    )
    late = problem.outputs.stamp > (problem.start + problem.end) // 2
    pf, mixture = (solve(problem, settings) for solve in (solve_sir, solve_mixture))
    sums = [run.covariance[late].mean(axis=0).diagonal() for run in (pf, mixture)]
    return (sums[0][:2].sum() / sums[1][:2].sum()), sums[0][2] / sums[1][2]


def test_five_thousand_particles_state_the_variance_of_the_mixture():
    ratio = np.array([spreads(number) for number in (1, 2, 3, 4)])
    assert np.all((ratio.mean(axis=0) > 0.8) & (ratio.mean(axis=0) < 1.25))
