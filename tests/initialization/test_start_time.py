"""Robots that join late, moving or static."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.initialization.motion.motion import from_motion
from clt.initialization.start_time import choose_start_time
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.messages import note_texts, reason

DEFAULTS = FilterSettings()
SECOND = 1_000_000_000


def simulated(scenario, **keys):
    made = load_scenario(scenario, {"duration": 60.0, **keys})
    return replace(simulate(made), truth={})


def joining(recording, name, seconds):
    """The recording as if a robot had been switched on only after so many seconds."""
    me, ranges = recording.team.index(name), recording.ranges
    begin = int(recording.ranges.stamp[0]) + round(seconds * SECOND)
    keep = ((ranges.source != me) & (ranges.target != me)) | (ranges.stamp >= begin)
    ranges = type(ranges)(**{key: column[keep] for key, column in vars(ranges).items()})
    odometry = dict(recording.odometry)
    if name in odometry:
        late = odometry[name].stamp >= begin
        odometry[name] = type(odometry[name])(
            **{key: column[late] for key, column in vars(odometry[name]).items()}
        )
    return replace(recording, ranges=ranges, odometry=odometry)


def after(recording, stamp):
    """Seconds after the first range."""
    return (stamp - int(recording.ranges.stamp[0])) * 1e-9


def test_a_robot_that_joins_much_later_does_not_keep_the_others():
    recording = simulated("shi-five")
    calm, found = (from_motion(r, DEFAULTS) for r in (recording, joining(recording, "R5", 30.0)))
    assert found.stamp == calm.stamp
    for name in ("R3", "R4"):
        assert found.robots[name].status == "ok"
        np.testing.assert_allclose(
            found.robots[name].pose.mean, calm.robots[name].pose.mean, atol=0.1
        )
    assert found.robots["R5"].status == "unobservable"
    assert reason(found.robots["R5"]).startswith("it joins 30.0 s after the others")
    assert "--init FILE" in reason(found.robots["R5"])


def test_a_robot_that_joins_a_little_later_is_waited_for_and_that_is_said():
    recording = simulated("shi-sim")
    found = from_motion(joining(recording, "R4", 4.0), DEFAULTS)
    assert found.stamp == pytest.approx(
        int(recording.odometry["R3"].stamp[0]) + 4 * SECOND, abs=1e8
    )
    assert note_texts(found)[0].endswith("until the odometry of R4 begins")
    assert note_texts(found)[0].startswith("the start waits 4.0 s")
    assert all(found.robots[name].status == "ok" for name in ("R3", "R4", "R5"))


def test_most_robots_decide_who_is_late():
    recording = simulated("shi-sim")
    for name in ("R4", "R5"):
        recording = joining(recording, name, 20.0)
    when = choose_start_time(recording, ["R3", "R4", "R5"])
    assert when.names == ("R3", "R4", "R5")
    assert after(recording, when.stamp) == pytest.approx(20.0, abs=0.1)


def test_odometry_that_ends_before_the_others_begin():
    recording = simulated("shi-sim")
    for name in ("R4", "R5"):
        recording = joining(recording, name, 20.0)
    odometry = recording.odometry["R3"]
    early = after(recording, odometry.stamp) < 10.0
    odometry = type(odometry)(**{key: column[early] for key, column in vars(odometry).items()})
    recording = replace(recording, odometry={**recording.odometry, "R3": odometry})
    found = from_motion(recording, DEFAULTS)
    assert reason(found.robots["R3"]).startswith("its odometry ends before")
    assert found.robots["R4"].status == found.robots["R5"].status == "ok"


def test_a_third_static_robot_that_joins_late_is_placed_all_the_same():
    positions = [[0.0, 0.0], [4.0, 0.0], [1.0, 4.0]]
    recording = simulated("shi-five", **{"team.static": 3, "team.positions": positions})
    found = from_motion(joining(recording, "R3", 35.0), DEFAULTS)
    assert all(robot.status == "ok" for robot in found.robots.values())
    assert found.robots["R3"].pose.mean[:2] == pytest.approx(positions[2], abs=0.1)
    assert [n for n in note_texts(found) if n.startswith("it took 40 s of ranges")] == list(
        note_texts(found)
    )


@pytest.mark.parametrize("known", [True, False])
def test_the_start_waits_for_a_second_static_robot(known):
    recording = simulated("shi-sim", **{"team.known": known})
    late = joining(recording, "R2", 25.0)
    found = from_motion(late, DEFAULTS)
    assert after(recording, found.stamp) == pytest.approx(25.0, abs=0.2)
    assert note_texts(found)[0].startswith("the start waits 2")
    assert "fewer than two static robots are heard" in note_texts(found)[0]
    assert all(robot.status == "ok" for robot in found.robots.values())


def test_odometry_that_is_over_at_once_is_one_line():
    """Found by the fuzzer of commands: a single sample of every robot."""
    recording = simulated("shi-sim", duration=2.0)
    one = {
        name: type(stream)(**{key: column[:1] for key, column in vars(stream).items()})
        for name, stream in recording.odometry.items()
    }
    with pytest.raises(CltError, match="no moving robot can be initialized: R3: its odometry ends"):
        choose_start_time(replace(recording, odometry=one), list(one))
