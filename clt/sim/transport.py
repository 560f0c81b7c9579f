"""The way of a message from the robot that measured to the recorder, and the robot's own clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Stamps
from clt.core.errors import UsageError
from clt.core.recording import Team
from clt.core.settings import did_you_mean
from clt.sim.rng import Purpose, random_stream
from clt.sim.scenario import Scenario
from clt.sim.team import Member

LOG_START_NS = 1_735_689_600_000_000_000
"""Start of every simulated log: 2025-01-01T00:00:00Z."""


def robot_stream_key(member: Member) -> tuple[int, int]:
    """The part of a random stream's key that stands for a robot."""
    return int(member.robot.static), member.order


def check_recorder(scenario: Scenario, team: Team) -> None:
    """Raise UsageError where the recorder runs on a robot that the team has not."""
    name = scenario.network.recorder
    if name is not None and name not in team.names:
        hint = did_you_mean(name, team.names)
        raise UsageError(f"network.recorder: no robot {name} in the team{hint}")


def robot_clock_stamps(scenario: Scenario, host: Member, stamps: Stamps) -> Stamps:
    """What a robot's clock shows at true times (ns since the start), ns since 1970."""
    network = scenario.network
    error = 0
    if (network.clock_mean != 0.0 or network.clock_sd > 0.0) and not _on_board(scenario, host):
        draw = random_stream(scenario.seed, Purpose.HOST, *robot_stream_key(host))
        error = round(
            (network.clock_mean + network.clock_sd * draw.standard_normal()) * NS_PER_SECOND
        )
    return LOG_START_NS + stamps + error


def deliver_messages(
    scenario: Scenario, host: Member | None, stamps: Stamps, purpose: tuple[int, ...]
) -> tuple[Stamps, NDArray[np.bool_]]:
    """When each message of `host` reaches the recorder (ns) and which ones do, shape (n,).

    No host stands for one that is no robot: the listener of a UWB network.
    """
    network, n = scenario.network, len(stamps)
    log_time, arrived = LOG_START_NS + stamps, np.ones(n, np.bool_)
    if host is not None and _on_board(scenario, host):
        return log_time, arrived
    if network.batch > 0.0:
        log_time = LOG_START_NS + _batch_end(scenario, host, stamps)
    if network.delay_mean > 0.0 or network.delay_sd > 0.0:
        late = random_stream(scenario.seed, Purpose.DELAY, *purpose).standard_normal(n)
        delay = np.maximum(network.delay_mean + network.delay_sd * late, 0.0)
        log_time += np.rint(delay * NS_PER_SECOND).astype(np.int64)
    if network.loss > 0.0:
        arrived = random_stream(scenario.seed, Purpose.LOSS, *purpose).random(n) >= network.loss
    return log_time, arrived


def _on_board(scenario: Scenario, host: Member) -> bool:
    """The recorder runs on this robot."""
    return scenario.network.recorder == host.robot.name


def _batch_end(scenario: Scenario, host: Member | None, stamps: Stamps) -> Stamps:
    """When a host sends what it gathered at stamps, ns since the start."""
    period = max(round(scenario.network.batch * NS_PER_SECOND), 1)
    draw = random_stream(
        scenario.seed, Purpose.BATCH, *(() if host is None else robot_stream_key(host))
    )
    begin = int(draw.random() * period)
    return begin - (begin - stamps) // period * period
