"""The ranges of a scene as they reach the recorder."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.recording import Ranges, no_ranges
from clt.sim.bursts import outlier_excess
from clt.sim.ranging import IndexPair, antenna_points, point_distances
from clt.sim.rng import Purpose, random_stream
from clt.sim.scene import SimulationInput, pair_stream_key
from clt.sim.sensors import DECIMALS, sample_times
from clt.sim.transport import deliver_messages, robot_clock_stamps


def simulate_ranges(scene: SimulationInput) -> Ranges:
    """The ranges of all pairs by stamp, then in the order of the pairs."""
    stamps = [_stamps(scene, pair) for pair in scene.pairs]
    if sum(map(len, stamps)) == 0:
        return no_ranges()
    kept, stamp, log_time, value = [], [], [], []
    for pair, when, true in zip(scene.pairs, stamps, _distances(scene, stamps), strict=True):
        measured, heard = _measured(scene, pair, true, when)
        purpose = (int(Purpose.RANGE), *pair_stream_key(scene, pair))
        host = scene.members[pair[0]]
        arrival, through = deliver_messages(scene.scenario, host, when, purpose)
        stamp.append(robot_clock_stamps(scene.scenario, host, when))
        log_time.append(arrival)
        value.append(measured)
        kept.append(heard & through)
    source, target = np.repeat(np.array(scene.pairs, np.int64), list(map(len, stamps)), axis=0).T
    order = np.argsort(np.concatenate(stamp), kind="stable")
    keep = order[np.concatenate(kept)[order]]
    measured = np.concatenate(value)[keep]
    return Ranges(
        stamp=np.concatenate(stamp)[keep],
        log_time=np.concatenate(log_time)[keep],
        source=source[keep],
        target=target[keep],
        range=measured,
        raw=measured,
        sigma=np.full(len(measured), scene.team.range_sigma),
        sequence=_sequence(source, order)[keep],
    )


def _stamps(scene: SimulationInput, pair: IndexPair) -> Stamps:
    """When one pair measures, ns since the start."""
    scenario = scene.scenario
    sensor, rate, early = scenario.sensors.range, scenario.sensors.range.rate, 0.0
    if sensor.phase == "random" or sensor.rate_spread > 0.0:
        key = (int(Purpose.RANGE), *pair_stream_key(scene, pair))
        phase, pace = random_stream(scenario.seed, Purpose.PHASE, *key).random(2)
        rate *= 1.0 + sensor.rate_spread * (2.0 * pace - 1.0)
        early = phase if sensor.phase == "random" else 0.0
    return sample_times(rate, scenario.duration, early)


def _distances(scene: SimulationInput, stamps: list[Stamps]) -> list[Floats]:
    """True distance of each pair's antennas at its stamps, m; pairs in step share the work."""
    found: dict[tuple[int, bytes], tuple[Floats, Floats]] = {}
    result = []
    for pair, when in zip(scene.pairs, stamps, strict=True):
        spots = []
        for end in pair:
            key = (end, when.tobytes())
            if key not in found:
                member = scene.members[end]
                found[key] = antenna_points(scene.state(member, when), member.robot.antenna)
            spots.append(found[key])
        result.append(point_distances(spots[0], spots[1]))
    return result


def _measured(
    scene: SimulationInput, pair: IndexPair, true: Floats, stamps: Stamps
) -> tuple[Floats, NDArray[np.bool_]]:
    """One pair's ranges (m) and which of them were in reach."""
    scenario, key = scene.scenario, pair_stream_key(scene, pair)
    sensor = scenario.sensors.range
    noise = random_stream(scenario.seed, Purpose.RANGE, *key).standard_normal(len(true))
    late = outlier_excess(
        scenario.outliers, stamps, random_stream(scenario.seed, Purpose.OUTLIER, *key)
    )
    reach = np.inf if sensor.max_range is None else sensor.max_range
    return np.round(true + sensor.bias + late + sensor.sigma * noise, DECIMALS), true <= reach


def _sequence(source: Indices, order: Indices) -> Indices:
    """Each measuring robot counts its ranges in their order, lost ones too, shape (n,)."""
    rows = order[np.argsort(source[order], kind="stable")]
    _, first, many = np.unique(source[rows], return_index=True, return_counts=True)
    sequence = np.empty_like(source)
    sequence[rows] = np.arange(len(rows)) - np.repeat(first, many)
    return sequence
