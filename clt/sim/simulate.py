"""From a scenario to the recording of its log, with the truth in it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.errors import UsageError
from clt.sim.motion import paths
from clt.sim.packets import packets
from clt.sim.ranging import Pair, antenna, distance, excess, pairs
from clt.sim.rng import Purpose, stream
from clt.sim.scenario import Scenario, effective_toml
from clt.sim.scene import EPOCH, Scene, pair_key, robot_key, transport
from clt.sim.sensors import DECIMALS, odometry, reference, sampling
from clt.sim.settings import Network, Noise, Outliers
from clt.sim.team import Member, members, team_of
from clt.streams import (
    WORLD,
    Attachment,
    Floats,
    Odometry,
    Poses,
    Ranges,
    Recording,
    Stamps,
    Team,
    no_frames,
    no_ranges,
)

MOST_MESSAGES = 50_000_000


def simulate(scenario: Scenario) -> Recording:
    """The log of a scenario: equal scenarios give equal recordings, on any machine.

    Raises UsageError for a scenario that cannot be driven or is too large.
    """
    return _recording(scenario, scenario)


def exact(scenario: Scenario) -> Recording:
    """The same drives, stamps and declared noise, but every measurement perfect and none lost.

    A filter's Jacobians are then those at the truth, and its covariance is the Cramer-Rao bound.
    """
    return _recording(scenario, _without_errors(scenario))


def _without_errors(scenario: Scenario) -> Scenario:
    """The scenario with perfect sensors and a perfect network."""
    clean = {"scale_v": 1.0, "scale_omega": 1.0, "bias_omega": 0.0}
    quiet = {"sigma_v": 0.0, "sigma_omega": 0.0}
    sensors = scenario.sensors
    sensors = sensors.model_copy(
        update={
            "odometry": sensors.odometry.model_copy(update=clean | quiet),
            "range": sensors.range.model_copy(update={"sigma": 0.0, "bias": 0.0}),
            "truth": sensors.truth.model_copy(update={"sigma": 0.0, "sigma_heading": 0.0}),
        }
    )
    robots = tuple(robot.model_copy(update={"noise": Noise()}) for robot in scenario.robots)
    radio = scenario.radio
    if radio is not None:
        radio = radio.model_copy(update={"sigma": 0.0, "antenna_delay": 0.0, "loss": 0.0})
    return scenario.model_copy(
        update={
            "sensors": sensors,
            "robots": robots,
            "outliers": Outliers(),
            "network": Network(),
            "radio": radio,
        }
    )


def _recording(declared: Scenario, actual: Scenario) -> Recording:
    """Simulate with the errors of `actual`; the log tells of those of `declared`."""
    team = team_of(declared, members(declared))
    chosen = pairs(actual.sensors.range, team)
    _check_size(actual, team, len(chosen))
    crew = members(actual)
    scene = Scene(actual, crew, paths(actual, crew), team, chosen)
    document = effective_toml(declared).encode()
    radio = actual.radio
    carried = radio is not None and radio.odometry == "packets"
    odometry = {
        m.robot.name: _odometry(scene.with_perfect_network() if carried else scene, m)
        for m in crew
        if not m.robot.static
    }
    return Recording(
        team=team,
        odometry={} if carried else odometry,
        ranges=_ranges(scene) if radio is None else no_ranges(),
        frames=no_frames() if radio is None else packets(scene, radio, odometry if carried else {}),
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
    if count > MOST_MESSAGES:
        raise UsageError(
            f"{scenario.name}: {count} messages are more than the {MOST_MESSAGES} that one log "
            "may have; lower duration, rates or the team's size"
        )


def _odometry(scene: Scene, member: Member) -> Odometry:
    """The stream of one moving robot."""
    scenario, key = scene.scenario, robot_key(member)
    sensor = scenario.sensors.odometry
    stamps = sampling(sensor.rate, scenario.duration)
    draw = stream(scenario.seed, Purpose.ODOMETRY, *key)
    v, omega = odometry(sensor, member.robot, scene.paths[member.robot.name], stamps, draw)
    log_time, arrived = transport(scenario, stamps, (int(Purpose.ODOMETRY), *key))
    told = scene.team.robots[scene.team.index(member.robot.name)]
    n = int(np.count_nonzero(arrived))
    return Odometry(
        stamp=EPOCH + stamps[arrived],
        log_time=log_time[arrived],
        v=v[arrived],
        omega=omega[arrived],
        sigma_v=np.full(n, told.sigma_v),
        sigma_omega=np.full(n, told.sigma_omega),
    )


def _truth(scene: Scene, member: Member) -> Poses:
    """The reference trajectory of one robot; it takes no network to reach the recorder."""
    sensor = scene.scenario.sensors.truth
    stamps = np.concatenate([[0], sampling(sensor.rate, scene.scenario.duration)])
    draw = stream(scene.scenario.seed, Purpose.TRUTH, *robot_key(member))
    x, y, heading = reference(sensor, scene.state(member, stamps), draw)
    return Poses(WORLD, EPOCH + stamps, EPOCH + stamps, x, y, heading)


def _ranges(scene: Scene) -> Ranges:
    """The ranges of all pairs by stamp, then in the order of the pairs."""
    sensor = scene.scenario.sensors.range
    stamps = sampling(sensor.rate, scene.scenario.duration)
    if len(scene.pairs) == 0 or len(stamps) == 0:
        return no_ranges()
    spots = [antenna(scene.state(m, stamps), m.robot.antenna) for m in scene.members]
    n, shape = len(stamps), (len(stamps), len(scene.pairs))
    value, log_time = np.empty(shape), np.empty(shape, np.int64)
    arrived = np.empty(shape, np.bool_)
    for column, (a, b) in enumerate(scene.pairs):
        true = distance(spots[a], spots[b])
        value[:, column], heard = _measured(scene, (a, b), true, stamps)
        log_time[:, column], through = transport(
            scene.scenario, stamps, (int(Purpose.RANGE), *pair_key(scene, (a, b)))
        )
        arrived[:, column] = heard & through
    source, target = np.array(scene.pairs, np.int64).T
    keep = arrived.ravel()
    measured = value.ravel()[keep]
    sigma = scene.team.range_sigma
    return Ranges(
        stamp=EPOCH + np.repeat(stamps, shape[1])[keep],
        log_time=log_time.ravel()[keep],
        source=np.tile(source, n)[keep],
        target=np.tile(target, n)[keep],
        range=measured,
        raw=measured,
        sigma=np.full(len(measured), sigma),
        sequence=_sequence(source, n)[keep],
    )


def _measured(
    scene: Scene, pair: Pair, true: Floats, stamps: Stamps
) -> tuple[Floats, NDArray[np.bool_]]:
    """One pair's ranges (m) and which of them were in reach."""
    scenario, key = scene.scenario, pair_key(scene, pair)
    sensor = scenario.sensors.range
    noise = stream(scenario.seed, Purpose.RANGE, *key).standard_normal(len(true))
    late = excess(scenario.outliers, stamps, stream(scenario.seed, Purpose.OUTLIER, *key))
    reach = np.inf if sensor.max_range is None else sensor.max_range
    return np.round(true + sensor.bias + late + sensor.sigma * noise, DECIMALS), true <= reach


def _sequence(source: NDArray[np.int64], rounds: int) -> NDArray[np.int64]:
    """Each measuring robot counts its ranges, lost ones too; shape (rounds * pairs,)."""
    order = np.argsort(source, kind="stable")
    _, first, many = np.unique(source[order], return_index=True, return_counts=True)
    place, per_round = np.empty_like(source), np.empty_like(source)
    place[order] = np.arange(len(source)) - np.repeat(first, many)
    per_round[order] = np.repeat(many, many)
    count = np.arange(rounds, dtype=np.int64)[:, None] * per_round + place
    return np.asarray(count.ravel(), np.int64)
