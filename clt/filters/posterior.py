"""What every filter returns, so that evaluation cannot care which one ran."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from clt.streams import Floats, Innovations, Poses


@dataclass(frozen=True)
class Posterior:
    """The estimates of one run over a log."""

    filter: str
    frame: str
    """That of the start (`world`), or `{ego}/base_link` for relative estimates."""
    robots: tuple[str, ...]
    """The estimated robots in the order of the joint state, three numbers (x, y, heading) each."""
    poses: Mapping[str, Poses]
    """Mean and marginal covariance of each robot after all data up to each stamp."""
    innovations: Innovations
    mean: Floats
    """Joint mean at the end, shape (3 n,)."""
    covariance: Floats
    """Joint covariance at the end, shape (3 n, 3 n)."""
    warnings: tuple[str, ...] = ()
    """What a user must know about this run, one line each."""
    left_out: tuple[str, ...] = ()
    """What could not be estimated and why, one line each."""
    diverged: tuple[str, ...] = ()
    """Robots whose estimate cannot be trusted."""
