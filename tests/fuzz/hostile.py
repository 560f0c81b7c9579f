"""Small recordings with streams that no honest robot sends, as logs."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from random import Random
from unittest.mock import patch

import numpy as np

from clt.core.errors import CltError
from clt.core.recording import Recording, Team
from clt.log.recording.save import save
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

BASES = (
    ("shi-sim", {"team.moving": 2, "duration": 4.0}),
    ("shi-sim", {"team.moving": 1, "team.static": 3, "duration": 4.0, "team.known": False}),
    ("shi-sim", {"team.static": 0, "duration": 3.0}),
    ("freeman", {"duration": 4.0}),
    ("araki-semicircles", {"duration": 4.0}),
    ("shi-sim", {"radio.rate": 20.0, "duration": 3.0}),
)
NUMBERS = (
    float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 3.4e38, 1e9, 1e-300, 0.0, -0.0, -1.0,
)  # fmt: skip
SECOND = 10**9
JUMPS = (1, SECOND, -SECOND, 3600 * SECOND, 86400 * SECOND, 365 * 86400 * SECOND, 2**61)


@cache
def base(number: int) -> Recording:
    """One of the honest recordings."""
    name, overrides = BASES[number]
    return simulate(load_scenario(name, overrides))


def hostile(rng: Random, honest: Recording | None = None) -> bytes:
    """A log of an honest recording after one to three changes."""
    recording = base(rng.randrange(len(BASES))) if honest is None else honest
    while True:
        changed = recording
        for _ in range(rng.randint(1, 3)):
            changed = rng.choice(CHANGES)(changed, rng)
        file = io.BytesIO()
        try:
            # The check would refuse to write most of it.
            with patch("clt.log.recording.channels._check_finite"), np.errstate(all="ignore"):
                save(file, changed, dict(changed.run) or {"command": "clt"})
        except (CltError, ValueError, OverflowError, IndexError):
            continue  # no log can hold that
        return file.getvalue()


def streams(recording: Recording) -> list[tuple[str, str | None]]:
    """Attribute, and robot where it has one, of everything that holds columns."""
    found: list[tuple[str, str | None]] = [
        (kind, name)
        for kind in ("odometry", "truth", "estimate", "dead_reckoning")
        for name in getattr(recording, kind)
    ]
    for kind in ("ranges", "frames", "innovations"):
        one = getattr(recording, kind)
        if one is not None and len(one.stamp) > 0:
            found.append((kind, None))
    return found


def edit(
    recording: Recording, rng: Random, change: Callable[[dict[str, np.ndarray]], None]
) -> Recording:
    """Change copies of the columns of one stream."""
    kind, name = rng.choice(streams(recording) or [("ranges", None)])
    table = getattr(recording, kind)
    stream = table if name is None else table[name]
    columns = {
        field.name: getattr(stream, field.name).copy()
        for field in fields(stream)
        if isinstance(getattr(stream, field.name), np.ndarray)
    }
    if len(columns["stamp"]) > 0:
        change(columns)
    new = replace(stream, **columns)
    return replace(recording, **{kind: new if name is None else {**table, name: new}})


def values(recording: Recording, rng: Random) -> Recording:
    """Numbers that are none, or no sensor's."""

    def change(columns: dict[str, np.ndarray]) -> None:
        names = [name for name, column in columns.items() if column.dtype.kind == "f"]
        if len(names) > 0:
            column = columns[rng.choice(names)]
            rows = rng.choice([slice(None), slice(0, 1), slice(-1, None), slice(None, None, 7)])
            column[rows] = rng.choice(NUMBERS)

    return edit(recording, rng, change)


def times(recording: Recording, rng: Random) -> Recording:
    """Stamps that stand still, run back, jump."""
    kind = rng.choice(["equal", "reverse", "jump", "first", "last", "log_time", "swap"])
    jump = rng.choice(JUMPS)

    def change(columns: dict[str, np.ndarray]) -> None:
        stamp = columns["stamp"]
        where = rng.randrange(len(stamp))
        if kind == "equal":
            stamp[:] = stamp[0]
        elif kind == "reverse":
            stamp[:] = stamp[::-1].copy()
        elif kind == "jump":
            stamp[where:] += jump
        elif kind == "first":
            stamp[:1] = abs(jump)
        elif kind == "last":
            stamp[-1:] += jump
        elif kind == "swap":
            stamp[[0, where]] = stamp[[where, 0]]
        elif "log_time" in columns:
            columns["log_time"][where:] += jump

    return edit(recording, rng, change)


def shorter(recording: Recording, rng: Random) -> Recording:
    """Streams of few messages or of none."""
    count = rng.choice([0, 1, 1, 2, 3])

    def change(columns: dict[str, np.ndarray]) -> None:
        for name in columns:
            columns[name] = columns[name][:count]

    return edit(recording, rng, change)


def missing(recording: Recording, rng: Random) -> Recording:
    """A kind of stream that nobody has, or one robot has not."""
    kind = rng.choice(["odometry", "truth", "estimate", "dead_reckoning", "ranges"])
    if kind == "ranges":
        none = {
            field.name: getattr(recording.ranges, field.name)[:0]
            for field in fields(recording.ranges)
        }
        return replace(recording, ranges=replace(recording.ranges, **none))
    table = dict(getattr(recording, kind))
    for name in list(table)[: rng.choice([1, len(table)])]:
        del table[name]
    return replace(recording, **{kind: table})


def teams(recording: Recording, rng: Random) -> Recording:
    """Other roles, places, noise."""
    robots = list(recording.team.robots)
    if len(robots) == 0:
        return recording
    k = rng.randrange(len(robots))
    place = (rng.choice([0.0, 1.0, 1e9, -1e300]), rng.choice([0.0, 2.0, 1e300]))
    sigma = rng.choice([0.0, 1e-300, 1e-9, 1e6, 1e300])
    robots[k] = rng.choice(
        [
            replace(robots[k], static=not robots[k].static, position=None),
            replace(robots[k], position=place if robots[k].static else None),
            replace(robots[k], position=None),
            replace(robots[k], antenna=place),
            replace(robots[k], sigma_v=sigma),
            replace(robots[k], sigma_omega=sigma),
            replace(robots[k], id=rng.choice([0, 65535, robots[0].id])),
        ]
    )
    team = replace(recording.team, robots=tuple(robots))
    if rng.random() < 0.3:
        team = replace(team, range_sigma=sigma, range_correlation=rng.choice([0.0, 1.0, 1e300]))
    if rng.random() < 0.05:
        team = Team(())
        return Recording(team)
    return replace(recording, team=team)


CHANGES = (values, values, values, times, times, shorter, missing, teams)
