"""The trajectories of a recording as files of one each, and numbers as text."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Poses, Recording
from clt.exporters.export import Export, ExportFile

POSE_STREAMS = ("estimate", "dead_reckoning", "ground_truth")
"""As the files name them; in a recording the last is `truth`."""


def trajectory_files(recording: Recording, suffix: str, encode: Callable[[Poses], bytes]) -> Export:
    """A file `ROBOT.STREAM{suffix}` for each trajectory. Raises CltError where there is none."""
    files: list[ExportFile] = []
    frames: dict[str, str] = {}
    diagnostics: list[Diagnostic] = []
    for robot, stream, poses in _trajectories(recording):
        good = np.isfinite(poses.x) & np.isfinite(poses.y)
        bad = int(np.count_nonzero(~good))
        if bad > 0:
            values = {"stream": stream.replace("_", " "), "count": bad, "total": len(good)}
            diagnostics.append(Diagnostic("poses_not_finite", robot, "partial", values))
        if not good.any():
            continue
        kept = poses if bad == 0 else _rows(poses, np.flatnonzero(good))
        name = f"{robot}.{stream}{suffix}"
        files.append(ExportFile(name, len(kept.stamp), partial(encode, kept)))
        frames[name] = poses.frame.lstrip("/")
    if len(files) == 0:
        raise CltError(
            "no trajectory to export: neither estimates nor ground truth; "
            "make estimates with `clt localize`"
        )
    return Export(tuple(files), frames, tuple(diagnostics))


def _trajectories(recording: Recording) -> Iterator[tuple[str, str, Poses]]:
    tracks = (recording.estimate, recording.dead_reckoning, recording.truth)
    for robot in recording.team.robots:
        for stream, held in zip(POSE_STREAMS, tracks, strict=True):
            if robot.name in held:
                yield robot.name, stream, held[robot.name]


def _rows(poses: Poses, rows: Stamps) -> Poses:
    return replace(
        poses,
        stamp=poses.stamp[rows],
        log_time=poses.log_time[rows],
        x=poses.x[rows],
        y=poses.y[rows],
        heading=poses.heading[rows],
        covariance=None if poses.covariance is None else poses.covariance[rows],
    )


def seconds_text(stamp: Stamps) -> list[str]:
    """Stamps (ns) as seconds with all nine digits, which a float has no room for."""
    second, rest = np.divmod(stamp, NS_PER_SECOND)
    return [f"{a}.{b:09d}" for a, b in zip(second.tolist(), rest.tolist(), strict=True)]


def numbers_text(values: Floats, unknown: str = "") -> list[str]:
    """The shortest texts that give the same numbers back; `unknown` for what is not finite."""
    texts = list(map(repr, values.tolist()))
    for row in np.flatnonzero(~np.isfinite(values)).tolist():
        texts[row] = unknown
    return texts
