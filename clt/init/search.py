"""One robot by itself: every pose that its ranges to static robots leave possible.

The bank runs over the robot's first seconds, longer as long as several modes remain. A straight
drive in them adds the virtual heading sensor's answer to the bank; it is a help, not a need.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from clt.filters.inputs import correlated_variance, correlation_time
from clt.filters.settings import FilterSettings
from clt.geometry import rotation
from clt.init.bank import Refined, hypotheses, judge, probabilities, refine
from clt.init.frame import Frame
from clt.init.heading import bearing, fixes, track, widest
from clt.init.pairs import mean_distances, range_sigma
from clt.init.phases import measured_noise, phases, straight
from clt.init.reckoning import Reckoning, reckon
from clt.init.window import cut
from clt.streams import Floats, Recording, Stamps

FIRST_WINDOW = 8.0
"""Seconds after the standstill that the bank sees at first; doubled while it is undecided."""
INSTANT, LONGEST_INSTANT = 300_000_000, 5_000_000_000
"""Ranges of a robot that moves at once are taken together over this long, ns."""
SURE, POSSIBLE = 1.0 - 1e-6, 1e-9
"""Probability that ends the search, and below which a mode is dropped."""
SHARP = 0.1
"""Standard deviation of the heading that ends the search, rad."""
BLUNT = 0.3
"""Standard deviation of the heading beyond which it counts as unknown, rad."""
BIN = 50_000_000
"""Ranges within this time are one position for the heading sensor, ns."""
SHORTEST_DRIVE, SHORTEST_WAY = 1.0, 0.3
"""A straight drive that the heading sensor uses, s and m."""


@dataclass(frozen=True)
class Candidate:
    """A pose that is possible in one of the frames."""

    frame: int
    pose: Refined
    probability: float
    """By the robot's own ranges to static robots."""


@dataclass(frozen=True)
class Search:
    """What one robot's own ranges say. Without candidates it is unobservable, and `why` says so."""

    candidates: tuple[Candidate, ...]
    end: int
    """Stamp up to which the log was used, ns."""
    why: str = ""


def search(
    recording: Recording,
    name: str,
    frames: tuple[Frame, ...],
    begin: int,
    still: Mapping[str, int],
    settings: FilterSettings,
) -> Search:
    """Find the possible poses of a moving robot at `begin` (ns); `still`: until when it stands."""
    team = recording.team
    robot, odometry = team.robots[team.index(name)], recording.odometry[name]
    last = int(odometry.stamp[-1])
    way = reckon(odometry, robot, begin, still[name])
    if still[name] >= last:
        return Search((), last, f"{name} never moves: its heading cannot be told")
    places = {i: starts(recording, name, frame, begin, still[name], settings, way)
              for i, frame in enumerate(frames)}  # fmt: skip
    if all(len(found) == 0 for found, _ in places.values()):
        return Search((), last, f"{name} has no ranges to two static robots")
    length, end = FIRST_WINDOW, begin
    candidates: list[Candidate] = []
    while end < last:
        end = min(last, still[name] + round(length * 1e9))
        candidates = _judged(recording, name, frames, places, (begin, end), still, settings, way)
        if len(candidates) > 0 and _decided(candidates):
            break
        length *= 2.0
    if len(candidates) == 0:
        return Search((), end, f"no pose of {name} explains its ranges")
    blunt = float(np.sqrt(candidates[0].pose.end_covariance[2, 2]))
    if blunt > BLUNT or len(candidates) > 6:
        moved = float(np.interp(0.0, (way.stamp - end) * 1e-9, way.travelled))
        return Search(
            (), end, f"{name} has moved too little ({moved:.2f} m): its heading cannot be told"
        )
    return Search(tuple(candidates), end)


def starts(
    recording: Recording,
    name: str,
    frame: Frame,
    begin: int,
    still: int,
    settings: FilterSettings,
    way: Reckoning,
) -> tuple[list[Floats], float]:
    """Places (2,) of a robot's antenna at `begin`, and how well they are known, m."""
    if name in frame.standing:
        place = frame.standing[name]
        both = [place, frame.reflect(place)] if frame.on_a_line else [place]
        return both, 0.1
    team, length = recording.team, INSTANT
    index = {team.index(n): i for i, n in enumerate(frame.anchors)}
    anchors = np.array(list(frame.anchors.values()))
    me = team.index(name)
    while length <= LONGEST_INSTANT:
        end = max(still, begin + length)
        pairs = mean_distances(recording, [me, *index], begin, end, settings.noise)
        mine = (pairs.a == me) | (pairs.b == me)
        other = [index[k] for k in np.where(pairs.a == me, pairs.b, pairs.a)[mine].tolist()]
        if len(other) >= 2:
            moved = float(np.interp(0.0, (way.stamp - end) * 1e-9, way.travelled))
            sigma = np.hypot(pairs.sigma[mine], 0.5 * moved)
            found = fixes(anchors[other], pairs.distance[mine], sigma)
            spread = max(float(np.sqrt(np.linalg.eigvalsh(f.covariance)[-1])) for f in found)
            return [fix.position for fix in found], float(np.clip(3.0 * spread, 0.1, 1.0))
        length *= 2
    return [], 0.0


def _judged(
    recording: Recording,
    name: str,
    frames: tuple[Frame, ...],
    places: Mapping[int, tuple[list[Floats], float]],
    span: tuple[int, int],
    still: Mapping[str, int],
    settings: FilterSettings,
    way: Reckoning,
) -> list[Candidate]:
    """The modes of one window in all frames, the most probable first."""
    lever = np.array(recording.team.robots[recording.team.index(name)].antenna)
    found: list[tuple[int, Refined]] = []
    for i, frame in enumerate(frames):
        window = cut(recording, [name], [], frame.anchors, still, span, settings)
        if window.ranges.row.size == 0 or len(places[i][0]) == 0:
            continue
        sensed = virtual_headings(recording, name, frame, span, settings, way)
        modes = judge(window, hypotheses(places[i][0], lever, sensed), places[i][1])
        shares = probabilities([mode.log_likelihood for mode in modes])
        kept = [m for m, share in zip(modes, shares, strict=True) if share > POSSIBLE][:24]
        found += [(i, refine(window, mode.start, [])) for mode in kept]
    found = _distinct([(i, r) for i, r in found if np.isfinite(r.mean).all()])
    if len(found) == 0:
        return []
    shares = probabilities([pose.log_likelihood for _, pose in found])
    candidates = [
        Candidate(i, pose, float(share)) for (i, pose), share in zip(found, shares, strict=True)
    ]
    candidates.sort(key=lambda candidate: -candidate.probability)
    return [c for c in candidates if c.probability > POSSIBLE]


def _distinct(found: list[tuple[int, Refined]]) -> list[tuple[int, Refined]]:
    """Poses that refinement did not bring together."""
    kept: list[tuple[int, Refined]] = []
    for frame, pose in sorted(found, key=lambda item: -item[1].log_likelihood):
        if all(frame != other or not _same(pose, seen) for other, seen in kept):
            kept.append((frame, pose))
    return kept


def _same(a: Refined, b: Refined) -> bool:
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
    return best.probability > SURE and best.pose.end_covariance[2, 2] < SHARP**2


def virtual_headings(
    recording: Recording,
    name: str,
    frame: Frame,
    span: tuple[int, int],
    settings: FilterSettings,
    way: Reckoning,
) -> list[Floats]:
    """Poses (3,) at the start of `span` by the virtual heading sensor, one per side."""
    team, odometry = recording.team, recording.odometry[name]
    robot = team.robots[team.index(name)]
    noise = measured_noise(odometry, robot, settings.noise)
    for drive in phases(straight(odometry, noise), odometry, SHORTEST_DRIVE):
        if drive.begin < span[0] or drive.end > span[1]:
            continue
        ends = way.at(np.array([drive.begin, drive.end]))
        if float(np.hypot(*(ends[1] - ends[0]))) < SHORTEST_WAY:
            continue
        middle, distance, sigma = _binned(recording, name, frame, drive.begin, drive.end, settings)
        if middle.size < 5:
            continue
        anchors = np.array(list(frame.anchors.values()))
        poses = []
        for side in (1.0, -1.0):
            seen = track(anchors, distance, sigma, side)
            found = bearing(seen.position, seen.covariance, way.at(middle))
            if found is not None:
                turned = rotation(found.heading) @ np.array(robot.antenna)
                poses.append(np.append(found.origin - turned, found.heading))
        return poses
    return []


def _binned(
    recording: Recording, name: str, frame: Frame, begin: int, end: int, settings: FilterSettings
) -> tuple[Stamps, Floats, Floats]:
    """Bins with ranges to the two widest anchors: stamps (n,), distances and sigmas (n, k)."""
    team, ranges = recording.team, recording.ranges
    me = team.index(name)
    column = np.full(len(team.robots), -1)
    column[[team.index(anchor) for anchor in frame.anchors]] = np.arange(len(frame.anchors))
    other = np.where(ranges.source == me, ranges.target, ranges.source)
    rows = np.flatnonzero(
        ((ranges.source == me) | (ranges.target == me))
        & (ranges.stamp > begin)
        & (ranges.stamp <= end)
        & (column[other] >= 0)
    )
    k = len(frame.anchors)
    variance = correlated_variance(
        range_sigma(recording, settings.noise)[rows] ** 2,
        ranges.stamp[rows],
        other[rows],
        correlation_time(settings.noise, team),
    )
    slot = (ranges.stamp[rows] - begin - 1) // BIN
    size = int(slot.max()) + 1 if rows.size > 0 else 0
    cell = slot * k + column[other[rows]]
    weight = np.bincount(cell, 1.0 / variance, size * k).reshape(size, k)
    total = np.bincount(cell, ranges.range[rows] / variance, size * k).reshape(size, k)
    seen = weight > 0.0
    distance = np.where(seen, total / np.where(seen, weight, 1.0), np.nan)
    sigma = np.where(seen, 1.0 / np.sqrt(np.where(seen, weight, 1.0)), 1.0)
    i, j = widest(np.array(list(frame.anchors.values())))
    keep = seen[:, i] & seen[:, j]
    count = np.maximum(np.bincount(slot, minlength=size), 1)
    offset = np.bincount(slot, (ranges.stamp[rows] - begin).astype(np.float64), size) / count
    stamp = begin + np.rint(offset).astype(np.int64)
    return stamp[keep], distance[keep], sigma[keep]
