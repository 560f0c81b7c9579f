"""What every filter fills in for a problem."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from clt.core.arrays import Floats, Indices
from clt.model.belief import Belief
from clt.model.problem import Problem
from clt.model.settings import FilterSettings


@dataclass(frozen=True)
class Solution:
    """One row per output and one per range of a `Problem`."""

    mean: Floats
    """Of the output's block, (outputs, 3), heading in (-pi, pi]."""
    covariance: Floats
    """(outputs, 3, 3)."""
    residual: Floats
    """m."""
    variance: Floats
    """Of the residual, m^2."""
    verdict: Indices
    """`eskf_state.RANGE_REJECTED` or `eskf_state.RANGE_USED`."""
    lost: Indices
    """How often each block looked lost and was searched for, shape (B,)."""
    belief: Belief
    """At the problem's end."""
    share: Floats | None = None
    """Probability of the leading mode of each output's block, (outputs,); None where a filter
    knows only one."""
    dropped: float = 0.0
    """Probability of what a mixture had no room for: the truth may be among it."""
    memory: object = None
    """What the filter keeps beside its belief, to go on from here as if it had never stopped."""
    traffic: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Messages and bytes that each robot sent and heard; none of a centralized filter."""
    apart: Mapping[str, float] = field(default_factory=dict)
    """Seconds that robots of a distributed filter could not reach the ego, if that was long."""
    log_density: Floats | None = None
    """Of each range given those before it, (n,); None where a filter has no model of outliers."""
    found: Indices | None = None
    """How often what was found took the place of each block's estimate, (B,); None: never."""


Filter = Callable[[Problem, FilterSettings], Solution]
