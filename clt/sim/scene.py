"""What one simulation works on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clt.core.recording import Stamps, Team
from clt.sim.ranging import Pair
from clt.sim.scenario import Scenario
from clt.sim.sensors import SECOND
from clt.sim.settings import Network
from clt.sim.team import Member
from clt.sim.trajectory import Path, State, at
from clt.sim.transport import robot_key


@dataclass(frozen=True)
class Scene:
    """What one simulation works on."""

    scenario: Scenario
    """With the errors that sensors and network really have."""
    members: Sequence[Member]
    paths: Mapping[str, Path]
    team: Team
    """As the log declares it."""
    pairs: Sequence[Pair]

    def state(self, member: Member, stamps: Stamps) -> State:
        """Where a robot truly is at stamps (ns since the start)."""
        if not member.robot.static:
            return at(self.paths[member.robot.name], stamps / SECOND)
        zero = np.zeros(len(stamps))
        x, y = member.position
        return State(zero + x, zero + y, zero, zero, zero, zero)

    def with_perfect_network(self) -> Scene:
        """The same where every message arrives at once."""
        return replace(self, scenario=self.scenario.model_copy(update={"network": Network()}))


def pair_key(scene: Scene, pair: Pair) -> tuple[int, ...]:
    """The part of a random stream's key that stands for a pair."""
    return (*robot_key(scene.members[pair[0]]), *robot_key(scene.members[pair[1]]))
