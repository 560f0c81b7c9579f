"""What one robot of a distributed filter does with the belief that it holds, of whatever kind."""

from __future__ import annotations

from typing import Protocol, Self

from clt.core.arrays import Floats, Indices
from clt.filters.distributed.rounds import Outage, PropagatedState
from clt.filters.mixture.gaussian_sum import MixtureOutput
from clt.model.belief import Belief
from clt.model.filter_inputs import Outputs
from clt.model.problem import Problem
from clt.model.range_table import RangeTable


class DistributedMember(Protocol):
    """One robot of a team. Each hypothesis of its belief is a particle or a Gaussian, K of them."""

    @property
    def problem(self) -> Problem:
        """As this robot knows it: with the odometry that reached it."""

    @property
    def size(self) -> int:
        """Bytes to hand its belief over."""

    @property
    def dropped(self) -> float:
        """Probability of hypotheses that there was no room for."""

    @property
    def belief(self) -> Belief:
        """What it holds now."""

    def copy(self) -> Self:
        """One that goes its own way."""

    def without(self, silent: Outage) -> Self:
        """This robot, which does not hear some others."""

    def path(self) -> PropagatedState:
        """The heaviest hypothesis, as it is now."""

    def advance(self, until: int) -> None:
        """Propagate all to a time (ns)."""

    def report(self, outputs: Outputs, trace: MixtureOutput) -> None:
        """Fill in the outputs, which are not before the time reached."""

    def distances(self, table: RangeTable) -> tuple[Floats, Floats]:
        """Distance of each range by each hypothesis, and its variance within: (n, K) twice, m."""

    def message(self, table: RangeTable, h: Floats, link: Indices, /) -> Floats:
        """What it sends the others about its own ranges at distances h (n, K), shape (Q,)."""

    def fuse(self, average: Floats, members: int, now: int, /) -> None:
        """Update the belief by what the members of a group found on average, at a time (ns)."""
