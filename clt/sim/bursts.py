"""Bad times that come and go: outliers of ranges, gaps in odometry."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.sim.settings import Outliers


def outlier_excess(outliers: Outliers, stamps: Stamps, draw: np.random.Generator) -> Floats:
    """What outliers add to one pair's ranges at stamps (ns since the start), m, shape (n,)."""
    if outliers.share == 0.0 or len(stamps) == 0:
        return np.zeros(len(stamps))
    if outliers.burst == 0.0:
        chance, height = draw.random(len(stamps)), draw.exponential(1.0, len(stamps))
        return np.where(chance < outliers.share, outliers.mean * height, 0.0)
    return outliers.mean * burst_heights(outliers.share, outliers.burst, stamps, draw)


def burst_heights(share: float, length: float, stamps: Stamps, draw: np.random.Generator) -> Floats:
    """Bursts and gaps of exponential length (mean of a burst: `length` s) in turn, shape (n,).

    The height of the burst at each stamp (ns since the start; the last is the latest), one
    throughout each burst and exponential with mean 1; 0 in a gap. Bursts fill `share` of the time.
    """
    t = stamps / NS_PER_SECOND
    gap = length * (1.0 - share) / share
    cycles = 30 + int(2.0 * t[-1] / (length + gap))
    starts_in_burst = draw.random() < share
    unit = draw.exponential(1.0, (cycles, 3))
    ends = np.cumsum((unit[:, :2] * [length, gap]).ravel())
    skipped = 0.0 if starts_in_burst else ends[0]
    phase = np.searchsorted(ends, t + skipped, side="right")
    height = np.stack([unit[:, 2], np.zeros(cycles)], axis=1).ravel()
    return height[np.minimum(phase, 2 * cycles - 1)]
