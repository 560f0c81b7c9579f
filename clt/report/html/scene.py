"""What the map draws, in one frame: estimates, truth, dead reckoning, robots that stand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.recording import Poses, Recording
from clt.metrics.align import Transform
from clt.metrics.evaluation import Evaluation
from clt.metrics.tracks import ego_of_frame
from clt.report.figures.sight import trajectory_map


@dataclass(frozen=True)
class SceneTrack:
    """A trajectory, shape (n,)."""

    stamp: Stamps
    pose: Floats
    """(n, 3), m and rad; the heading is NaN where it is not known."""
    covariance: Floats | None = None
    """Of the position, shape (n, 2, 2)."""


@dataclass(frozen=True)
class Scene:
    """Trajectories by robot, in one frame."""

    title: str
    tracks: Mapping[str, SceneTrack]
    """Estimates; without any, the odometry alone."""
    truth: Mapping[str, SceneTrack]
    reckoned: Mapping[str, SceneTrack]
    static: Mapping[str, tuple[float, float, bool]]
    """x, y, and whether that is known rather than estimated."""
    ego: str | None
    estimated: bool


def build_scene(recording: Recording, evaluation: Evaluation | None) -> Scene:
    """The scene; aligned as the evaluation is, where there is one."""
    if evaluation is None:
        return _plain_scene(recording)
    return (
        _relative_scene(recording, evaluation)
        if evaluation.relative
        else _world(recording, evaluation)
    )


def _world(recording: Recording, evaluation: Evaluation) -> Scene:
    moving = {robot.name for robot in recording.team.moving}
    shared = None
    if evaluation.align != "se2-per-robot":
        shared = next(iter(evaluation.estimate.transforms.values()), None)
    sides = []
    for tracks, transforms in (
        (recording.estimate, evaluation.estimate.transforms),
        (recording.dead_reckoning, evaluation.dead_reckoning.transforms),
    ):
        found = {}
        for name, poses in tracks.items():
            transform = transforms.get(name, shared)
            if name in moving and transform is not None:
                found[name] = _track(poses, transform)
        sides.append(found)
    truth = {name: _track(poses) for name, poses in recording.truth.items() if name in moving}
    static = {}
    for robot in recording.team.static:
        true, transform = recording.truth.get(robot.name), shared
        estimate = recording.estimate.get(robot.name)
        if true is not None and np.isfinite(true.x).any():
            static[robot.name] = (float(np.nanmedian(true.x)), float(np.nanmedian(true.y)), True)
        elif robot.position is not None and evaluation.align == "none":
            static[robot.name] = (*robot.position, True)
        elif estimate is not None and transform is not None and np.isfinite(estimate.x[-1]):
            x, y = transform.points(np.array([[estimate.x[-1], estimate.y[-1]]]))[0]
            static[robot.name] = (float(x), float(y), False)
    title = f"Trajectories in {evaluation.truth_frame}"
    return Scene(title, sides[0], truth, sides[1], static, None, estimated=True)


def _relative_scene(recording: Recording, evaluation: Evaluation) -> Scene:
    """Of mutual transforms the first: two bodies are no one frame."""
    frame = next(iter(evaluation.frames.values()))
    names = [name for name, one in evaluation.frames.items() if one == frame]
    ego = ego_of_frame(frame, recording.team.names)
    tracks = {n: _track(recording.estimate[n]) for n in names if n in recording.estimate}
    truth, reckoned = {}, {}
    for name in names:
        matched = evaluation.estimate.tracks.get(name)
        if matched is not None:
            truth[name] = SceneTrack(matched.stamp, matched.truth)
        baseline = evaluation.dead_reckoning.tracks.get(name)
        if baseline is not None:
            reckoned[name] = SceneTrack(baseline.stamp, baseline.estimate)
    return Scene(f"Trajectories in {frame}", tracks, truth, reckoned, {}, ego, estimated=True)


def _plain_scene(recording: Recording) -> Scene:
    """As the figures draw it; headings where the estimates have them."""
    sight = trajectory_map(recording)
    moving = {robot.name for robot in recording.team.moving}
    tracks = {}
    for name, (stamp, points, covariance) in sight.tracks.items():
        poses = recording.estimate.get(name)
        if poses is not None:
            tracks[name] = _track(poses)
        else:
            tracks[name] = _headless(stamp, points, covariance)
    keep = tracks if sight.ego is not None else moving
    return Scene(
        sight.title,
        {name: track for name, track in tracks.items() if name in keep},
        {name: _headless(*track) for name, track in sight.truth.items()},
        {name: _headless(*track) for name, track in sight.reckoned.items()},
        sight.static,
        sight.ego,
        estimated=len(recording.estimate) > 0,
    )


def _headless(stamp: Stamps, points: Floats, covariance: Floats | None = None) -> SceneTrack:
    pose = np.column_stack([points, np.full(len(points), np.nan)])
    return SceneTrack(stamp, pose, covariance)


def _track(poses: Poses, transform: Transform | None = None) -> SceneTrack:
    """The poses with finite positions, and their covariances where these are finite."""
    transform = Transform() if transform is None else transform
    good = np.isfinite(poses.x) & np.isfinite(poses.y)
    pose = np.column_stack([poses.x, poses.y, poses.heading])[good]
    covariance = None
    if poses.covariance is not None and np.isfinite(poses.covariance).all():
        covariance = transform.covariances(poses.covariance[good])[:, :2, :2]
    return SceneTrack(poses.stamp[good], transform.poses(pose), covariance)
