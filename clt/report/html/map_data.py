"""Numbers of the map: whole paths, and who stood where at each step of the time slider."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import Innovations, Ranges, Recording
from clt.report.figures.paths import MAX_LINE_GAP
from clt.report.figures.thin import break_at_gaps, decimation_slice
from clt.report.html.encode import Document, encode_bytes, encode_floats
from clt.report.html.scene import Scene, SceneTrack

MAX_PATH_POINTS = 1500
"""Of one path; of many robots fewer."""
MAX_POINTS_OF_KIND = {"estimate": 9_000, "truth": 6_000, "dead reckoning": 4_000}
"""Of all paths of one kind together."""
MAX_STEPS = 3600
"""Positions of the slider."""
MIN_STEP_NS = 50_000_000
MAX_AGE_NS = 1_000_000_000
"""A pose that is older than this and than two steps is not shown, ns."""
NO_RANGE, USED, REJECTED, MEASURED = range(4)
"""What the slider shows of a pair: nothing, its latest range by the verdict of the filter, or a
range of a log that is not localized yet."""


def map_document(recording: Recording, scene: Scene, begin: int, end: int) -> Document:
    """Paths, robots that stand, and the steps of the slider; `begin` and `end` in ns."""
    times = step_times(begin, end)
    pairs, status = pair_status(recording, times)
    names = recording.team.names
    return {
        "title": scene.title,
        "estimated": scene.estimated,
        "paths": {
            kind: _paths(tracks, MAX_POINTS_OF_KIND[kind])
            for kind, tracks in (
                ("estimate", scene.tracks),
                ("truth", scene.truth),
                ("dead reckoning", scene.reckoned),
            )
        },
        "static": {
            name: {"x": x, "y": y, "known": known} for name, (x, y, known) in scene.static.items()
        },
        "ego": scene.ego,
        "time": encode_floats((times - begin) * 1e-9),
        "step": float(times[1] - times[0]) * 1e-9 if len(times) > 1 else 1.0,
        "robots": {name: _at_steps(track, times) for name, track in scene.tracks.items()},
        "truth": {name: _at_steps(track, times) for name, track in scene.truth.items()},
        "pairs": [[names[i], names[j]] for i, j in pairs],
        "status": encode_bytes(status),
    }


def step_times(begin: int, end: int) -> Stamps:
    """Stamps of the slider's positions, the last one at the end."""
    count = int(np.clip((end - begin) // MIN_STEP_NS + 1, 2, MAX_STEPS))
    # From 0: a float has no room for the nanoseconds of a date.
    return begin + np.rint(np.linspace(0, max(end - begin, 1), count)).astype(np.int64)


def _paths(tracks: Mapping[str, SceneTrack], budget: int) -> Document:
    most = max(50, min(MAX_PATH_POINTS, budget // max(len(tracks), 1)))
    found: Document = {}
    for name, track in tracks.items():
        rows = decimation_slice(len(track.stamp), most)
        stamp, points = track.stamp[rows], track.pose[rows, :2]
        if len(stamp) == 0:
            continue
        gap = max(MAX_LINE_GAP, 3.0 * float(np.ptp(stamp)) / 1e9 / len(stamp))
        points = break_at_gaps(stamp, points, gap)
        found[name] = {"x": encode_floats(points[:, 0]), "y": encode_floats(points[:, 1])}
    return found


def latest_rows(stamp: Stamps, times: Stamps) -> Indices:
    """Row of the latest sample at each time, -1 where there is none or it is too old."""
    rows = np.searchsorted(stamp, times, side="right") - 1
    step = int(times[1] - times[0]) if len(times) > 1 else 0
    age = times - stamp[np.maximum(rows, 0)]
    return np.where((rows >= 0) & (age <= max(MAX_AGE_NS, 2 * step)), rows, -1)


def _at_steps(track: SceneTrack, times: Stamps) -> Document:
    """Pose and covariance of the latest sample at each step; NaN where none is near."""
    if len(track.stamp) == 0:
        rows = np.full(len(times), -1)
        pose = np.full((1, 3), np.nan)
    else:
        rows, pose = latest_rows(track.stamp, times), track.pose
    shown = np.where(rows[:, None] >= 0, pose[np.maximum(rows, 0)], np.nan)
    found = {
        "x": encode_floats(shown[:, 0]),
        "y": encode_floats(shown[:, 1]),
        "heading": encode_floats(shown[:, 2]),
    }
    if track.covariance is None:
        return found
    P = track.covariance[np.maximum(rows, 0)]
    P = np.where(rows[:, None, None] >= 0, P, np.nan)
    return found | {
        "xx": encode_floats(P[:, 0, 0]),
        "xy": encode_floats(P[:, 0, 1]),
        "yy": encode_floats(P[:, 1, 1]),
    }


def pair_status(recording: Recording, times: Stamps) -> tuple[list[tuple[int, int]], Floats]:
    """Pairs that measured ranges, and what to show of each at each step, shape (steps, pairs)."""
    table: Ranges | Innovations = recording.ranges
    if recording.innovations is not None:
        table = recording.innovations
    count = len(recording.team.robots)
    low, high = np.minimum(table.source, table.target), np.maximum(table.source, table.target)
    keys, pair = np.unique(low * count + high, return_inverse=True)
    status = np.full((len(times), len(keys)), NO_RANGE, np.float64)
    for column in range(len(keys)):
        own = np.flatnonzero(pair == column)
        rows = latest_rows(table.stamp[own], times)
        verdict = np.full(len(own), MEASURED)
        if isinstance(table, Innovations):
            verdict = np.where(table.accepted[own], USED, REJECTED)
        status[:, column] = np.where(rows >= 0, verdict[np.maximum(rows, 0)], NO_RANGE)
    return [divmod(int(key), count) for key in keys], status
