"""What one simulation works on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clt.core.arrays import NS_PER_SECOND, Stamps
from clt.core.recording import Team
from clt.sim.ranging import IndexPair
from clt.sim.scenario import Scenario
from clt.sim.settings import NetworkTable
from clt.sim.team import Member
from clt.sim.trajectory import DrivenPath, MotionState, state_at
from clt.sim.transport import robot_stream_key


@dataclass(frozen=True)
class SimulationInput:
    """What one simulation works on."""

    scenario: Scenario
    """With the errors that sensors and network really have."""
    members: Sequence[Member]
    paths: Mapping[str, DrivenPath]
    team: Team
    """As the log declares it."""
    pairs: Sequence[IndexPair]

    def state(self, member: Member, stamps: Stamps) -> MotionState:
        """Where a robot truly is at stamps (ns since the start)."""
        if not member.robot.static:
            return state_at(self.paths[member.robot.name], stamps / NS_PER_SECOND)
        zero = np.zeros(len(stamps))
        x, y = member.position
        return MotionState(zero + x, zero + y, zero, zero, zero, zero)

    def with_perfect_network(self) -> SimulationInput:
        """The same where every message arrives at once."""
        return replace(self, scenario=self.scenario.model_copy(update={"network": NetworkTable()}))


def pair_stream_key(scene: SimulationInput, pair: IndexPair) -> tuple[int, ...]:
    """The part of a random stream's key that stands for a pair."""
    return (*robot_stream_key(scene.members[pair[0]]), *robot_stream_key(scene.members[pair[1]]))
