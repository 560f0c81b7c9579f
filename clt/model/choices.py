"""What a user may choose of an estimator: light to import, so that a slip is refused at once."""

from __future__ import annotations

from typing import NamedTuple

from clt.core.errors import UsageError
from clt.core.settings import did_you_mean

FILTER_NAMES = ("eskf", "ekf", "ukf", "mixture", "pf", "dpf")
"""What `--filter` takes: the keys of `clt.estimation.estimators.FILTERS`."""
FILTERPY_FILTER_NAMES = ("ekf", "ukf")
"""The keys of `clt.estimation.estimators.FILTERPY_FILTERS`."""
ENGINES = ("compiled", "filterpy")


class FrameSpec(NamedTuple):
    """A choice of frame, as a user makes it."""

    kind: str
    """world, ego or mutual."""
    names: tuple[str, ...] = ()
    """The ego; or the two robots."""


def parse_frame_spec(text: str) -> FrameSpec:
    """`world`, `ego:NAME` or `mutual:A,B`. Raises UsageError for anything else."""
    kind, colon, rest = text.partition(":")
    names = tuple(rest.split(",")) if colon else ()
    counts = {"world": 0, "ego": 1, "mutual": 2}
    wanted = counts.get(kind)
    if wanted is None:
        raise UsageError(f"--frame {text}: unknown{did_you_mean(kind, counts)}")
    if wanted != len(names) or "" in names or len(set(names)) != len(names):
        raise UsageError(f"--frame {text}: not world, ego:NAME or mutual:A,B")
    return FrameSpec(kind, names)
