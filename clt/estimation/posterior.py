"""What every filter returns, so that evaluation cannot care which one ran."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from clt.core.arrays import Floats
from clt.core.diagnostics import DIVERGED, Diagnostic, by_severity
from clt.core.recording import Innovations, Poses


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
    diagnostics: tuple[Diagnostic, ...] = ()
    """What was found out besides, in the order of `by_severity`."""
    traffic: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Messages and bytes that each robot of a distributed filter sent and heard."""

    @property
    def diverged(self) -> tuple[str, ...]:
        """Robots whose estimate cannot be trusted."""
        return tuple(one.subject for one in self.diagnostics if one.kind == DIVERGED)


def add_diagnostics(posterior: Posterior, found: Iterable[Diagnostic]) -> Posterior:
    """The posterior with what was found besides."""
    return replace(posterior, diagnostics=by_severity((*posterior.diagnostics, *found)))
