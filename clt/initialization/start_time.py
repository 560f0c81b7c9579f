"""At which instant the team starts, and who comes too late for it.

All poses of a start hold at one instant, so one robot that joins late must not keep the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.core.start import odometry_start

MAX_WAIT_NS = 10_000_000_000
"""A robot whose odometry begins this long after most others' is not waited for, ns."""
MIN_REPORTED_WAIT_NS = 1_000_000_000
"""A wait that is worth a word, ns."""


@dataclass(frozen=True)
class StartTime:
    """The instant of the start."""

    stamp: int
    """ns."""
    names: tuple[str, ...]
    """Moving robots that take part."""
    absent: Mapping[str, Diagnostic]
    """Those that do not, and why."""
    notes: tuple[Diagnostic, ...]


def choose_start_time(recording: Recording, moving: Sequence[str]) -> StartTime:
    """When most of the `moving` robots have odometry and two static ones are heard.

    A robot that comes a little later is waited for; one that comes much later, or whose odometry
    has ended by then, is left out. Raises CltError where none remains.
    """
    begins = {name: odometry_start(recording, name) for name in moving}
    first = sorted(begins.values())[(len(begins) - 1) // 2]
    heard = second_static_time(recording)
    notes: list[Diagnostic] = []
    if heard > first + MAX_WAIT_NS:
        wait = {"wait_s": (heard - first) * 1e-9}
        notes.append(Diagnostic("start_waits_for_static", values=wait))
        first = heard
    absent = {
        name: Diagnostic("joins_late", values={"late_s": (begin - first) * 1e-9})
        for name, begin in begins.items()
        if begin > first + MAX_WAIT_NS
    }
    stamp = max(first, *(begin for name, begin in begins.items() if name not in absent))
    absent |= {
        name: Diagnostic("ends_before_start")
        for name in moving
        if name not in absent and int(recording.odometry[name].stamp[-1]) <= stamp
    }
    names = tuple(name for name in moving if name not in absent)
    if len(names) == 0:
        name = next(name for name, why in absent.items() if why.kind == "ends_before_start")
        raise CltError(
            f"no moving robot can be initialized: {name}: its odometry ends before the others "
            "start: left out of the start"
        )
    if stamp - first > MIN_REPORTED_WAIT_NS:
        last = max(names, key=lambda name: begins[name])
        wait = {"wait_s": (stamp - first) * 1e-9}
        notes.append(Diagnostic("start_waits_for_odometry", last, values=wait))
    return StartTime(stamp, names, absent, tuple(notes))


def second_static_time(recording: Recording) -> int:
    """Just before the first range of the second static robot that has any, ns; 0 without two."""
    team, ranges = recording.team, recording.ranges
    first = []
    for robot in team.static:
        own = (ranges.source == team.index(robot.name)) | (ranges.target == team.index(robot.name))
        if own.any():
            first.append(int(ranges.stamp[np.argmax(own)]))
    return sorted(first)[1] - 1 if len(first) > 1 else 0
