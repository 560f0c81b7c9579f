"""Which of several possible places of a robot differ by more than noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats

SAME_POSITION_M = 0.02
"""Places nearer than this, or within three sigma, are one, m."""


@dataclass(frozen=True)
class PossiblePosition:
    """One possible place of a robot."""

    position: Floats
    """(2,), m."""
    covariance: Floats
    """(2, 2), m^2."""
    probability: float


def distinct_positions(places: Sequence[PossiblePosition]) -> list[PossiblePosition]:
    """Places that differ, the most probable first, with the probability of all that are alike.

    The probabilities of what comes back add up to 1.
    """
    kept: list[PossiblePosition] = []
    for place in sorted(places, key=lambda one: -one.probability):
        same = next((k for k, one in enumerate(kept) if _same_position(one, place)), None)
        if same is None:
            kept.append(place)
        else:
            one = kept[same]
            kept[same] = PossiblePosition(
                one.position, one.covariance, one.probability + place.probability
            )
    total = sum(place.probability for place in kept)
    scaled = [
        PossiblePosition(one.position, one.covariance, one.probability / total) for one in kept
    ]
    return sorted(scaled, key=lambda one: -one.probability)


def _same_position(a: PossiblePosition, b: PossiblePosition) -> bool:
    sigma = np.sqrt(np.trace(a.covariance) + np.trace(b.covariance))
    return float(np.hypot(*(a.position - b.position))) <= SAME_POSITION_M + 3.0 * float(sigma)
