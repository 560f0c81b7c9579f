"""From a scenario to the recording of its log, with the truth in it."""

from __future__ import annotations

import numpy as np

from clt.core.errors import UsageError
from clt.core.recording import (
    WORLD_FRAME,
    Attachment,
    Poses,
    Recording,
    Team,
    no_ranges,
    no_uwb_packets,
)
from clt.sim.motion import drive_paths
from clt.sim.packets import simulate_packets
from clt.sim.ranges import simulate_ranges
from clt.sim.ranging import measuring_pairs
from clt.sim.rng import Purpose, random_stream
from clt.sim.scenario import Scenario, effective_toml
from clt.sim.scene import SimulationInput
from clt.sim.sensors import measured_truth, sample_times
from clt.sim.settings import Gaps, NetworkTable, NoiseTable, Outliers
from clt.sim.team import Member, declared_team, team_members
from clt.sim.transport import LOG_START_NS, check_recorder, robot_stream_key
from clt.sim.wheels import simulate_odometry

MAX_MESSAGES = 50_000_000


def simulate(scenario: Scenario) -> Recording:
    """The log of a scenario: equal scenarios give equal recordings, on any machine.

    Raises UsageError for a scenario that cannot be driven or is too large.
    """
    return _recording(scenario, scenario)


def simulate_exact(scenario: Scenario) -> Recording:
    """The same drives, stamps and declared noise, but every measurement perfect and none lost.

    Stamps are the true times of the measurements: clocks are right, messages arrive at once. A
    filter's Jacobians are then those at the truth, and its covariance is the Cramer-Rao bound.
    """
    return _recording(scenario, _without_errors(scenario))


def _without_errors(scenario: Scenario) -> Scenario:
    """The scenario with perfect sensors and a perfect network."""
    clean = {"scale_v": 1.0, "scale_omega": 1.0, "bias_omega": 0.0, "gaps": Gaps()}
    quiet = dict.fromkeys(("sigma_v", "sigma_omega", "scale_sd", "bias_sd"), 0.0)
    sensors = scenario.sensors
    sensors = sensors.model_copy(
        update={
            "odometry": sensors.odometry.model_copy(update=clean | quiet),
            "range": sensors.range.model_copy(update={"sigma": 0.0, "bias": 0.0}),
            "truth": sensors.truth.model_copy(update={"sigma": 0.0, "sigma_heading": 0.0}),
        }
    )
    robots = tuple(robot.model_copy(update={"noise": NoiseTable()}) for robot in scenario.robots)
    radio = scenario.radio
    if radio is not None:
        radio = radio.model_copy(update={"sigma": 0.0, "antenna_delay": 0.0, "loss": 0.0})
    return scenario.model_copy(
        update={
            "sensors": sensors,
            "robots": robots,
            "outliers": Outliers(),
            "network": NetworkTable(),
            "radio": radio,
        }
    )


def _recording(declared: Scenario, actual: Scenario) -> Recording:
    """Simulate with the errors of `actual`; the log states those of `declared`."""
    team = declared_team(declared, team_members(declared))
    chosen = measuring_pairs(actual.sensors.range, team)
    _check_size(actual, team, len(chosen))
    check_recorder(actual, team)
    crew = team_members(actual)
    scene = SimulationInput(actual, crew, drive_paths(actual, crew), team, chosen)
    document = effective_toml(declared).encode()
    radio = actual.radio
    carried = radio is not None and radio.odometry == "packets"
    wheels = {
        m.robot.name: simulate_odometry(scene.with_perfect_network() if carried else scene, m)
        for m in crew
        if not m.robot.static
    }
    return Recording(
        team=team,
        odometry={} if carried else wheels,
        ranges=simulate_ranges(scene) if radio is None else no_ranges(),
        frames=no_uwb_packets()
        if radio is None
        else simulate_packets(scene, radio, wheels if carried else {}),
        truth={m.robot.name: _truth(scene, m) for m in crew},
        attachments=(Attachment("scenario.toml", "application/toml", document),),
    )


def _check_size(scenario: Scenario, team: Team, pair_count: int) -> None:
    """Refuse what no memory would hold."""
    sensors = scenario.sensors
    rate = len(team.moving) * sensors.odometry.rate
    rate += len(team.robots) * sensors.truth.rate
    if scenario.radio is None:
        rate += pair_count * sensors.range.rate
    else:
        rate += len(team.robots) * scenario.radio.rate
    count = int(rate * scenario.duration)
    if count > MAX_MESSAGES:
        raise UsageError(
            f"{scenario.name}: {count} messages are more than the {MAX_MESSAGES} that one log "
            "may have; lower duration, rates or the team's size"
        )


def _truth(scene: SimulationInput, member: Member) -> Poses:
    """The reference trajectory of one robot; it takes no network to reach the recorder."""
    sensor = scene.scenario.sensors.truth
    stamps = np.concatenate([[0], sample_times(sensor.rate, scene.scenario.duration)])
    draw = random_stream(scene.scenario.seed, Purpose.TRUTH, *robot_stream_key(member))
    x, y, heading = measured_truth(sensor, scene.state(member, stamps), draw)
    return Poses(WORLD_FRAME, LOG_START_NS + stamps, LOG_START_NS + stamps, x, y, heading)
