"""A bank of hypotheses: where a robot may be and where it may head, judged by its ranges.

Every hypothesis is a filter over the same window. Those that end at one pose are one mode; its
probability is the sum of theirs. Two static robots, or several on a line, leave the mirror image
as a mode, which only the sign of the turn rate breaks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import rotation_matrix, wrap_angle
from clt.initialization.motion.window import (
    StartWindow,
    filter_window,
    log_likelihood,
    window_nis,
    with_start_copies,
)

START_HEADINGS = 12
"""Of the bank, evenly around the circle."""
START_HEADING_SIGMA = 0.3
"""Standard deviation of a hypothesis' heading, rad: neighbours overlap."""
SAME_MODE_M, SAME_MODE_RAD = 0.05, 0.05
"""Hypotheses that end closer than this, or within three standard deviations, are one. m, rad."""
WIDE_POSE_SIGMA = (0.3, 0.3, 0.3)
"""Standard deviations that leave the say to the ranges when a pose is refined: m, m, rad."""
MAX_LINEARIZATIONS = 5
"""Linearizations of a refinement at most."""


@dataclass(frozen=True)
class PoseMode:
    """One pose that the ranges of a window leave possible."""

    start: Floats
    """(x, y, heading) at the start of the window."""
    end: Floats
    """The same at its end."""
    covariance: Floats
    """At the end, (3, 3)."""
    log_likelihood: float
    nis: float
    """Mean NIS of the ranges; 1 for a true model."""


@dataclass(frozen=True)
class RefinedStart:
    """Joint poses at the start of a window, from everything in it."""

    mean: Floats
    """(n,), in the order of the window's state."""
    covariance: Floats
    """(n, n)."""
    log_likelihood: float
    nis: float
    end: Floats
    """Joint mean at the end, (n,)."""
    end_covariance: Floats

    @property
    def first(self) -> RefinedStart:
        """The first robot's part."""
        return replace(
            self,
            mean=self.mean[:3],
            covariance=self.covariance[:3, :3],
            end=self.end[:3],
            end_covariance=self.end_covariance[:3, :3],
        )


def start_hypotheses(
    places: Sequence[Floats], lever: Floats, extra: Sequence[Floats]
) -> list[Floats]:
    """Poses (3,): all headings at every place (2,) of the antenna, and further poses."""
    turns = wrap_angle(2.0 * np.pi * np.arange(START_HEADINGS) / START_HEADINGS)
    around = [
        np.append(place - rotation_matrix(float(turn)) @ lever, turn)
        for place in places
        for turn in turns
    ]
    return [*around, *extra]


def weigh_hypotheses(
    window: StartWindow, poses: Sequence[Floats], spread: float, company: Sequence[Floats] = ()
) -> list[PoseMode]:
    """Run the first robot's hypotheses; positions are believed to `spread` m. The best mode first.

    `company` are the poses (3,) of the other robots in the window.
    """
    P = np.diag(np.square([spread, spread, START_HEADING_SIGMA, *WIDE_POSE_SIGMA * len(company)]))
    tried = []
    for pose in poses:
        result = filter_window(window, np.concatenate([pose, *company]), P)
        if np.isfinite(result.last_mean).all() and np.isfinite(result.residual).all():
            end = np.append(result.last_mean[:2], wrap_angle(result.last_mean[2:3]))
            likelihood, nis = log_likelihood(window, result), window_nis(window, result)
            tried.append(PoseMode(pose, end, result.last_covariance[:3, :3], likelihood, nis))
    tried.sort(key=lambda mode: -mode.log_likelihood)
    groups: list[list[PoseMode]] = []
    for mode in tried:
        same = next((group for group in groups if same_mode(group[0], mode)), None)
        if same is None:
            groups.append([mode])
        else:
            same.append(mode)
    return [merge_modes(group) for group in groups]


def same_mode(a: PoseMode, b: PoseMode) -> bool:
    """Two hypotheses have ended at the same pose."""
    place = np.hypot(*(a.end[:2] - b.end[:2]))
    turn = abs(float(wrap_angle(a.end[2:] - b.end[2:])[0]))
    sigma = np.sqrt(np.trace(a.covariance[:2, :2]))
    sharp = min(float(np.sqrt(a.covariance[2, 2])), 0.1)
    return bool(place < 3.0 * min(sigma, 0.2) + SAME_MODE_M and turn < 3.0 * sharp + SAME_MODE_RAD)


def merge_modes(group: list[PoseMode]) -> PoseMode:
    """The best of a group with the probability of all."""
    total = float(np.logaddexp.reduce([mode.log_likelihood for mode in group]))
    return replace(group[0], log_likelihood=total)


def probabilities(log_likelihoods: Sequence[float], nis: float = 1.0) -> Floats:
    """Shares of exp(log-likelihood), shape (k,).

    Where even the best has a mean NIS above 1, ranges hold less information than their
    sigma promises: the likelihoods count for 1 / `nis`.
    """
    values = np.asarray(log_likelihoods, dtype=np.float64) / max(1.0, nis)
    shares = np.exp(values - values.max())
    return np.asarray(shares / shares.sum())


def refine_start(window: StartWindow, mean: Floats, loose: Sequence[Floats]) -> RefinedStart:
    """What a window says about its start, linearized around where that turns out to be.

    `mean` is the joint state; `loose` the standard deviations (3,) given to each static robot in
    it. The prior is wide and follows the mean, so the answer is the ranges' own.
    """
    count, n = 3 * len(window.moving), window.size
    memory = with_start_copies(window)
    spread = np.concatenate([np.tile(WIDE_POSE_SIGMA, len(window.moving)), *loose])
    P = np.zeros((n + count, n + count))
    P[:n, :n] = np.diag(spread**2)
    P[n:, n:] = P[:count, :count]
    P[:count, n:] = P[n:, :count] = P[:count, :count]
    back = np.r_[n : n + count, count:n]
    center = mean.copy()
    for _ in range(MAX_LINEARIZATIONS):
        result = filter_window(memory, np.append(center, center[:count]), P)
        found = result.last_mean[back]
        covariance = result.last_covariance[np.ix_(back, back)]
        shift = np.abs(found - center) / np.sqrt(np.maximum(covariance.diagonal(), 1e-12))
        center = found
        if not np.isfinite(found).all() or float(np.max(shift)) < 0.1:
            break
    return RefinedStart(
        center,
        covariance,
        log_likelihood(memory, result),
        window_nis(memory, result),
        result.last_mean[:n],
        result.last_covariance[:n, :n],
    )
