from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.recording import Ranges, Recording
from clt.ranging.recover import RANGE_RESOLUTION_M, range_packets
from clt.ranging.smooth import smooth_ranges, smoothed_variances
from tests.ranging.networks import errors, network, settled


def test_every_pair_once_per_frame_in_order():
    recording = network(5.0)
    ranges = range_packets(recording).recording.ranges
    assert np.all(np.diff(ranges.stamp) >= 0)
    assert np.all(ranges.source < ranges.target)
    for a in range(5):
        for b in range(a + 1, 5):
            own = (ranges.source == a) & (ranges.target == b)
            assert np.count_nonzero(own) >= 490
            assert np.all(np.diff(ranges.sequence[own]) == 4 - a)
    assert np.unique(np.stack([ranges.source, ranges.sequence]), axis=1).shape[1] == own.size
    assert np.all(ranges.log_time >= ranges.stamp)
    assert np.all(ranges.range == np.rint(ranges.range / RANGE_RESOLUTION_M) * RANGE_RESOLUTION_M)
    np.testing.assert_array_equal(ranges.raw, ranges.range)


@pytest.mark.parametrize(("rate", "method"), [(100.0, "clock"), (1.0, "double-sided")])
def test_the_method_suits_the_rate_and_is_said(rate, method):
    found = range_packets(network(60.0, radio__rate=rate))
    assert found.method == method
    assert found.rate == pytest.approx(rate, rel=1e-6)
    assert "clock filters promise" in found.why


def test_odometry_comes_back_on_the_common_clock():
    recording = network(30.0, radio__loss=0.05, network__loss=0.1, seed=3)
    plain = network(30.0, radio__odometry="topic", seed=3)
    found = range_packets(recording).recording
    assert list(found.odometry) == ["R3", "R4", "R5"]
    for name, stream in found.odometry.items():
        own = plain.odometry[name]
        place = np.searchsorted(own.stamp, stream.stamp - 25_000_000)
        assert stream.stamp.size >= own.stamp.size - 5
        assert np.abs(stream.stamp - own.stamp[place]).max() < 2_000
        np.testing.assert_array_equal(stream.v, own.v[place])
        np.testing.assert_array_equal(stream.omega, own.omega[place])
    assert found.frames.stamp.size == 0


def test_jitter_of_the_listener_averages_out():
    recording = network(60.0)
    frames = recording.frames
    jitter = np.random.default_rng(1).exponential(2e6, frames.stamp.size).astype(np.int64)
    order = np.argsort(frames.stamp + jitter, kind="stable")
    shaken = replace(
        frames,
        **{
            name: (frames.stamp + jitter if name == "stamp" else getattr(frames, name))[order]
            for name in frames.__dataclass_fields__
        },
    )
    plain = range_packets(recording).recording.odometry["R3"]
    found = range_packets(replace(recording, frames=shaken)).recording.odometry["R3"]
    lag = found.stamp - plain.stamp[: found.stamp.size]
    assert np.mean(lag) == pytest.approx(2e6, abs=2e5)
    assert np.std(lag) < 2e5


def test_odometry_on_topics_stays():
    recording = network(3.0, radio__odometry="topic")
    assert np.all(recording.frames.odometry_stamp == -1)
    assert range_packets(recording).recording.odometry["R4"] is recording.odometry["R4"]


def test_known_noise_is_believed():
    recording = network(5.0)
    assert range_packets(recording, sigma=3e-10).clocks["R1", "R2"].stamp_sigma == pytest.approx(
        3e-10, rel=1e-3
    )
    measured = range_packets(recording).clocks["R1", "R2"].stamp_sigma
    assert measured == pytest.approx(150e-12, rel=0.05)


def test_same_packets_same_ranges():
    first, second = (range_packets(network(2.0)).recording.ranges for _ in range(2))
    for name in Ranges.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def test_smoothing_keeps_sigma_true_and_says_how_errors_last():
    recording = network(30.0, trajectory={"kind": "stand"})
    plain, found = range_packets(recording, "clock"), range_packets(recording, "clock", 10)
    ranges = found.recording.ranges
    keep = settled(recording, ranges)
    error = errors(recording, ranges)[keep]
    assert np.std(error) < 0.85 * np.std(errors(recording, plain.recording.ranges)[keep])
    # Errors that are correlated in another way than AR(1) leave some doubt.
    assert np.sqrt(np.mean((error / ranges.sigma[keep]) ** 2)) == pytest.approx(1.0, abs=0.2)
    assert found.correlation_time > plain.correlation_time


def test_weights_of_smoothing():
    stamp = np.arange(4) * 10_000_000
    one = np.ones(4)
    ranges = Ranges(
        stamp, stamp, one.astype(int) * 0, one.astype(int), np.array([1.0, 2.0, 4.0, 8.0]),
        one, one, np.arange(4),
    )  # fmt: skip
    means, tau = smooth_ranges(ranges, 2, 3, 0.0)
    expected = [1.0, (2 * 2 + 1) / 3, (3 * 4 + 2 * 2 + 1) / 6, (3 * 8 + 2 * 4 + 2) / 6]
    np.testing.assert_allclose(means.range, expected)
    spread = [1.0, 5 / 9, 14 / 36, 14 / 36]
    np.testing.assert_allclose(means.sigma, np.sqrt(spread))
    rho = np.exp(-0.01 / tau)
    assert spread[-1] * (1 + rho) / (1 - rho) == pytest.approx(1.0)


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.99])
def test_the_variance_of_smoothed_errors(rho):
    found = smoothed_variances(60, rho)
    for n in (1, 2, 5, 60):
        falling = np.arange(n, 0, -1) / (n * (n + 1) / 2)
        lag = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
        assert found[n - 1] == pytest.approx(falling @ rho ** lag.astype(float) @ falling)


def test_smoothing_is_found_by_the_pair_with_the_most_ranges():
    recording = network(4.0, trajectory={"kind": "stand"})
    plain = range_packets(recording, "clock")
    ranges, tau = plain.recording.ranges, plain.correlation_time
    last = (ranges.source == ranges.source.max()) & (ranges.target == ranges.target.max())
    keep = ~last | (np.cumsum(last) <= 3)
    fewer = Ranges(**{name: column[keep] for name, column in vars(ranges).items()})
    assert smooth_ranges(fewer, 5, 20, tau)[1] == pytest.approx(
        smooth_ranges(ranges, 5, 20, tau)[1], rel=0.01
    )


def test_nothing_to_range():
    recording = network(2.0)
    alone = network(2.0, team__moving=1, team__static=0)
    for method in ("auto", "clock", "double-sided"):
        with pytest.raises(CltError, match=r"^UWB packets of R1 alone: nobody to range with$"):
            range_packets(alone, method)
    with pytest.raises(CltError, match="no UWB packets found"):
        range_packets(Recording(recording.team))
    deaf = replace(recording.frames, heard=np.full_like(recording.frames.heard, -1))
    with pytest.raises(CltError, match="give no range"):
        range_packets(replace(recording, frames=deaf))
