"""Whether ranges go between the robots that they are said to go between, by the truth."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clt.core.recording import Poses, Ranges, Team
from clt.log.faults import Faults
from clt.metrics.associate import interpolate

MAX_MEDIAN_RANGE_ERROR = 1.5
"""No radio is off by so much in the median, m."""
MAX_TRUTH_GAP = 0.5
"""Truth is interpolated across no longer gap, s."""


def check_range_ends(
    ranges: Ranges, team: Team, truth: Mapping[str, Poses], faults: Faults
) -> None:
    """Note a fault for every pair whose ranges are no distance between the two."""
    low, high = np.minimum(ranges.source, ranges.target), np.maximum(ranges.source, ranges.target)
    pair = low * len(team.robots) + high
    for number in np.unique(pair):
        a, b = (team.names[end] for end in divmod(int(number), len(team.robots)))
        if a not in truth or b not in truth:
            continue
        rows = np.flatnonzero(pair == number)
        reached, A, _ = interpolate(truth[a], ranges.stamp[rows], MAX_TRUTH_GAP)
        rows = rows[reached]
        reached, B, _ = interpolate(truth[b], ranges.stamp[rows], MAX_TRUTH_GAP)
        if len(reached) == 0:
            continue
        distance = np.hypot(*(A[reached] - B)[:, :2].T)
        off = float(np.median(np.abs(ranges.raw[rows[reached]] - distance)))
        if off > MAX_MEDIAN_RANGE_ERROR:
            text = f"ranges are {off:.1f} m (median) off the true distance: wrong robots, perhaps"
            faults.add("ends", f"{a}-{b}", text, count=len(rows))
