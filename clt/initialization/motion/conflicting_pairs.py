"""Which pair's ranges contradict all others: a constantly biased pair shifts a whole start.

The filter over the window of the start is run again without the ranges of one pair. Were the model
true, the ranges that remain would be about as probable as before; where that pair was biased, they
become far more probable.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Indices
from clt.core.recording import Recording
from clt.filters.kalman.eskf_state import KalmanOutput
from clt.initialization.motion.team import JointStart
from clt.initialization.motion.window import (
    StartWindow,
    filter_window,
    range_log_likelihoods,
    window_nis,
    window_with_ranges,
)

MIN_LIKELIHOOD_GAIN = 10.0
"""Rise of the log-likelihood of the other ranges from which a pair contradicts them."""
MAX_TRIED_PAIRS = 12
"""That are tried, those with the largest mean residuals."""


def find_conflicting_pairs(recording: Recording, settled: JointStart) -> list[tuple[int, int]]:
    """Pairs (team indices) whose ranges contradict the others, the one that does so most first."""
    window, size = settled.window, len(recording.team.robots)
    row = window.ranges.row
    source, target = recording.ranges.source[row], recording.ranges.target[row]
    key = np.minimum(source, target) * size + np.maximum(source, target)
    base = _filtered(window, settled)
    likelihood = range_log_likelihoods(window, base)
    found = []
    for pair in _pairs_by_mean_residual(window, base, key):
        rest = key != pair
        less = window_with_ranges(window, rest)
        other = _filtered(less, settled)
        gain = float(np.sum(range_log_likelihoods(less, other)) - np.sum(likelihood[rest]))
        gain /= max(1.0, window_nis(less, other))
        if gain > MIN_LIKELIHOOD_GAIN:
            found.append((gain, divmod(pair, size)))
    return [ends for _, ends in sorted(found, reverse=True)]


def _filtered(window: StartWindow, settled: JointStart) -> KalmanOutput:
    """A run from the settled poses, with the say left to the ranges."""
    return filter_window(window, settled.poses.mean, np.diag(settled.spread**2))


def _pairs_by_mean_residual(window: StartWindow, result: KalmanOutput, key: Indices) -> list[int]:
    """Pairs by the size of their weighted mean residual in standard deviations, largest first."""
    pairs, index = np.unique(key, return_inverse=True)
    worth = window.ranges.variance / window.ranges.weight_variance / result.variance
    total = np.abs(np.bincount(index, worth * result.residual))
    order = np.argsort(-total / np.sqrt(np.bincount(index, worth)), kind="stable")
    return [int(pair) for pair in pairs[order][:MAX_TRIED_PAIRS]] if pairs.size > 1 else []
