"""Streams, schedules, stops and places by themselves."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.ticks import TICKS_PER_SECOND
from clt.sim.drives import CircleDrive
from clt.sim.radio import reported_receptions, schedule_packets
from clt.sim.rng import Purpose, random_stream
from clt.sim.sequence import (
    MAX_KNOT_STEP_S,
    ease_to_rest,
    end_pose,
    stays_inside,
    time_with_room,
)
from clt.sim.settings import Radio
from clt.sim.team import _free_place, _on_one_line, _places, _spots
from clt.sim.trajectory import path_of_twists, refine_knots

GOLDEN = 0.66515602949444
"""The first draw for the odometry of the first moving robot with seed 1."""


def test_every_purpose_has_a_number_of_its_own_that_never_changes():
    """A seed means the same in every version."""
    names = ("START", "WANDER", "ODOMETRY", "RANGE", "OUTLIER", "TRUTH", "LOSS", "DELAY", "CLOCK",
             "STAMP", "HEARD", "ANTENNA", "PHASE", "GAP", "SCALE", "HOST", "BATCH")  # fmt: skip
    assert {name: int(member) for name, member in Purpose.__members__.items()} == {
        name: k + 1 for k, name in enumerate(names)
    }
    assert len({int(purpose) for purpose in Purpose}) == len(Purpose.__members__)


def test_streams_are_those_of_their_seed_purpose_and_key():
    draws = {
        (seed, purpose, key): random_stream(seed, purpose, *key).random()
        for seed in (1, 2)
        for purpose in Purpose
        for key in ((), (0,), (0, 1), (1, 0))
    }
    assert len(set(draws.values())) == len(draws)
    again = random_stream(2, Purpose.RANGE, 0, 1).random()
    assert draws[2, Purpose.RANGE, (0, 1)] == again
    assert random_stream(1, Purpose.ODOMETRY, 0).random() == pytest.approx(GOLDEN, abs=1e-15)


@pytest.mark.parametrize("robots", [1, 2, 5, 17])
@pytest.mark.parametrize("duration", [0.99, 1.0, 1.004, 1.016])
def test_no_packet_is_planned_beyond_the_end_and_no_frame_is_missing(robots, duration):
    radio = Radio(rate=50.0)
    planned = schedule_packets(radio, robots, duration)
    frames, size = planned.shape
    assert size == robots
    last = planned[-1, -1] / TICKS_PER_SECOND
    assert last <= duration + 1e-9
    assert last + 1.0 / 50.0 > duration - 1e-9
    step = np.diff(planned, axis=1) / TICKS_PER_SECOND
    np.testing.assert_allclose(step, 0.001, atol=1e-9)
    np.testing.assert_allclose(planned[:, 0] / TICKS_PER_SECOND, np.arange(1, frames + 1) / 50.0)


def test_a_short_time_holds_no_frame():
    assert schedule_packets(Radio(rate=50.0), 3, 0.021).shape == (0, 3)
    assert schedule_packets(Radio(rate=50.0), 3, 0.023).shape == (1, 3)


def test_packets_report_those_before_them_in_their_frame_else_of_the_frame_before():
    """Three frames of two robots, robot 1 after robot 0; one packet is not heard."""
    stamps = np.arange(12).reshape(3, 2, 2)
    heard = np.ones((3, 2, 2), np.bool_)
    heard[1, 1, 0] = False
    later = np.array([[False, True], [False, False]])
    ticks, sequence = reported_receptions(stamps, heard, later)
    assert ticks[:, 1, 0].tolist() == [2, -1, 10]
    assert sequence[:, 1, 0].tolist() == [0, -1, 2]
    assert ticks[:, 0, 1].tolist() == [-1, 1, 5]
    assert sequence[:, 0, 1].tolist() == [-1, 0, 1]


def straight(seconds=20.0, v=0.5):
    t, speed, omega = refine_knots(np.array([0.0, seconds]), np.full(2, v), np.zeros(2))
    return path_of_twists(t, speed, omega, (0.0, 0.0, 0.0))


def test_a_drive_is_brought_up_from_and_down_to_rest():
    t, v, omega = ease_to_rest(straight(), 2.0, 8.0, 1.0, moving_off=True, braking=True)
    assert (t[0], t[-1]) == (0.0, 6.0)
    np.testing.assert_allclose(v, 0.5 * np.minimum(np.minimum(t, 6.0 - t), 1.0), atol=1e-12)
    assert not omega.any()
    x, y, heading = end_pose((t, v, omega), (1.0, 1.0, np.pi / 2))
    assert (x, y, heading) == pytest.approx((1.0, 1.0 + 0.5 * 5.0, np.pi / 2), abs=1e-6)
    _, coasting, _ = ease_to_rest(straight(), 2.0, 8.0, 1.0, moving_off=False, braking=False)
    np.testing.assert_allclose(coasting, 0.5)


@pytest.mark.parametrize("turn", ["left", "right"])
def test_a_robot_brakes_where_its_circle_will_have_room(turn):
    """It drives along y = 0 between walls; a circle of 1 m needs 1 m ahead of its stop."""
    circle = CircleDrive(kind="circle", radius=1.0, speed=0.5, turn=turn)
    ramp = 0.5
    area = (3.0, -2.5, 99.0, 2.5)
    stop = time_with_room(circle, ramp, straight(), 1.0, area)
    # While it brakes it goes half as fast; moving off, its circle begins at its foremost left.
    x = 0.5 * (stop - ramp) + 0.5 * 0.5 * ramp
    assert x - 1.0 == pytest.approx(3.0, abs=0.5 * 5 * MAX_KNOT_STEP_S + 0.02)


def test_a_path_keeps_its_distance_from_the_walls():
    path = straight(4.0)
    assert stays_inside(path, (0.0, -1.0, 2.0, 1.0))
    assert not stays_inside(path, (0.0, -1.0, 2.0, 1.0), 0.1)
    assert stays_inside(path, (-0.1, -0.1, 2.1, 0.1), 0.1)
    assert not stays_inside(path, (0.1, -1.0, 9.0, 1.0))
    assert not stays_inside(path, (0.0, -1.0, 1.9, 1.0))
    assert not stays_inside(path, (0.0, 0.1, 9.0, 1.0))
    assert not stays_inside(path, (0.0, -1.0, 9.0, -0.1))


@pytest.mark.parametrize("along", [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (-3.0, 4.0)])
def test_points_on_a_line_whichever_way_it_leads(along):
    a = np.array(along)
    across = np.array([-a[1], a[0]]) / np.hypot(*a)
    points = [(2.0, 1.0), tuple(2.0 * a + (2.0, 1.0)), tuple(5.0 * a + (2.0, 1.0))]
    assert _on_one_line(points, 0.1)
    off = 5.0 * a + (2.0, 1.0) + 0.5 * across
    assert not _on_one_line([*points[:2], tuple(off)], 0.1)


@pytest.mark.parametrize("turn", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_made_up_places_leave_a_line_that_leads_any_way(turn):
    """Given places on one line: the made-up one must not lie on it."""
    x, y = turn
    own = [(6.0, 6.0), (6.0 + 2.0 * x, 6.0 + 2.0 * y), (6.0 + 4.0 * x, 6.0 + 4.0 * y), None]
    places = _places(own, (), (0.0, 0.0, 12.0, 12.0))
    assert places[:3] == own[:3]
    off = (places[3][0] - 6.0) * y - (places[3][1] - 6.0) * x
    assert abs(off) > 0.3


def test_spots_begin_with_corners_and_edges_and_never_repeat():
    area = (1.0, 2.0, 5.0, 4.0)
    spots = [spot for _, spot in zip(range(60), _spots(area), strict=False)]
    assert spots[:4] == [(1.0, 2.0), (5.0, 2.0), (5.0, 4.0), (1.0, 4.0)]
    assert spots[4:8] == [(3.0, 2.0), (5.0, 3.0), (3.0, 4.0), (1.0, 3.0)]
    assert len(set(spots[8:])) == 52
    assert all(1.0 <= x <= 5.0 and 2.0 <= y <= 4.0 for x, y in spots)
    assert _free_place([], area) == (1.0, 2.0)
    assert _free_place([(1.05, 2.0)], area) == (5.0, 2.0)
    assert _free_place([(1.2, 2.0)], area) == (1.0, 2.0)


def test_given_places_go_to_those_without_one_of_their_own():
    found = _places([None, (7.0, 7.0), None], ((1.0, 1.0), (2.0, 5.0)), (0.0, 0.0, 9.0, 9.0))
    assert found == [(1.0, 1.0), (7.0, 7.0), (2.0, 5.0)]
