"""All robots together: ranges between those that move determine more than those of each alone.

Every combination of the robots' possible poses is a filter over one window; a robot's probability
is the sum over the combinations that hold its pose.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import islice, product

import numpy as np

from clt.core.arrays import Floats
from clt.core.recording import Recording
from clt.initialization.motion.frame import CandidateFrame
from clt.initialization.motion.heading_hypotheses import (
    WIDE_POSE_SIGMA,
    RefinedStart,
    probabilities,
    refine_start,
)
from clt.initialization.motion.layout import MIN_LAYOUT_PROBABILITY
from clt.initialization.motion.search import Candidate, PoseSearch, same_pose
from clt.initialization.motion.window import (
    StartWindow,
    build_window,
    filter_window,
    log_likelihood,
    window_nis,
    window_with_ranges,
)
from clt.model.settings import FilterSettings

MAX_COMBINATIONS = 64
"""Combinations that are tried, the most probable ones."""

AGREEMENT_TIME_NS = 60_000_000_000
"""Over this long all ranges must agree with the start, ns."""
MAX_FILTER_WORK = 400_000_000
"""Ranges times the squared size of the state, of a window that is filtered for every pair."""

Combination = dict[str, Candidate]


@dataclass(frozen=True)
class CombinationWeights:
    """What all ranges together say."""

    best: Combination
    """The most probable combination."""
    shares: Mapping[str, tuple[tuple[Candidate, float], ...]]
    """Each robot's possible poses with their probability, the best first; a pose that is the same
    in several frames stands there once."""
    frames: Mapping[int, float]
    """Probability of every frame that remains possible."""


@dataclass(frozen=True)
class JointStart:
    """Joint poses at the start of a window, in the order of `names`."""

    names: tuple[str, ...]
    poses: RefinedStart
    window: StartWindow
    """A longer one, over which to see whether all ranges agree with them."""
    spread: Floats
    """Standard deviations that the ranges had the say from, (n,)."""


def likely_combinations(searches: Mapping[str, PoseSearch], frames: int) -> list[Combination]:
    """The MAX_COMBINATIONS most probable combinations whose poses are of one frame each."""
    found: list[tuple[float, Combination]] = []
    for frame in range(frames):
        choices = [
            [c for c in search.candidates if c.frame == frame] for search in searches.values()
        ]
        for picked in islice(product(*choices), 4 * MAX_COMBINATIONS * MAX_COMBINATIONS):
            weight = float(np.sum(np.log([c.probability for c in picked])))
            found.append((weight, dict(zip(searches, picked, strict=True))))
    found.sort(key=lambda item: -item[0])
    return [combination for _, combination in found[:MAX_COMBINATIONS]]


def weigh_combinations(
    recording: Recording,
    searches: Mapping[str, PoseSearch],
    frames: tuple[CandidateFrame, ...],
    span: tuple[int, int],
    still: Mapping[str, int],
    settings: FilterSettings,
) -> CombinationWeights:
    """Weigh the combinations of all robots' possible poses by all ranges in `span` (ns)."""
    tried = likely_combinations(searches, len(frames))
    scores = [(0.0, 1.0)]
    if len(tried) > 1:
        scores = [
            _score(
                build_window(recording, list(searches), [], frame.anchors, still, span, settings),
                np.concatenate([c.pose.mean for c in combination.values()]),
                frame.log_weight,
            )
            for combination, frame in ((c, frames[next(iter(c.values())).frame]) for c in tried)
        ]
    likelihoods = [likelihood for likelihood, _ in scores]
    probability = probabilities(likelihoods, scores[int(np.argmax(likelihoods))][1])
    order = np.argsort(-probability)
    shares: dict[str, tuple[tuple[Candidate, float], ...]] = {}
    for name, search in searches.items():
        own = [
            (c, float(sum(p for p, t in zip(probability, tried, strict=True) if t[name] is c)))
            for c in search.candidates
        ]
        shares[name] = _merged(sorted(own, key=lambda item: -item[1]))
    possible: dict[int, float] = {}
    for p, combination in zip(probability.tolist(), tried, strict=True):
        frame = next(iter(combination.values())).frame
        possible[frame] = possible.get(frame, 0.0) + p
    possible = {frame: p for frame, p in possible.items() if p > MIN_LAYOUT_PROBABILITY}
    return CombinationWeights(tried[int(order[0])], shares, possible)


def _merged(own: list[tuple[Candidate, float]]) -> tuple[tuple[Candidate, float], ...]:
    """Candidates with their probabilities, those of one pose in several frames as one."""
    kept: list[tuple[Candidate, float]] = []
    for candidate, p in own:
        alike = next((k for k, (c, _) in enumerate(kept) if _one_pose(c, candidate)), None)
        if alike is None:
            kept.append((candidate, p))
        else:
            kept[alike] = (kept[alike][0], kept[alike][1] + p)
    return tuple(sorted(kept, key=lambda item: -item[1]))


def _one_pose(a: Candidate, b: Candidate) -> bool:
    return a.frame != b.frame and same_pose(a.pose, b.pose)


def _score(window: StartWindow, mean: Floats, log_weight: float) -> tuple[float, float]:
    """Log-likelihood and mean NIS from joint poses at the start of a window."""
    result = filter_window(
        window, mean, np.diag(np.tile(np.square(WIDE_POSE_SIGMA), len(window.moving)))
    )
    return log_likelihood(window, result) + log_weight, window_nis(window, result)


def refine_jointly(
    recording: Recording,
    chosen: Combination,
    frame: CandidateFrame,
    open_: Collection[str],
    span: tuple[int, int],
    still: Mapping[str, int],
    settings: FilterSettings,
) -> JointStart:
    """Poses of the chosen robots and of uncertain static ones at the start of `span`, jointly.

    Static robots whose place is `open_` take no part.
    """
    floating = [name for name in frame.loose if name not in open_]
    anchors = {name: p for name, p in frame.anchors.items() if name not in frame.loose}
    window, longer = (
        build_window(recording, list(chosen), floating, anchors, still, (span[0], end), settings)
        for end in (span[1], max(span[1], span[0] + AGREEMENT_TIME_NS))
    )
    mean = [candidate.pose.mean for candidate in chosen.values()]
    mean += [np.append(frame.anchors[name], 0.0) for name in floating]
    loose = [frame.loose[name] for name in floating]
    spread = np.concatenate([np.tile(WIDE_POSE_SIGMA, len(chosen)), *loose])
    poses = refine_start(window, np.concatenate(mean), loose)
    return JointStart((*chosen, *floating), poses, limit_ranges(longer), spread)


def limit_ranges(window: StartWindow) -> StartWindow:
    """A window without the last of its ranges, if they are too many to filter again and again."""
    return window_with_ranges(window, slice(max(MAX_FILTER_WORK // window.size**2, 1)))
