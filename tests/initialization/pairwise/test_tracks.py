import numpy as np

from clt.initialization.pairwise.tracks import (
    MAX_LINEAR_HEADING_SIGMA,
    LastingErrors,
    lasting_errors,
    linear_until,
    odometry_track,
)
from clt.model.settings import NoiseSettings
from clt.model.twist_segments import TwistSegments

SECOND = 1_000_000_000


def segments(rng, n=40):
    end = SECOND + (np.arange(1, n + 1) * SECOND) // 10
    return TwistSegments(
        np.array([0, n]),
        end,
        rng.uniform(0.2, 1.0, n),
        rng.uniform(-1.0, 1.0, n),
        np.full(n, 0.1),
        np.full(n, 0.02**2),
        np.full(n, 0.03**2),
    )


def walk(v, omega, lever, steps):
    """The antenna after every step of 0.1 s, on exact arcs."""
    x, heading, found = np.zeros(2), 0.0, []
    for k in range(steps):
        half = 0.05 * omega[k]
        chord = 0.1 * v[k] * np.sinc(half / np.pi)
        x = x + chord * np.array([np.cos(heading + half), np.sin(heading + half)])
        heading += 2.0 * half
        c, s = np.cos(heading), np.sin(heading)
        found.append(x + np.array([c * lever[0] - s * lever[1], s * lever[0] + c * lever[1]]))
    return np.array(found)


def test_positions_are_those_of_exact_arcs_with_the_antenna():
    parts, lever = segments(np.random.default_rng(1)), np.array([0.3, -0.2])
    track = odometry_track(parts, SECOND, parts.end, lever, np.arange(40))
    np.testing.assert_allclose(track.position, walk(parts.v, parts.omega, lever, 40), atol=1e-12)


def test_a_segment_cut_by_a_range_goes_on_as_if_it_were_not():
    parts = segments(np.random.default_rng(2))
    between = parts.end[:-1] + SECOND // 30
    stamp = np.sort(np.concatenate([parts.end, between]))
    rows = np.searchsorted(stamp, parts.end)
    cut = odometry_track(parts, SECOND, stamp, np.zeros(2), rows)
    whole = odometry_track(parts, SECOND, parts.end, np.zeros(2), np.arange(40))
    np.testing.assert_allclose(cut.position[rows], whole.position, atol=1e-12)
    np.testing.assert_allclose(cut.covariance, whole.covariance, rtol=0.02, atol=5e-8)


def test_covariance_between_all_times_is_that_of_drawn_errors():
    rng = np.random.default_rng(3)
    parts, lever = segments(rng), np.array([0.3, -0.2])
    rows = np.array([4, 19, 39])
    track = odometry_track(parts, SECOND, parts.end, lever, rows)
    drawn = np.array(
        [
            walk(
                parts.v + 0.02 * rng.standard_normal(40),
                parts.omega + 0.03 * rng.standard_normal(40),
                lever,
                40,
            )[rows]
            for _ in range(4000)
        ]
    )
    error = drawn - track.position[rows]
    sample = np.einsum("rki,rlj->klij", error, error) / len(error)
    sigma = np.sqrt(np.einsum("kkii->ki", track.covariance))
    scale = sigma[:, None, :, None] * sigma[None, :, None, :]
    np.testing.assert_allclose(sample / scale, track.covariance / scale, atol=0.08)


def test_a_track_lasts_until_odometry_has_lost_the_heading():
    parts = segments(np.random.default_rng(4))
    assert linear_until(parts, SECOND) == np.iinfo(np.int64).max
    for steps in (1, 7, 39):
        # Each step of 0.1 s adds (0.1 s * sigma)^2; so many just reach MAX_LINEAR_HEADING_SIGMA.
        poor = parts._replace(
            var_omega=np.full(40, MAX_LINEAR_HEADING_SIGMA**2 / (steps + 0.5) / 0.01)
        )
        assert linear_until(poor, SECOND) == parts.end[steps - 1]
    lost = parts._replace(var_omega=np.full(40, 2.0 * MAX_LINEAR_HEADING_SIGMA**2 / 0.01))
    assert linear_until(lost, SECOND) == SECOND


def test_errors_of_scale_and_bias_enter_the_covariance_as_they_move_the_track():
    rng = np.random.default_rng(5)
    parts, lever = segments(rng), np.array([0.3, -0.2])
    wrong = LastingErrors(0.05, 0.03, 0.02)
    plain = odometry_track(parts, SECOND, parts.end, lever, np.arange(40))
    track = odometry_track(parts, SECOND, parts.end, lever, np.arange(40), wrong)
    np.testing.assert_allclose(track.position, plain.position)
    h, expected = 1e-5, 0.0
    for v, omega in (
        (parts.v * (1.0 + h * wrong.scale_v), parts.omega),
        (parts.v, parts.omega * (1.0 + h * wrong.scale_omega)),
        (parts.v, parts.omega + h * wrong.bias_omega),
    ):
        moved = (walk(v, omega, lever, 40) - walk(parts.v, parts.omega, lever, 40)) / h
        expected = expected + moved[:, None, :, None] * moved[None, :, None, :]
    np.testing.assert_allclose(track.covariance - plain.covariance, expected, atol=1e-5)


def test_the_settings_say_what_is_wrong_throughout():
    assert lasting_errors(NoiseSettings(scale=0.05, bias=0.02)) == LastingErrors(0.05, 0.05, 0.02)
    assert lasting_errors(NoiseSettings()) == LastingErrors()


def test_a_bias_ends_a_track_when_it_has_turned_the_heading_so_far():
    parts = segments(np.random.default_rng(6))._replace(var_omega=np.zeros(40))
    bias = MAX_LINEAR_HEADING_SIGMA / 2.05
    assert linear_until(parts, SECOND, LastingErrors(bias_omega=bias)) == parts.end[19]
    still = parts._replace(v=np.zeros(40), omega=np.zeros(40))
    assert linear_until(still, SECOND, LastingErrors(bias_omega=bias)) == np.iinfo(np.int64).max
