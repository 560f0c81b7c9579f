"""Which transform brings a team's estimates into the truth's frame, and whether they are mirrored.

Joint alignments are one transform for the whole team. `se2` is fitted to all matched positions of
all estimated robots, moving and static; `anchor_positions` to one point per static robot, its mean
estimate or else its known position; `transform_of_pose` to one pose. Relative estimates are never
aligned.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError, UsageError
from clt.core.recording import Poses, Team
from clt.metrics.align import (
    AlignMethod,
    Transform,
    fit_transform,
    fits_better_mirrored,
    nearer_when_flipped,
    transform_of_pose,
)
from clt.metrics.associate import MatchedPoses

MIN_MIRROR_POSES = 10
"""With fewer matched poses, chance alone may favour the mirror image."""


@dataclass(frozen=True)
class AlignmentInput:
    """What an alignment can see."""

    team: Team
    frame: str
    """Of the estimates."""
    relative: bool
    """They stand in the bodies of robots."""
    truth: Mapping[str, Poses]
    matched: Mapping[str, MatchedPoses]
    """Estimates, not aligned."""


def known_anchors(scene: AlignmentInput) -> dict[str, tuple[Floats, Floats]]:
    """Static robots with truth that are not estimated: known and true position (2,) of each."""
    if scene.relative or scene.frame != scene.team.frame:
        return {}
    return {
        robot.name: (np.array(robot.position), _centre(scene.truth[robot.name]))
        for robot in scene.team.static
        if robot.position is not None and robot.name in scene.truth
        if robot.name not in scene.matched
    }


def anchor_positions(scene: AlignmentInput) -> tuple[Floats, Floats]:
    """Estimated (or known) and true positions of the static robots, shape (k, 2) each."""
    found = known_anchors(scene)
    for robot in scene.team.static:
        if robot.name in scene.matched:
            m = scene.matched[robot.name]
            found[robot.name] = (m.estimate[:, :2].mean(axis=0), m.truth[:, :2].mean(axis=0))
    source = np.array([pair[0] for pair in found.values()]).reshape(-1, 2)
    target = np.array([pair[1] for pair in found.values()]).reshape(-1, 2)
    return source, target


def choose_alignment(
    scene: AlignmentInput, truth_frame: str, wanted: AlignMethod | None
) -> AlignMethod:
    """The alignment to use.

    By default `none` when the frames are one, else `anchor_positions` with two static robots that
    have truth, else `se2`. Raises UsageError for an alignment of relative estimates.
    """
    if scene.relative:
        if wanted not in {None, "none"}:
            raise UsageError(
                f"--align {wanted}: relative estimates are scored without alignment; leave it out"
            )
        return "none"
    if wanted is not None:
        return wanted
    if scene.frame == truth_frame:
        return "none"
    return "anchors" if len(anchor_positions(scene)[0]) >= 2 else "se2"


def register(
    scene: AlignmentInput, tracks: Mapping[str, MatchedPoses], align: AlignMethod
) -> dict[str, Transform]:
    """The transform of every robot in `tracks`. Raises CltError where none can be found."""
    if align == "se2-per-robot":
        return _each(tracks)
    if align == "none":
        shared = Transform()
    elif align == "first":
        shared = _first(scene.team, tracks)
    elif align == "anchors":
        shared = _by_anchors(scene)
    else:
        shared = fit_transform(*_positions(tracks))
    return dict.fromkeys(tracks, shared)


def _each(tracks: Mapping[str, MatchedPoses]) -> dict[str, Transform]:
    """Each robot fitted by itself; one that stands still takes the joint fit."""
    transforms: dict[str, Transform] = {}
    for name, m in tracks.items():
        try:
            transforms[name] = fit_transform(m.estimate[:, :2], m.truth[:, :2])
        except CltError:
            transforms[name] = fit_transform(*_positions(tracks))
    return transforms


def _first(team: Team, tracks: Mapping[str, MatchedPoses]) -> Transform:
    """By the first matched pose with heading of the first robot, moving ones before static."""
    for robot in (*team.moving, *team.static):
        if robot.name in tracks:
            m = tracks[robot.name]
            known = np.flatnonzero(np.isfinite(m.error[:, 2]))
            if len(known) > 0:
                return transform_of_pose(m.estimate[known[0]], m.truth[known[0]])
    raise CltError("--align first needs a matched pose with heading; use --align se2")


def _by_anchors(scene: AlignmentInput) -> Transform:
    source, target = anchor_positions(scene)
    if len(source) < 2:
        raise CltError(
            f"--align anchors needs two static robots with truth and position, found {len(source)};"
            " use --align se2"
        )
    return fit_transform(source, target)


def _positions(tracks: Mapping[str, MatchedPoses]) -> tuple[Floats, Floats]:
    """All estimated and true positions, shape (n, 2) each."""
    source = np.concatenate([m.estimate[:, :2] for m in tracks.values()])
    target = np.concatenate([m.truth[:, :2] for m in tracks.values()])
    return source, target


def find_mirrored(scene: AlignmentInput) -> Diagnostic | None:
    """Name what fits clearly better mirrored: the whole team, else single robots.

    Static robots of known position take part with the weight of a whole track: they unmask a
    robot that was mirrored on the line through them even if it drove along a straight line.
    Relative estimates are mirrored on the x axis of the ego's body, as they stand.
    """
    moving = {name: m for name, m in scene.matched.items() if len(m.stamp) >= MIN_MIRROR_POSES}
    if len(moving) == 0:
        return None
    if _is_mirrored(scene, moving):
        names = []
    else:
        names = [name for name, m in moving.items() if _is_mirrored(scene, {name: m})]
        if len(names) == 0:
            return None
    return Diagnostic("mirrored", ", ".join(names), "partial", {"robots": len(names)})


def _is_mirrored(scene: AlignmentInput, tracks: Mapping[str, MatchedPoses]) -> bool:
    source, target = _positions(tracks)
    if scene.relative:
        return nearer_when_flipped(source, target)
    fixed = list(known_anchors(scene).values())
    weight = np.ones(len(source) + len(fixed))
    weight[len(source) :] = len(source) / len(tracks)
    source = np.concatenate([source, *(known[None] for known, _ in fixed)])
    target = np.concatenate([target, *(true[None] for _, true in fixed)])
    return fits_better_mirrored(source, target, weight)


def _centre(poses: Poses) -> Floats:
    return np.array([np.mean(poses.x), np.mean(poses.y)])
