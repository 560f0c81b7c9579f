"""Windows of the start: their segments, likelihoods and standstills; the virtual heading sensor."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clt.core.recording import Recording, Robot, Team
from clt.initialization.motion import team
from clt.initialization.motion.frame import CandidateFrame
from clt.initialization.motion.standstill import (
    MAX_RANGE_CHANGE_SIGMAS,
    RANGE_CHANGE_TOLERANCE_M,
    ranges_change,
    standstill_end,
)
from clt.initialization.motion.straight_segments import BIN_NS, _binned, virtual_headings
from clt.initialization.motion.team import limit_ranges
from clt.initialization.motion.window import (
    MAX_UNGATED_NIS,
    _with_lasting_errors,
    _zero_until,
    bounded_nis,
    build_window,
    log_likelihood,
    range_log_likelihoods,
    window_nis,
    window_with_ranges,
    with_start_copies,
)
from clt.model.dead_reckoning import integrate_twists
from clt.model.noise import MIN_SIGMA_OMEGA, MIN_SIGMA_V
from clt.model.settings import FilterSettings, NoiseSettings
from clt.model.twist_segments import TwistSegments
from tests.initialization.recordings import BEGIN, SECOND, odometry_of, ranges_of

DEFAULTS = FilterSettings()
PLACES = {"S1": np.array([0.0, 0.0]), "S2": np.array([8.0, 0.0])}
TEAM = Team(
    (
        Robot("S1", 1, static=True, position=(0.0, 0.0)),
        Robot("S2", 2, static=True, position=(8.0, 0.0)),
        Robot("R", 3, antenna=(0.1, 0.0)),
        Robot("Q", 4),
    ),
    range_sigma=0.1,
)
FRAME = CandidateFrame(True, PLACES, {}, {}, {}, True, (PLACES["S1"], PLACES["S2"]))


def segments(n=4):
    k = np.arange(1.0, n + 1)
    end = BEGIN + (k * SECOND / 10).astype(np.int64)
    return TwistSegments(np.array([0, n]), end, k, -k, 0.1 * np.ones(n), 0.01 * k, 0.02 * k)


def test_lasting_errors_become_white_noise_of_the_same_sum():
    part = segments()
    found = _with_lasting_errors(part, NoiseSettings(scale=0.1, scale_omega=0.2, bias=0.3), 2.0)
    k = np.arange(1.0, 5.0)
    # 2 s are twenty intervals: a lasting error of s comes to (2 s)^2, white noise to 0.2 var.
    assert found.var_v == pytest.approx(0.01 * k + 20.0 * (0.1 * k) ** 2)
    assert found.var_omega == pytest.approx(0.02 * k + 20.0 * ((0.2 * k) ** 2 + 0.09))
    same = _with_lasting_errors(part, NoiseSettings(), 2.0)
    assert same.var_v == pytest.approx(part.var_v)
    assert same.var_omega == pytest.approx(part.var_omega)


def test_twists_are_zero_until_a_robot_moves():
    part = segments()
    found = _zero_until(part, int(part.end[1]))
    assert found.v.tolist() == [0.0, 0.0, 3.0, 4.0]
    assert found.omega.tolist() == [0.0, 0.0, -3.0, -4.0]
    assert found.var_v == pytest.approx([MIN_SIGMA_V**2] * 2 + [0.03, 0.04], rel=1e-12)
    assert found.var_omega == pytest.approx([MIN_SIGMA_OMEGA**2] * 2 + [0.06, 0.08], rel=1e-12)


def result(residual, variance):
    return SimpleNamespace(residual=np.array(residual), variance=np.array(variance))


def likelihood_window(gate, variance, weight_variance):
    ranges = SimpleNamespace(variance=np.array(variance), weight_variance=np.array(weight_variance))
    return SimpleNamespace(settings=FilterSettings(gate=gate), ranges=ranges)


def test_the_likelihood_of_ranges_by_hand():
    window = likelihood_window(16.0, [0.01, 0.01], [0.01, 0.04])
    found = result([0.2, 1.0], [0.02, 0.05])
    assert bounded_nis(window, found) == pytest.approx([2.0, 16.0])
    expected = [-0.5 * (2.0 + np.log(0.02)), -0.125 * (16.0 + np.log(0.05))]
    assert range_log_likelihoods(window, found) == pytest.approx(expected)
    assert log_likelihood(window, found) == pytest.approx(sum(expected))
    assert window_nis(window, found) == pytest.approx(9.0)
    ungated = likelihood_window(0.0, [0.01, 0.01], [0.01, 0.04])
    assert bounded_nis(ungated, result([0.2, 9.0], [0.02, 0.05]))[1] == MAX_UNGATED_NIS


def recording(rows, twist=None):
    twist = (np.ones(40), np.zeros(40)) if twist is None else twist
    return Recording(TEAM, {"R": odometry_of(*twist), "Q": odometry_of(*twist)}, ranges_of(rows))


def window_of(moving=("R",), floating=(), still=None):
    rows = [(0.5, 0, 2, 3.0), (1.0, 2, 1, 4.0), (1.5, 3, 2, 5.0), (9.0, 0, 2, 3.0)]
    return build_window(
        recording(rows),
        moving,
        floating,
        PLACES,
        still or {},
        (BEGIN, BEGIN + 2 * SECOND),
        DEFAULTS,
    )


def test_a_window_holds_the_ranges_of_its_robots_and_their_odometry():
    one, two = window_of(), window_of(("R", "Q"))
    assert (one.size, two.size) == (3, 6)
    assert one.ranges.range.tolist() == [3.0, 4.0]
    assert two.ranges.range.tolist() == [3.0, 4.0, 5.0]
    assert one.lever.tolist() == [[0.1, 0.0]]
    assert two.segments.first.tolist() == [0, 40, 80]
    still = window_of(still={"R": BEGIN + SECOND})
    assert np.count_nonzero(still.segments.v == 0.0) == 10
    assert np.count_nonzero(one.segments.v == 0.0) == 0
    floating = window_of(("R",), ("S2",))
    assert floating.size == 6
    assert floating.segments.first.tolist() == [0, 40, 40]


def test_some_ranges_of_a_window():
    window = window_of(("R", "Q"))
    found = window_with_ranges(window, np.array([True, False, True]))
    assert found.ranges.range.tolist() == [3.0, 5.0]
    assert found.ranges.anchor.shape == (2, 2)
    assert window_with_ranges(window, slice(1)).ranges.range.tolist() == [3.0]
    assert limit_ranges(window).ranges.range.size == 3


def test_very_large_windows_keep_as_many_ranges_as_can_be_filtered(monkeypatch):
    window = window_of(("R", "Q"))
    for work, kept in ((36 * 3, 3), (36 * 3 - 1, 2), (36 * 2, 2), (1, 1)):
        monkeypatch.setattr(team, "MAX_FILTER_WORK", work)
        assert limit_ranges(window).ranges.range.tolist() == [3.0, 4.0, 5.0][:kept]


def test_copies_of_the_start_do_not_move():
    window = with_start_copies(window_of(("R", "Q"), ("S2",)))
    assert window.floating == ("S2", "R", "Q")
    assert window.size == 15
    assert window.lever.tolist() == [[0.1, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
    assert window.segments.first.tolist() == [0, 40, 80, 80, 80, 80]


def halves(change, after=20):
    """R stands for 4 s at 3 m of S1; after some tenths of a second it is `change` m further."""
    rows = [(0.1 * k, 0, 2, 3.0 + (change if k > after else 0.0)) for k in range(1, 41)]
    return recording([*rows, *((0.1 * k, 3, 2, float(k)) for k in range(1, 41))])


@pytest.mark.parametrize(("beyond", "moves"), [(-1e-6, False), (1e-6, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_ranges_of_a_robot_that_stands_do_not_change(beyond, moves, sign):
    sigma = 0.1 / np.sqrt(20.0) * np.sqrt(2.0)
    limit = MAX_RANGE_CHANGE_SIGMAS * sigma + RANGE_CHANGE_TOLERANCE_M
    log = halves(sign * (limit + beyond))
    assert ranges_change(log, "R", BEGIN, BEGIN + 4 * SECOND, DEFAULTS) == moves


def test_a_standstill_lasts_until_odometry_or_ranges_change():
    rng = np.random.default_rng(1)
    v = np.where(np.arange(60) < 30, 0.0, 0.5) + 0.005 * rng.normal(size=60)
    log = replace(halves(0.0), odometry={"R": odometry_of(v, 0.005 * rng.normal(size=60))})
    found = standstill_end(log, "R", BEGIN, DEFAULTS)
    assert BEGIN + 2 * SECOND <= found <= BEGIN + 3 * SECOND
    creeping = replace(halves(2.0, after=10), odometry=log.odometry)
    assert standstill_end(creeping, "R", BEGIN, DEFAULTS) == BEGIN
    assert standstill_end(log, "R", BEGIN + 4 * SECOND, DEFAULTS) == BEGIN + 4 * SECOND


HEADING = 0.6


def straight_drive(noise=0.0, start=(2.0, 1.0), rate=20):
    """R drives 1 m / s for 3 s; each anchor ranges it `rate` times a second."""
    rng = np.random.default_rng(2)
    rows = []
    for k in range(1, 3 * rate + 1):
        t = k / rate
        c, s = np.cos(HEADING), np.sin(HEADING)
        antenna = np.array(start) + (t + 0.1) * np.array([c, s])
        for a, place in enumerate(PLACES.values()):
            d = np.hypot(*(antenna - place)) + noise * rng.normal()
            rows.append((t, a, 2, d) if k % 2 == 0 else (t, 2, a, d))
    v = 1.0 + 0.002 * rng.normal(size=30)
    return recording(rows, (v, 0.002 * rng.normal(size=30)))


def test_bins_hold_the_means_of_what_both_anchors_measured():
    rows = [(0.01, 0, 2, 3.0), (0.02, 2, 0, 3.2), (0.03, 1, 2, 6.0), (0.06, 0, 2, 4.0)]
    rows += [(0.11, 0, 2, 5.0), (0.14, 2, 1, 7.0), (0.12, 3, 2, 1.0), (0.5, 0, 2, 9.0)]
    stamp, distance, sigma = _binned(
        recording(rows), "R", FRAME, BEGIN, BEGIN + SECOND // 5, DEFAULTS
    )
    assert BIN_NS == SECOND // 20
    np.testing.assert_allclose(distance, [[3.1, 6.0], [5.0, 7.0]])
    np.testing.assert_allclose(sigma, [[0.1 / np.sqrt(2.0), 0.1], [0.1, 0.1]])
    assert ((stamp - BEGIN) / SECOND).tolist() == pytest.approx([0.02, 0.125])
    none = _binned(recording(rows), "R", FRAME, BEGIN + 2 * SECOND, BEGIN + 3 * SECOND, DEFAULTS)
    assert [column.size for column in none] == [0, 0, 0]


def test_a_straight_drive_gives_its_heading_on_both_sides_of_the_anchors():
    log = straight_drive()
    way = integrate_twists(log.odometry["R"], TEAM.robots[2], BEGIN, BEGIN)
    span = (BEGIN, BEGIN + 3 * SECOND)
    left, right = virtual_headings(log, "R", FRAME, span, DEFAULTS, way)
    np.testing.assert_allclose(left, [2.0, 1.0, HEADING], atol=0.02)
    np.testing.assert_allclose(right, [2.0, -1.0, -HEADING], atol=0.03)
    assert virtual_headings(log, "R", FRAME, (BEGIN, BEGIN + SECOND), DEFAULTS, way) == []
