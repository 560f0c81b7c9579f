"""Simulated UWB networks and what is true of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate


def network(duration=20.0, **keys):
    """A recording of raw packets of shi-sim's team; keys use `__` for dots."""
    overrides = {"radio.rate": 100.0, "duration": duration, "sensors.truth.rate": 1000.0}
    overrides |= {key.replace("__", "."): value for key, value in keys.items()}
    return simulate(load_scenario("shi-sim", overrides))


def true_distance(recording, ranges):
    """Distance between both ends at the stamp of each range, m."""
    spots = np.empty((2, 2, ranges.stamp.size))
    for index, name in enumerate(recording.team.names):
        truth = recording.truth[name]
        t, at = truth.stamp - truth.stamp[0], ranges.stamp - truth.stamp[0]
        for end, column in enumerate((ranges.source, ranges.target)):
            own = column == index
            spots[end, 0, own] = np.interp(at[own], t, truth.x)
            spots[end, 1, own] = np.interp(at[own], t, truth.y)
    return np.hypot(*(spots[0] - spots[1]))


def errors(recording, ranges):
    """Measured minus true distance, m."""
    return ranges.range - true_distance(recording, ranges)


def settled(recording, ranges, seconds=1.0):
    """Rows after the first seconds."""
    return ranges.stamp > recording.frames.stamp[0] + int(seconds * 1e9)


def jumped(recording, robot, after, seconds):
    """The same network where one robot's counter jumps ahead once `after` s have passed."""
    frames = recording.frames
    late = frames.stamp > frames.stamp[0] + int(after * 1e9)
    own = late & (frames.source == robot)
    step = int(seconds * TICKS_PER_SECOND)
    moved = own[:, None] & (frames.receive >= 0)
    return replace(
        recording,
        frames=replace(
            frames,
            transmit=np.where(
                own, (frames.transmit + step) % COUNTER_PERIOD_TICKS, frames.transmit
            ),
            receive=np.where(moved, (frames.receive + step) % COUNTER_PERIOD_TICKS, frames.receive),
        ),
    )


def late(recording, robot, first, last, seconds):
    """The same network where what one robot receives from first to last (s) comes too late."""
    frames = recording.frames
    t = (frames.stamp - frames.stamp[0]) * 1e-9
    own = (frames.source == robot) & (t > first) & (t < last)
    moved = own[:, None] & (frames.receive >= 0)
    receive = np.where(
        moved,
        (frames.receive + int(seconds * TICKS_PER_SECOND)) % COUNTER_PERIOD_TICKS,
        frames.receive,
    )
    return replace(recording, frames=replace(frames, receive=receive))
