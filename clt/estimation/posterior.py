"""What every filter returns, so that evaluation cannot care which one ran."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from clt.core.recording import Floats, Innovations, Poses


@dataclass(frozen=True)
class Posterior:
    """The estimates of one run over a log."""

    filter: str
    robots: tuple[str, ...]
    """The estimated robots in the order of the joint state."""
    poses: Mapping[str, Poses]
    """Mean and marginal covariance of each robot after all data up to each stamp, in the frame of
    the start (`world`), or `{ego}/base_link` for relative estimates."""
    innovations: Innovations
    mean: Floats
    """(x, y, heading) of each robot at the end, shape (n, 3)."""
    covariance: Floats
    """Of the same, shape (n, 3, 3)."""
    remarks: tuple[str, ...] = ()
    """What was found out besides, one line each."""
    warnings: tuple[str, ...] = ()
    """What a user must know about this run, one line each."""
    left_out: tuple[str, ...] = ()
    """What could not be estimated and why, one line each."""
    diverged: tuple[str, ...] = ()
    """Robots whose estimate cannot be trusted."""
    traffic: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Messages and bytes that each robot of a distributed filter sent and heard."""
