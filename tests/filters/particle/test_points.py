"""Points by themselves: what their noise adds up to, how ranges weigh them, who is moved when."""

from __future__ import annotations

import math

import numpy as np
import pytest

from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.filters.mixture.gaussian_sum import make_mixture_output
from clt.filters.particle.gaussian_particles import draw_gaussians
from clt.filters.particle.regularization import (
    make_cell_workspace,
    partition_cell,
    prepare_particles,
    split_cell,
    widest_number,
)
from clt.filters.particle.resampling import effective_sample_size, systematic_resampling
from clt.filters.particle.sir import (
    ParticleSet,
    advance_particle_block,
    propagate_particles,
    resample_particles,
    sir_kernel,
    weigh_particles,
)
from clt.model.belief import Belief
from clt.model.filter_inputs import FilterInputs, Outputs, schedule_events
from clt.model.mixture_moments import ROWS
from clt.model.mutual import set_inverse_mean
from clt.model.range_errors import no_range_errors
from clt.model.state_space import make_state_space, world_state_space
from clt.model.twist_segments import TwistSegments
from tests.filters.kalman.test_search_parts import SECOND, table

pytestmark = pytest.mark.usefixtures("interpreted")


def cloud_of(x, weight=None, drivers=1):
    x = np.array(x, float)
    K, N = x.shape
    weight = np.full(K, 1.0 / K) if weight is None else np.array(weight)
    return ParticleSet(
        np.log(weight), x, np.zeros((K, 0, 0)), np.zeros(drivers, np.int64), np.arange(drivers),
        np.zeros(K, np.int64), np.zeros(K, np.int64), np.zeros(K),
        np.zeros((1, 6), np.int64), np.zeros((1, 6)), np.zeros((ROWS, 3)),
        make_cell_workspace(K, N),
    )  # fmt: skip


def sample(var_v=0.04, var_omega=0.09, drivers=1):
    """One sample of 1 s for each driver."""
    one = np.ones(drivers)
    return TwistSegments(
        np.arange(drivers + 1), np.full(drivers, SECOND), one, 0.0 * one, one,
        var_v * one, var_omega * one,
    )  # fmt: skip


@pytest.mark.parametrize("cuts", [(1.0,), (0.1, 1.0), (0.5, 0.7, 1.0)])
def test_a_sample_cut_into_unequal_pieces_spreads_as_the_kalman_filters_believe(cuts):
    """Variance times interval, whatever the pieces: 0.09 (rad/s)^2 over 1 s, 0.04 (m/s)^2."""
    np.random.seed(1)  # noqa: NPY002  what kernels draw from
    cloud = cloud_of(np.zeros((1000, 3)))
    for cut in cuts:
        propagate_particles(cloud, 0, round(cut * SECOND), sample(), world_state_space(1))
    assert cloud.time[0] == SECOND
    assert cloud.cursor[0] == 1
    assert cloud.x[:, 2].var() == pytest.approx(0.09, rel=0.18)
    straight = cloud_of(np.zeros((1000, 3)))
    for cut in cuts:
        quiet = sample(var_omega=1e-12)
        propagate_particles(straight, 0, round(cut * SECOND), quiet, world_state_space(1))
    assert straight.x[:, 0].var() == pytest.approx(0.04, rel=0.18)
    assert straight.x[:, 0].mean() == pytest.approx(1.0, abs=0.03)


def test_after_the_last_sample_particles_stay():
    cloud = cloud_of(np.zeros((2, 3)))
    segments = sample()._replace(end=np.array([0]))
    cloud.cursor[0] = 1
    propagate_particles(cloud, 0, 9 * SECOND, segments, world_state_space(1))
    assert cloud.time[0] == 9 * SECOND
    assert not cloud.x.any()


def test_a_block_in_the_frame_of_an_ego_is_moved_by_both():
    """The whole of it for ranges to the ego; for ranges between others the robot alone."""
    space = make_state_space([1], [0])
    segments = sample(1e-12, 1e-12, drivers=2)
    for whole in (True, False):
        cloud = cloud_of([[5.0, 0.0, 0.0]], drivers=2)
        advance_particle_block(cloud, 0, SECOND, segments, space, whole)
        assert cloud.time.tolist() == ([SECOND] * 2 if whole else [0, SECOND])
        assert cloud.x[0, 0] == pytest.approx(5.0 if whole else 6.0, abs=1e-4)
    cloud = cloud_of([[5.0, 0.0, 0.0]], drivers=2)
    advance_particle_block(cloud, -1, SECOND, segments, space, True)
    assert cloud.time.tolist() == [0, 0]
    world = cloud_of([[5.0, 0.0, 0.0]])
    advance_particle_block(world, 0, SECOND, sample(1e-12, 1e-12), world_state_space(1), True)
    assert world.time.tolist() == [SECOND]


def weighed(cloud, z, gate, sigma=0.1):
    ranges, none = table([(1, 0, -1, 0, 0, z)], sigma), np.empty(0, np.int64)
    ranges = ranges._replace(weight_variance=4.0 * ranges.variance)
    trace = make_mixture_output(Outputs(none, none), ranges)
    weigh_particles(cloud, np.zeros((1, 2)), ranges, 0, gate, trace)
    return trace


def test_a_range_weighs_points_by_its_likelihood():
    cloud = cloud_of([[3, 4, 0], [0, 5.2, 0], [9, 0, 0]], [0.5, 0.3, 0.2])
    trace = weighed(cloud, 5.1, 16.0)
    r = np.array([0.1, -0.1, -3.9])
    nis = np.minimum(r**2 / 0.04, 16.0)
    share = np.array([0.5, 0.3, 0.2]) * np.exp(-0.5 * nis)
    np.testing.assert_allclose(np.exp(cloud.log_weight), share / share.sum())
    mean = np.array([0.5, 0.3, 0.2]) @ r
    assert trace.residual[0] == pytest.approx(mean)
    variance = np.array([0.5, 0.3, 0.2]) @ r**2 - mean**2 + 0.01
    assert trace.variance[0] == pytest.approx(variance)
    assert trace.verdict[0] == RANGE_USED


def test_an_outlier_weighs_all_points_alike():
    cloud = cloud_of([[3, 4, 0], [0, 5.2, 0]], [0.6, 0.4])
    trace = weighed(cloud, 20.0, 16.0)
    assert trace.verdict[0] == RANGE_REJECTED
    np.testing.assert_allclose(np.exp(cloud.log_weight), [0.6, 0.4])
    assert weighed(cloud, 20.0, 0.0).verdict[0] == RANGE_USED
    assert np.exp(cloud.log_weight[1]) > 0.99


def test_drawn_copies_of_mutual_points_stay_inverses():
    np.random.seed(2)  # noqa: NPY002
    rng = np.random.default_rng(2)
    x = np.concatenate([rng.normal(size=(300, 3)), np.zeros((300, 3))], axis=1)
    for row in x:
        set_inverse_mean(row)
    weight = np.where(np.arange(300) < 150, 1.9, 0.1) / 300.0
    cloud = cloud_of(x, weight)
    resample_particles(cloud, 2, True)
    np.testing.assert_allclose(np.exp(cloud.log_weight), 1.0 / 300.0)
    for row in cloud.x:
        again = row.copy()
        set_inverse_mean(again)
        np.testing.assert_allclose(again, row, atol=1e-12)
    assert np.unique(cloud.x[:, 0]).size == 300


def test_the_comb_takes_each_particle_as_often_as_it_weighs():
    weight = np.array([0.05, 0.5, 0.25, 0.2, 0.0])
    with np.errstate(divide="ignore"):
        log_weight = np.log(weight)
    copies, source = np.zeros(5, np.int64), np.full(5, -1)
    for seed in range(20):
        np.random.seed(seed)  # noqa: NPY002
        systematic_resampling(log_weight, copies, source)
        assert copies.sum() == 5
        assert np.all(np.abs(copies - 5.0 * weight) < 1.0 + 1e-9)
        assert copies[4] == 0
        np.testing.assert_array_equal(np.bincount(source, minlength=5), copies)
        for k in range(5):
            if copies[k] > 0:
                assert source[k] == k
    assert effective_sample_size(log_weight) == pytest.approx(1.0 / np.sum(weight**2))


def test_gaussians_are_drawn_by_their_weight():
    means = np.array([[1.0, 0, 0], [2.0, 0, 0]])
    belief = Belief(np.log([0.7, 0.3]), means, np.array([np.eye(3), 2 * np.eye(3)]))
    found = draw_gaussians(belief, 10, 1)
    assert np.bincount(found.mean[:, 0].astype(int)).tolist() == [0, 7, 3]
    np.testing.assert_allclose(np.exp(found.log_weight), 0.1)
    assert found.covariance[-1, 0, 0] == 2.0


def cells_of(x, numbers=None):
    x = np.array(x, float)
    cells = make_cell_workspace(*x.shape)
    cells.order[:] = np.arange(len(x))
    weight = np.full(len(x), -math.log(len(x)))
    prepare_particles(weight, x, x.shape[1] // 3, numbers or x.shape[1], cells)
    return x, cells


def test_headings_are_brought_together_and_spreads_are_known():
    rng = np.random.default_rng(3)
    given = rng.normal(size=(400, 3)) * [2.0, 0.5, 0.1]
    given[:, 2] += np.pi
    given[::2, 2] -= 2.0 * np.pi
    x, cells = cells_of(given)
    assert np.ptp(x[:, 2]) < 1.0
    np.testing.assert_allclose(cells.sigma, x.std(axis=0))
    order = np.arange(200, 400)
    narrow = x.copy()
    narrow[order, 0] *= 0.01
    cells.sigma[:] = narrow.std(axis=0)
    widest = int(np.argmax(narrow[order].std(axis=0) / cells.sigma))
    assert widest_number(narrow, 200, 400, 3, cells) == widest
    cells.sigma[:] = 0.0
    assert widest_number(narrow, 200, 400, 3, cells) == -1


def test_a_cell_is_sorted_about_a_limit():
    x, cells = cells_of([[3, 0, 0], [1, 0, 0], [2, 0, 0], [0, 0, 0]])
    middle = partition_cell(x, 0, 1.5, 0, 4, cells.order)
    assert middle == 2
    assert set(cells.order[:2]) == {1, 3}
    assert partition_cell(x, 0, 9.0, 0, 4, cells.order) == 0
    assert partition_cell(x, 0, 1.5, 2, 4, cells.order) == 2


@pytest.mark.parametrize(("apart", "split"), [(0.0, False), (1.0, False), (12.0, True)])
def test_small_cells_are_split_only_where_they_are_two(apart, split):
    rng = np.random.default_rng(4)
    x = rng.normal(size=(200, 3)) * [1.0, 1e-3, 1e-3]
    x[:80, 0] += apart
    x, cells = cells_of(x)
    cells.sigma[:] = 1.0
    middle = split_cell(x, 0, 200, 3, cells)
    assert (middle == 120) == split
    assert (middle == 0) != split
    if split:
        assert set(cells.order[120:]) == set(range(80))


def test_large_cells_are_split_anyway():
    rng = np.random.default_rng(5)
    x, cells = cells_of(rng.normal(size=(1000, 3)))
    assert 300 < split_cell(x, 0, 1000, 3, cells) < 700
    few, cells = cells_of(np.zeros((3, 3)))
    assert split_cell(few, 0, 3, 3, cells) == 0


@pytest.mark.parametrize("ends", [(-1, 0), (0, -1)])
def test_a_range_of_the_ego_brings_the_ego(ends):
    """It drives 1 m towards a robot that stands 5 m ahead: then they are 4 m apart."""
    space, still = make_state_space([1], [0]), 1e-12
    segments = sample(still, still, drivers=2)._replace(v=np.array([1.0, 0.0]))
    ranges = table([(1, *ends, 0, 0, 4.0)])
    none = np.empty(0, np.int64)
    outputs = Outputs(none, none)
    inputs = FilterInputs(
        space, np.zeros((1, 2)), segments, ranges, no_range_errors(1), outputs,
        schedule_events(ranges, outputs), 0,
        SECOND,
    )  # fmt: skip
    cloud = cloud_of([[5.0, 0.0, 0.0]] * 4, drivers=2)
    trace = make_mixture_output(outputs, ranges)
    sir_kernel(cloud, inputs, 16.0, 1, False, trace)
    assert trace.residual[0] == pytest.approx(0.0, abs=1e-3)
    assert cloud.time.tolist() == [SECOND, SECOND]
