"""What each window of a log determines: rank, weakest direction, best standard deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.core.errors import CltError, UsageError
from clt.core.geometry import wrap_angle
from clt.observability.windows.gramian import state_columns, window_information
from clt.observability.windows.reference import ReferenceTrajectories

OBSERVED_POSITION_SIGMA, OBSERVED_HEADING_SIGMA = 1.0, 0.5
"""A direction counts as observed when the window alone fixes it better than this, m and rad."""
MIN_SCALED_INFORMATION = 1e-6
"""Scaled information below this is rounding."""
MAX_SIGMA_FACTOR = 10.0
"""A sigma beyond so many times those bounds is reported as none."""
NOISE_STEP_S = 0.1
"""Of the grid on which odometry noise acts, s."""
STARTS_PER_WINDOW = 4
"""Windows begin so many times per their length."""


@dataclass(frozen=True)
class RobotWindows:
    """One robot over all w windows."""

    name: str
    rank: Indices
    """(w,): of its numbers that the window alone fixes."""
    sigma_position: Floats
    """(w,): best standard deviation of its position in the worst direction, m; inf for none."""
    sigma_heading: Floats
    """(w,): of its heading, rad; NaN for a static robot, inf for none."""
    weakest: Floats
    """(w, 3): its least known direction (dx, dy, dtheta), m and rad, scaled to length one."""
    words: tuple[str, ...]
    """The same in words, per window."""


@dataclass(frozen=True)
class WindowAnalysis:
    """A log's windows."""

    frame: str
    """`world`, or the body frame `{ego}/base_link`."""
    source: str
    """Which trajectories the log was analysed at."""
    begin: Floats
    """(w,): s since the first common stamp of all trajectories."""
    end: Floats
    start_ns: int
    """That stamp."""
    dimension: int
    rank: Indices
    """(w,): of the whole team."""
    robots: Mapping[str, RobotWindows]


def sliding_windows(reference: ReferenceTrajectories, window: float) -> tuple[Indices, int]:
    """First steps (w,) and length in steps of windows of `window` s, the last at the end."""
    if not window >= reference.dt:
        raise UsageError(f"--window {window:g}: at least {reference.dt:g} s")
    steps = reference.noise.shape[1]
    length = min(steps, max(1, round(min(window / reference.dt, steps))))
    stride = max(1, length // STARTS_PER_WINDOW)
    return np.arange((steps - length) % stride, steps - length + 1, stride), length


def evaluate_windows(
    reference: ReferenceTrajectories, window: float, *, framed: bool, ego: str | None = None
) -> WindowAnalysis:
    """Analyse all windows; relative to the body frame of `ego` where one is named."""
    start, length = sliding_windows(reference, window)
    Y = window_information(reference, start, length, framed=framed)
    owner = state_columns(reference)[1]
    ids = [k for k, robot in enumerate(reference.robots) if robot.name != ego]
    pose = reference.pose[:, start + length].transpose(1, 0, 2)
    if ego is not None:
        centre = next((k for k, one in enumerate(reference.robots) if one.name == ego), None)
        if centre is None:
            raise CltError(f"no {reference.source} of {ego}: no windows in its frame")
        Y, pose = relative_information(reference, Y, pose, centre)
        owner = owner[owner != centre]
    heading = np.array([not robot.static for robot in reference.robots])
    bounds = np.where(
        np.arange(owner.size) - first_column_of(owner) == 2,
        OBSERVED_HEADING_SIGMA,
        OBSERVED_POSITION_SIGMA,
    )
    value, vector = np.linalg.eigh(Y * bounds[:, None] * bounds)
    spread = vector / np.sqrt(np.maximum(value, MIN_SCALED_INFORMATION))[:, None, :]
    covariance = spread @ spread.transpose(0, 2, 1)
    anchors = dict(reference.known) if ego is None else {}
    robots = {}
    for k in ids:
        own = np.flatnonzero(owner == k)
        block = covariance[:, own[:, None], own]
        name = reference.robots[k].name
        others = {reference.robots[j].name: pose[:, j, :2] for j in ids if j != k} | {
            other: np.tile(place, (len(start), 1)) for other, place in anchors.items()
        }
        if ego is not None:
            others[ego] = np.zeros((len(start), 2))
        robots[name] = _robot_windows(name, block, pose[:, k], others, moving=bool(heading[k]))
    return WindowAnalysis(
        "world" if ego is None else f"{ego}/base_link",
        reference.source,
        np.asarray(start * reference.dt, np.float64),
        np.asarray((start + length) * reference.dt, np.float64),
        reference.begin,
        owner.size,
        np.sum(value >= 1.0, axis=1),
        robots,
    )


def first_column_of(owner: Indices) -> Indices:
    """Column at which each column's robot begins, shape (d,)."""
    return np.searchsorted(owner, owner)


def relative_information(
    reference: ReferenceTrajectories, Y: Floats, pose: Floats, ego: int
) -> tuple[Floats, Floats]:
    """Information about, and poses of, all others in the body frame of one robot.

    With x_j = x_ego T_j the errors in the world are dp_j = dp_i + J (p_j - p_i) dtheta_i + R_i dr_j
    and dtheta_j = dtheta_i + dphi_j; the ego's own pose is then marginalized.
    """
    first, owner = state_columns(reference)
    own = np.flatnonzero(owner == ego)
    rest = np.flatnonzero(owner != ego)
    B = np.tile(np.eye(owner.size), (Y.shape[0], 1, 1))
    c, s = np.cos(pose[:, ego, 2]), np.sin(pose[:, ego, 2])
    seen = np.empty_like(pose)
    for j, robot in enumerate(reference.robots):
        d = pose[:, j, :2] - pose[:, ego, :2]
        seen[:, j, 0], seen[:, j, 1] = c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0]
        seen[:, j, 2] = wrap_angle(pose[:, j, 2] - pose[:, ego, 2])
        if j == ego:
            continue
        x = int(first[j])
        B[:, x, own[0]], B[:, x + 1, own[1]] = 1.0, 1.0
        B[:, x, own[2]], B[:, x + 1, own[2]] = -d[:, 1], d[:, 0]
        B[:, x, x], B[:, x, x + 1], B[:, x + 1, x], B[:, x + 1, x + 1] = c, -s, s, c
        if not robot.static:
            B[:, x + 2, own[2]] = 1.0
    Y = B.transpose(0, 2, 1) @ Y @ B
    cross = Y[:, own[:, None], rest]
    inner = Y[:, own[:, None], own] + MIN_SCALED_INFORMATION * np.eye(own.size)
    left = Y[:, rest[:, None], rest] - cross.transpose(0, 2, 1) @ np.linalg.solve(inner, cross)
    return left, seen


def _robot_windows(
    name: str, block: Floats, pose: Floats, others: Mapping[str, Floats], *, moving: bool
) -> RobotWindows:
    """One robot's numbers from its scaled marginal covariances (w, 2 or 3, 2 or 3)."""
    value, vector = np.linalg.eigh(block)
    limit = MAX_SIGMA_FACTOR**2
    position = np.linalg.eigvalsh(block[:, :2, :2])[:, -1]
    sigma = np.where(position < limit, OBSERVED_POSITION_SIGMA * np.sqrt(position), np.inf)
    turn = np.full(len(block), np.nan)
    weakest = np.zeros((len(block), 3))
    weakest[:, : block.shape[1]] = vector[:, :, -1]
    if moving:
        variance = block[:, 2, 2]
        turn = np.where(variance < limit, OBSERVED_HEADING_SIGMA * np.sqrt(variance), np.inf)
    words = _direction_names(weakest, pose, others, moving=moving)
    scaled = weakest * [OBSERVED_POSITION_SIGMA, OBSERVED_POSITION_SIGMA, OBSERVED_HEADING_SIGMA]
    scaled /= np.linalg.norm(scaled, axis=1)[:, None]
    return RobotWindows(name, np.sum(value <= 1.0, axis=1), sigma, turn, scaled, words)


def _direction_names(
    weakest: Floats, pose: Floats, others: Mapping[str, Floats], *, moving: bool
) -> tuple[str, ...]:
    """Name scaled directions (w, 3) by the most similar candidate, per window."""
    zero, one = np.zeros(len(pose)), np.ones(len(pose))
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    names: list[str] = ["x", "y"]
    vectors = [np.stack([one, zero, zero], 1), np.stack([zero, one, zero], 1)]
    if moving:
        names = ["heading", "along its path", "across its path"]
        vectors = [np.stack(parts, 1) for parts in ((zero, zero, one), (c, s, zero), (-s, c, zero))]
    for name, place in others.items():
        d = pose[:, :2] - place
        names.append(f"bearing from {name}")
        vectors.append(np.stack([-d[:, 1], d[:, 0], zero], 1))
        if moving:
            names.append(f"rotation about {name}")
            vectors.append(np.stack([-d[:, 1], d[:, 0], one / OBSERVED_HEADING_SIGMA], 1))
    stack = np.stack(vectors)
    length = np.linalg.norm(stack, axis=2)
    likeness = np.abs(np.einsum("nwk,wk->nw", stack, weakest)) / np.where(
        length > 0, length, np.inf
    )
    return tuple(names[k] for k in np.argmax(np.round(likeness, 2), axis=0))


def windows_as_list(found: WindowAnalysis) -> Sequence[Mapping[str, object]]:
    """The windows for `--json`: no information at all is null."""
    return [
        {
            "begin": round(float(found.begin[w]), 6),
            "end": round(float(found.end[w]), 6),
            "dimension": found.dimension,
            "rank": int(found.rank[w]),
            "nullity": found.dimension - int(found.rank[w]),
            "observable": bool(found.rank[w] == found.dimension),
            "robots": {name: _robot_as_dict(seen, w) for name, seen in found.robots.items()},
        }
        for w in range(found.rank.size)
    ]


def _robot_as_dict(seen: RobotWindows, w: int) -> Mapping[str, object]:
    position, turn = float(seen.sigma_position[w]), float(seen.sigma_heading[w])
    document: dict[str, object] = {
        "rank": int(seen.rank[w]),
        "weakest": seen.words[w],
        "direction": [float(value) for value in seen.weakest[w]],
        "sigma_position": position if np.isfinite(position) else None,
    }
    if not np.isnan(turn):
        document["sigma_heading"] = turn if np.isfinite(turn) else None
    return document
