"""What one simulation works on, and what all its streams share: keys of randomness, transport."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.sim.ranging import Pair
from clt.sim.rng import Purpose, stream
from clt.sim.scenario import Scenario
from clt.sim.sensors import SECOND
from clt.sim.settings import Network
from clt.sim.team import Member
from clt.sim.trajectory import Path, State, at
from clt.streams import Stamps, Team

EPOCH = 1_735_689_600_000_000_000
"""Start of every simulated log: 2025-01-01T00:00:00Z."""


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


def robot_key(member: Member) -> tuple[int, int]:
    """The part of a random stream's key that stands for a robot."""
    return int(member.robot.static), member.order


def pair_key(scene: Scene, pair: Pair) -> tuple[int, ...]:
    """The part of a random stream's key that stands for a pair."""
    return (*robot_key(scene.members[pair[0]]), *robot_key(scene.members[pair[1]]))


def transport(
    scenario: Scenario, stamps: Stamps, purpose: tuple[int, ...]
) -> tuple[Stamps, NDArray[np.bool_]]:
    """When each message reaches the recorder (ns) and which ones do, shape (n,)."""
    network, n = scenario.network, len(stamps)
    log_time, arrived = EPOCH + stamps, np.ones(n, np.bool_)
    if network.delay_mean > 0.0 or network.delay_sd > 0.0:
        late = stream(scenario.seed, Purpose.DELAY, *purpose).standard_normal(n)
        delay = np.maximum(network.delay_mean + network.delay_sd * late, 0.0)
        log_time += np.rint(delay * SECOND).astype(np.int64)
    if network.loss > 0.0:
        arrived = stream(scenario.seed, Purpose.LOSS, *purpose).random(n) >= network.loss
    return log_time, arrived
