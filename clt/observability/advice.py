"""What is not observable in a recording, and the remedies."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Ranges, Recording
from clt.observability.exact.analysis import Analysis, analyse
from clt.observability.exact.codistribution import Motion
from clt.observability.exact.setup import Setup, SetupRobot
from clt.observability.windows.reference import has_motion, robots_of_known_position, usable_ranges
from clt.observability.windows.track import odometry_from_poses, odometry_of

MIN_SPEED_RMS, MIN_TURN_RATE_RMS = 0.02, 0.01
"""Below these root mean squares a robot neither drives nor turns, m/s and rad/s."""
MIN_MOTION_SIGMAS = 4.0
"""How many standard errors a motion must rise above the noise."""
MAX_IDLE_STATICS = 2
"""Static robots that nobody ranges: so many stand for all that a remedy may use."""


def advise(
    recording: Recording, placed: Collection[str] = (), frame: str = "world"
) -> tuple[Diagnostic, ...]:
    """Warnings about what a filter in `frame` (`world`, `ego:A`, `mutual:A,B`) cannot observe.

    `placed` names the robots that have initial poses: static ones among them count as known. Mirror
    images are no matter here: the initial poses choose the side.
    """
    found = analyse_once(setup_of(recording, placed, frame, idle=MAX_IDLE_STATICS))
    if found.observable:
        return ()
    values = {
        "directions": [direction.name for direction in found.unobservable],
        "remedies": [remedy.text for remedy in found.remedies],
    }
    return (Diagnostic("unobservable", values=values),)


@lru_cache(maxsize=64)
def analyse_once(setup: Setup) -> Analysis:
    """The analysis of a setup, which the many recordings of a study share."""
    return analyse(setup)


def setup_of(
    recording: Recording,
    placed: Collection[str] = (),
    frame: str = "world",
    idle: int | None = None,
) -> Setup:
    """The setup that a recording holds: who ranged whom, who moved and turned at all.

    Without any static robot of known position the world is what the first two of them span. A
    robot whose motion is not known is left out. `idle`: so many static robots that no
    range touches take part, of known position only; None: all. Raises CltError where
    that is the one in whose frame poses are asked for.
    """
    kind, _, names = frame.partition(":")
    chosen = names.split(",") if kind == "mutual" else list(recording.team.names)
    surveyed = robots_of_known_position(recording)
    nodes: list[SetupRobot] = []
    place: dict[int, int] = {}
    apart = set() if idle is None else set(recording.idle).difference(names.split(","))
    spare = 0 if idle is None else idle
    for k, robot in enumerate(recording.team.robots):
        if robot.name not in chosen or not (robot.static or has_motion(recording, robot)):
            continue
        known = robot.static and (robot.name in surveyed or robot.name in placed)
        if robot.name in apart:
            if kind != "world" or not known or spare == 0:
                continue
            spare -= 1
        place[k] = len(nodes)
        motion = Motion.FREE if robot.static else motion_of(recording, robot.name)
        nodes.append(SetupRobot(robot.name, robot.static, known and kind == "world", motion))
    met = ranged_pairs(usable_ranges(recording), len(recording.team.robots))
    pairs = tuple((place[int(a)], place[int(b)]) for a, b in met if a in place and b in place)
    ego = None
    if kind != "world":
        first = names.split(",")[0]
        ego = next((k for k, node in enumerate(nodes) if node.name == first), None)
        if ego is None:
            raise CltError(f"neither odometry nor an estimate of {first}: no poses in its frame")
    framed = kind == "world" and not any(node.known for node in nodes)
    framed = framed and sum(node.static for node in nodes) >= 2
    return Setup(tuple(nodes), pairs, ego=ego, framed=framed)


def ranged_pairs(ranges: Ranges, robots: int) -> Indices:
    """Who ranged whom, shape (pairs, 2): indices of robots, the smaller one first."""
    met = np.zeros((robots, robots), np.bool_)
    met[ranges.source, ranges.target] = True
    return np.argwhere(np.triu(met | met.T))


def motion_of(recording: Recording, name: str) -> Motion:
    """Whether a robot drove and turned at all, by its odometry, else by its estimate."""
    odometry = odometry_of(recording, name) or odometry_from_poses(recording.estimate[name])
    v, omega = odometry.v, odometry.omega
    if exceeds_noise(omega, MIN_TURN_RATE_RMS):
        return Motion.FREE if exceeds_noise(v, MIN_SPEED_RMS) else Motion.REST
    if not exceeds_noise(v, MIN_SPEED_RMS):
        return Motion.REST
    return Motion.STRAIGHT if exceeds_noise(v - np.mean(v), MIN_SPEED_RMS) else Motion.STEADY


def exceeds_noise(signal: Floats, least: float) -> bool:
    """Whether a slow signal under white noise has a root mean square above `least`.

    The noise is estimated from the differences of neighbours.
    """
    if signal.size < 2:
        return bool(np.any(np.abs(signal) > least))
    noise = float(np.mean(np.diff(signal) ** 2)) / 2.0
    error = noise * np.sqrt(3.0 / signal.size)
    return bool(np.mean(signal**2) - noise > least**2 + MIN_MOTION_SIGMAS * error)
