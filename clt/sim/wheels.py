"""What wheel encoders make of the truth, and the log of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.recording import Odometry
from clt.sim.bursts import burst_heights
from clt.sim.rng import Purpose, random_stream
from clt.sim.scenario import Scenario
from clt.sim.scene import SimulationInput
from clt.sim.sensors import DECIMALS, sample_times
from clt.sim.settings import OdometrySensor
from clt.sim.team import Member
from clt.sim.trajectory import DrivenPath, state_at
from clt.sim.transport import deliver_messages, robot_clock_stamps, robot_stream_key


class OdometryErrors(NamedTuple):
    """Systematic errors of one robot: measured = scale * true + bias."""

    scale_v: float
    scale_omega: float
    bias_omega: float
    """rad/s."""


def simulate_odometry(scene: SimulationInput, member: Member) -> Odometry:
    """The stream of one moving robot as it reaches the recorder."""
    scenario, key = scene.scenario, robot_stream_key(member)
    sensor = scenario.sensors.odometry
    stamps = _stamps(scenario, key)
    v, omega = _twist(sensor, scene.paths[member.robot.name], stamps)
    share = np.where((v == 0.0) & (omega == 0.0), sensor.at_rest, 1.0)
    errors = _errors(scenario, key)
    noise = random_stream(scenario.seed, Purpose.ODOMETRY, *key).standard_normal((len(stamps), 2))
    v = errors.scale_v * v + share * (member.robot.sigma_v * noise[:, 0])
    omega = errors.scale_omega * omega + share * errors.bias_omega
    omega += share * (member.robot.sigma_omega * noise[:, 1])
    log_time, arrived = deliver_messages(scenario, member, stamps, (int(Purpose.ODOMETRY), *key))
    kept = arrived & ~_in_gap(scenario, stamps, key)
    declared = scene.team.robots[scene.team.index(member.robot.name)]
    return Odometry(
        stamp=robot_clock_stamps(scenario, member, stamps)[kept],
        log_time=log_time[kept],
        v=np.round(v, DECIMALS)[kept],
        omega=np.round(omega, DECIMALS)[kept],
        sigma_v=declared.sigma_v * share[kept],
        sigma_omega=declared.sigma_omega * share[kept],
    )


def _stamps(scenario: Scenario, key: tuple[int, int]) -> Stamps:
    """When one robot samples, ns since the start."""
    sensor, early = scenario.sensors.odometry, 0.0
    if sensor.phase == "random":
        early = random_stream(scenario.seed, Purpose.PHASE, int(Purpose.ODOMETRY), *key).random()
    return sample_times(sensor.rate, scenario.duration, early)


def _twist(sensor: OdometrySensor, path: DrivenPath, stamps: Stamps) -> tuple[Floats, Floats]:
    """True v (m/s) and omega (rad/s) at stamps (ns since the start), shape (n,).

    A mean is what wheel encoders give: arc length and turn of the interval over its length.
    """
    if sensor.twist == "instant":
        state = state_at(path, stamps / NS_PER_SECOND)
        return state.v, state.omega
    edges = np.concatenate([[0], stamps]) / NS_PER_SECOND
    state, span = state_at(path, edges), np.diff(edges)
    return np.diff(state.s) / span, np.diff(state.heading) / span


def _errors(scenario: Scenario, key: tuple[int, int]) -> OdometryErrors:
    """Those of all robots and the robot's own."""
    sensor = scenario.sensors.odometry
    scale_v, scale_omega, bias = random_stream(scenario.seed, Purpose.SCALE, *key).standard_normal(
        3
    )
    return OdometryErrors(
        sensor.scale_v * (1.0 + sensor.scale_sd * scale_v),
        sensor.scale_omega * (1.0 + sensor.scale_sd * scale_omega),
        sensor.bias_omega + sensor.bias_sd * bias,
    )


def _in_gap(scenario: Scenario, stamps: Stamps, key: tuple[int, int]) -> NDArray[np.bool_]:
    """Whether a sample falls into a gap, shape (n,)."""
    gaps = scenario.sensors.odometry.gaps
    if gaps.share == 0.0 or len(stamps) == 0:
        return np.zeros(len(stamps), np.bool_)
    draw = random_stream(scenario.seed, Purpose.GAP, *key)
    return burst_heights(gaps.share, gaps.length, stamps, draw) > 0.0
