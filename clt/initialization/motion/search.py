"""One robot by itself: every pose that its ranges to placed robots leave possible.

The bank runs over the robot's first seconds, longer as long as several modes remain. A straight
drive in them adds the virtual heading sensor's answer to the bank; it is a help, not a need.
Placed are the static robots and, for one that hears fewer than two of them, its company: robots
whose own poses are found already.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats
from clt.core.diagnostics import Diagnostic
from clt.core.geometry import rotation_matrix
from clt.core.recording import Recording
from clt.initialization.motion.frame import CandidateFrame
from clt.initialization.motion.heading import position_fixes
from clt.initialization.motion.heading_hypotheses import (
    RefinedStart,
    probabilities,
    refine_start,
    start_hypotheses,
    weigh_hypotheses,
)
from clt.initialization.motion.straight_segments import virtual_headings
from clt.initialization.motion.window import build_window
from clt.initialization.pair_distances import mean_distances
from clt.model.dead_reckoning import ReckonedPath, integrate_twists
from clt.model.settings import FilterSettings

FIRST_WINDOW_S = 8.0
"""Seconds after the standstill that the bank sees at first; doubled while it is undecided."""
INSTANT_NS, MAX_INSTANT_NS = 300_000_000, 5_000_000_000
"""Ranges of a robot that moves at once are taken together over this long, ns."""
DECIDED_PROBABILITY, MIN_MODE_PROBABILITY = 1.0 - 1e-6, 1e-9
"""Probability that ends the search, and below which a mode is dropped."""
DECIDED_HEADING_SIGMA = 0.1
"""Standard deviation of the heading that ends the search, rad."""
BLUNT_HEADING_SIGMA = 0.3
"""Standard deviation of the heading beyond which it counts as unknown, rad."""

PlacedRobots = Mapping[str, Floats]
"""Poses (3,) at the start of moving robots that are found already, by name."""


@dataclass(frozen=True)
class Candidate:
    """A pose that is possible in one of the frames."""

    frame: int
    pose: RefinedStart
    probability: float
    """By the robot's own ranges to placed robots."""


@dataclass(frozen=True)
class PoseSearch:
    """What one robot's own ranges say. Without candidates it is unobservable, and `why` says so."""

    candidates: tuple[Candidate, ...]
    end: int
    """Stamp up to which the log was used, ns."""
    why: Diagnostic | None = None
    lonely: bool = False
    """It hears too few placed robots: found company may help."""


@dataclass(frozen=True)
class _SearchTask:
    """What a search is about."""

    recording: Recording
    name: str
    frames: tuple[CandidateFrame, ...]
    company: Sequence[PlacedRobots]
    """One for each frame."""
    begin: int
    still: Mapping[str, int]
    settings: FilterSettings
    way: ReckonedPath


def search_poses(
    recording: Recording,
    name: str,
    frames: tuple[CandidateFrame, ...],
    begin: int,
    still: Mapping[str, int],
    settings: FilterSettings,
    company: Sequence[PlacedRobots] = (),
) -> PoseSearch:
    """Find the possible poses of a moving robot at `begin` (ns); `still`: until when it stands.

    `company`, one for each frame, helps to place it; without any, static robots do alone.
    """
    team = recording.team
    robot, odometry = team.robots[team.index(name)], recording.odometry[name]
    last = int(odometry.stamp[-1])
    if still[name] >= last:
        return PoseSearch((), last, Diagnostic("never_moves"))
    way = integrate_twists(odometry, robot, begin, still[name])
    company = company if len(company) > 0 else [{} for _ in frames]
    task = _SearchTask(recording, name, frames, company, begin, still, settings, way)
    places = [possible_start_points(task, i) for i in range(len(frames))]
    if all(len(found) == 0 for found, _ in places):
        return PoseSearch((), last, Diagnostic("too_few_placed_robots"), lonely=True)
    length, end = FIRST_WINDOW_S, begin
    candidates: list[Candidate] = []
    while end < last:
        end = min(last, still[name] + round(length * 1e9))
        candidates = _window_candidates(task, places, end)
        if len(candidates) > 0 and _decided(candidates):
            break
        length *= 2.0
    if len(candidates) == 0:
        return PoseSearch((), end, Diagnostic("no_pose_fits"))
    blunt = float(np.sqrt(candidates[0].pose.end_covariance[2, 2]))
    if blunt > BLUNT_HEADING_SIGMA or len(candidates) > 6:
        moved = {"moved_m": distance_travelled(way, end)}
        return PoseSearch((), end, Diagnostic("moved_too_little", values=moved))
    return PoseSearch(tuple(candidates), end)


def distance_travelled(way: ReckonedPath, until: int) -> float:
    """How far a robot has driven up to a time (ns), m."""
    return float(np.interp(0.0, (way.stamp - until) * 1e-9, way.travelled))


def possible_start_points(task: _SearchTask, i: int) -> tuple[list[Floats], float]:
    """Places (2,) of the robot's antenna at the beginning in frame i, and how well known, m.

    None where it hears fewer than two placed robots soon.
    """
    team, frame = task.recording.team, task.frames[i]
    anchors = {**frame.anchors, **_antennas(task, i)}
    me, index = team.index(task.name), {team.index(n): k for k, n in enumerate(anchors)}
    points, stood = np.array(list(anchors.values())), task.name in frame.standing
    length = MAX_INSTANT_NS if stood else INSTANT_NS
    while length <= MAX_INSTANT_NS:
        end = max(task.still[task.name], task.begin + length)
        pairs = mean_distances(task.recording, [me, *index], task.begin, end, task.settings.noise)
        mine = (pairs.a == me) | (pairs.b == me)
        other = [index[k] for k in np.where(pairs.a == me, pairs.b, pairs.a)[mine].tolist()]
        if len(other) >= 2 and stood:
            places = list(frame.standing[task.name])
            images = [frame.reflect(place) for place in places] if frame.on_a_line else []
            return places + images, 0.1
        if len(other) >= 2:
            names = [list(anchors)[k] for k in other]
            moved = distance_travelled(task.way, end) + np.array(
                [_distance_driven(task, n, end) for n in names]
            )
            sigma = np.hypot(pairs.sigma[mine], 0.5 * moved)
            found = position_fixes(points[other], pairs.distance[mine], sigma)
            spread = max(float(np.sqrt(np.linalg.eigvalsh(f.covariance)[-1])) for f in found)
            return [fix.position for fix in found], float(np.clip(3.0 * spread, 0.1, 1.0))
        length *= 2
    return [], 0.0


def _antennas(task: _SearchTask, i: int) -> dict[str, Floats]:
    """Where the antennas of the company in frame i are at the beginning, (2,), m."""
    team = task.recording.team
    return {
        name: pose[:2] + rotation_matrix(float(pose[2])) @ team.robots[team.index(name)].antenna
        for name, pose in task.company[i].items()
    }


def _distance_driven(task: _SearchTask, name: str, until: int) -> float:
    """How far a placed robot has driven up to a time (ns), m."""
    recording, team = task.recording, task.recording.team
    robot = team.robots[team.index(name)]
    if robot.static:
        return 0.0
    way = integrate_twists(recording.odometry[name], robot, task.begin, task.still[name])
    return distance_travelled(way, until)


def _window_candidates(
    task: _SearchTask, places: Sequence[tuple[list[Floats], float]], end: int
) -> list[Candidate]:
    """The modes of the window up to `end` (ns) in all frames, the most probable first."""
    recording, name, span = task.recording, task.name, (task.begin, end)
    lever = np.array(recording.team.robots[recording.team.index(name)].antenna)
    found: list[tuple[int, RefinedStart]] = []
    for i, frame in enumerate(task.frames):
        company = list(task.company[i].values())
        names = [name, *task.company[i]]
        window = build_window(recording, names, [], frame.anchors, task.still, span, task.settings)
        if window.ranges.row.size == 0 or len(places[i][0]) == 0:
            continue
        sensed = virtual_headings(recording, name, frame, span, task.settings, task.way)
        modes = weigh_hypotheses(
            window, start_hypotheses(places[i][0], lever, sensed), places[i][1], company
        )
        shares = probabilities([mode.log_likelihood for mode in modes], modes[0].nis)
        kept = [m for m, share in zip(modes, shares, strict=True) if share > MIN_MODE_PROBABILITY][
            :24
        ]
        found += [
            (i, refine_start(window, np.concatenate([m.start, *company]), []).first) for m in kept
        ]
    found = _distinct([(i, r) for i, r in found if np.isfinite(r.mean).all()])
    if len(found) == 0:
        return []
    weights = [pose.log_likelihood + task.frames[i].log_weight for i, pose in found]
    shares = probabilities(weights, found[0][1].nis)
    candidates = [
        Candidate(i, pose, float(share)) for (i, pose), share in zip(found, shares, strict=True)
    ]
    candidates.sort(key=lambda candidate: -candidate.probability)
    return [c for c in candidates if c.probability > MIN_MODE_PROBABILITY]


def _distinct(found: list[tuple[int, RefinedStart]]) -> list[tuple[int, RefinedStart]]:
    """Poses that refinement did not bring together, the most probable first."""
    kept: list[tuple[int, RefinedStart]] = []
    for frame, pose in sorted(found, key=lambda item: -item[1].log_likelihood):
        if all(frame != other or not same_pose(pose, seen) for other, seen in kept):
            kept.append((frame, pose))
    return kept


def same_pose(a: RefinedStart, b: RefinedStart) -> bool:
    """Two refined poses differ by less than their uncertainty, or hardly."""
    d = a.mean - b.mean
    turn = abs(float(np.angle(np.exp(1j * d[2]))))
    sigma = np.sqrt(np.maximum(a.covariance.diagonal(), b.covariance.diagonal()))
    place = float(np.hypot(d[0], d[1]))
    return (
        place < 3.0 * float(np.hypot(*sigma[:2])) + 0.02
        and turn < 3.0 * min(float(sigma[2]), 0.1) + 0.02
    )


def _decided(candidates: list[Candidate]) -> bool:
    """One mode is left, and its heading is sharp."""
    best = candidates[0]
    return (
        best.probability > DECIDED_PROBABILITY
        and best.pose.end_covariance[2, 2] < DECIDED_HEADING_SIGMA**2
    )
