"""What is compared with what: clean trajectories, brought into a body frame where need be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.geometry import is_heading_unknown, relative_pose
from clt.core.recording import Poses, Team
from clt.metrics.associate import as_array, interpolate

BODY_SUFFIX = "/base_link"


def is_body_frame(frame: str) -> bool:
    """Whether a frame is the body of some robot, of the team or not."""
    return f"/{frame}".endswith(BODY_SUFFIX)


def ego_of_frame(frame: str, names: tuple[str, ...]) -> str | None:
    """The robot in whose body frame an estimate stands; None for a fixed frame."""
    name = frame.lstrip("/").removesuffix(BODY_SUFFIX)
    return name if is_body_frame(frame) and name in names else None


def select_poses(poses: Poses, keep: NDArray[np.bool_]) -> Poses:
    """The poses of a trajectory where `keep` (n,) holds."""
    return replace(
        poses,
        stamp=poses.stamp[keep],
        log_time=poses.log_time[keep],
        x=poses.x[keep],
        y=poses.y[keep],
        heading=poses.heading[keep],
        covariance=None if poses.covariance is None else poses.covariance[keep],
    )


def clean_tracks(
    tracks: Mapping[str, Poses], what: str, headless: bool = False
) -> tuple[dict[str, Poses], list[Diagnostic]]:
    """Leave out poses with a NaN or infinite number, counted.

    A track without any heading keeps its positions; so does, with `headless`, every pose whose
    heading alone is missing. A covariance that is not finite throughout is dropped.
    """
    kept: dict[str, Poses] = {}
    found: list[Diagnostic] = []
    for name, poses in tracks.items():
        good = np.isfinite(poses.x) & np.isfinite(poses.y)
        if not headless and not np.all(np.isnan(poses.heading)):
            good &= np.isfinite(poses.heading)
        bad = int(np.sum(~good))
        if bad > 0:
            counts = {"stream": what, "count": bad, "total": len(good)}
            found.append(Diagnostic("poses_not_finite", name, "partial", counts))
        track = drop_unknown_heading(select_poses(poses, good))
        if track.covariance is not None and not np.all(np.isfinite(track.covariance)):
            found.append(Diagnostic("covariance_not_finite", name, values={"stream": what}))
            track = replace(track, covariance=None)
        if len(track.stamp) > 0:
            kept[name] = track
    return kept, found


def drop_unknown_heading(track: Poses) -> Poses:
    """A track; without heading where it says itself that nothing is known of that."""
    P = track.covariance
    if P is None or len(P) == 0 or not np.all(is_heading_unknown(P[:, 2, 2])):
        return track
    return replace(track, heading=np.full(len(P), np.nan))


def relative_poses(ego: Poses, other: Poses, frame: str, max_gap: float) -> Poses:
    """inv(X_i) X_j at the stamps of the sparser track, with the other interpolated (`max_gap`, s).

    Poses of the ego without heading are no body frame and left out.
    """
    ego = select_poses(ego, np.isfinite(ego.heading))
    base, dense = (ego, other) if len(ego.stamp) < len(other.stamp) else (other, ego)
    found, between, _ = interpolate(dense, base.stamp, max_gap)
    at = as_array(base)[found]
    X_i, X_j = (at, between) if base is ego else (between, at)
    x, y, heading = relative_pose(X_i, X_j).T
    return Poses(frame, base.stamp[found], base.log_time[found], x, y, heading)


def tracks_in_frames(
    tracks: Mapping[str, Poses], targets: Mapping[str, Poses], names: tuple[str, ...], gap: float
) -> dict[str, Poses]:
    """The tracks of the robots in `targets`, each brought into its target's body frame.

    Targets in a fixed frame, and tracks that stand in the target's frame already, are passed on.
    A robot whose own or whose ego's track is missing, or stands in another body, is left out.
    """
    found: dict[str, Poses] = {}
    for name, target in targets.items():
        ego = ego_of_frame(target.frame, names)
        track = tracks.get(name)
        if track is None:
            continue
        if ego is None or track.frame.lstrip("/") == target.frame.lstrip("/"):
            found[name] = track
        elif (
            ego in tracks
            and not is_body_frame(track.frame)
            and not is_body_frame(tracks[ego].frame)
        ):
            moved = relative_poses(tracks[ego], track, target.frame, gap)
            if len(moved.stamp) > 0:
                found[name] = moved
    return found


def frames_text(tracks: Mapping[str, Poses]) -> str:
    """The frame id that tracks share, or all of them with commas."""
    return ", ".join(dict.fromkeys(track.frame.lstrip("/") for track in tracks.values()))


def check_frames(team: Team, truth: Mapping[str, Poses], estimates: Mapping[str, Poses]) -> bool:
    """Whether the estimates are relative. Raises CltError where they cannot be scored together."""
    egos = {ego_of_frame(track.frame, team.names) for track in estimates.values()}
    fixed = {track.frame.lstrip("/") for track in estimates.values()}
    strange = sorted(
        frame for frame in fixed if is_body_frame(frame) and not ego_of_frame(frame, team.names)
    )
    if len(strange) > 0:
        raise CltError(f"no robot of the team has the body `{strange[0]}` that estimates stand in")
    if egos == {None}:
        if len(fixed) > 1:
            raise CltError(f"estimates stand in several frames ({frames_text(estimates)})")
        return False
    if None in egos:
        raise CltError(
            f"estimates stand in fixed and in body frames ({frames_text(estimates)}); "
            "localize again with one --frame"
        )
    for ego in sorted(ego for ego in egos if ego is not None):
        if ego not in truth or not np.any(np.isfinite(truth[ego].heading)):
            raise CltError(
                f"estimates relative to {ego} need its true poses with heading, "
                f"and /{ego}/ground_truth has none"
            )
    return True
