"""The packets of a scenario's UWB network, as the log holds them."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Indices, Stamps
from clt.core.recording import Odometry, UwbPackets
from clt.core.ticks import RADIO_SPEED, TICKS_PER_SECOND
from clt.sim.bursts import outlier_excess
from clt.sim.clock import RadioClock, simulate_clock, wrap_counter
from clt.sim.radio import (
    Departures,
    arrival_stamps,
    reported_receptions,
    schedule_packets,
    send_packets,
)
from clt.sim.ranging import antenna_points, point_distances
from clt.sim.rng import Purpose, random_stream
from clt.sim.scene import SimulationInput, pair_stream_key
from clt.sim.settings import Radio
from clt.sim.transport import LOG_START_NS, deliver_messages, robot_stream_key


def simulate_packets(
    scene: SimulationInput, radio: Radio, odometry: Mapping[str, Odometry]
) -> UwbPackets:
    """All packets by the time they were sent; `odometry` is what they carry.

    Raises UsageError for a network that cannot be.
    """
    scenario = scene.scenario
    planned = schedule_packets(radio, len(scene.members), scenario.duration)
    clocks = [
        simulate_clock(
            radio.oscillator,
            scenario.duration,
            random_stream(scenario.seed, Purpose.CLOCK, *robot_stream_key(member)),
        )
        for member in scene.members
    ]
    sent = send_packets(clocks, planned)
    stamps, heard = _receptions(scene, radio, clocks, sent)
    turn = np.arange(planned.shape[1])
    receive, sequence = reported_receptions(stamps, heard, turn > turn[:, None])
    return _as_frames(scene, sent, (receive, sequence), _carried(scene, clocks, sent, odometry))


def _receptions(
    scene: SimulationInput, radio: Radio, clocks: list[RadioClock], sent: list[Departures]
) -> tuple[Indices, NDArray[np.bool_]]:
    """Receive stamps (ticks, unwrapped) and what was heard, shape (frames, receiver, sender)."""
    scenario, count, frames = scene.scenario, len(sent), sent[0].base.size
    stamps = np.zeros((frames, count, count), np.int64)
    heard = np.zeros(stamps.shape, np.bool_)
    reach = scenario.sensors.range.max_range
    delays = [_antenna_delay(scene, radio, index) for index in range(count)]
    obstacles = _obstacles(scene, sent)
    within = {frozenset(pair) for pair in scene.pairs}
    for sender in range(count):
        spots = [
            antenna_points(scene.state(member, sent[sender].stamp), member.robot.antenna)
            for member in scene.members
        ]
        for receiver in range(count):
            if receiver == sender:
                continue
            path = point_distances(spots[sender], spots[receiver])
            link = pair_stream_key(scene, (sender, receiver))
            noise = random_stream(scenario.seed, Purpose.STAMP, *link).standard_normal(frames)
            late = delays[sender] + delays[receiver] + radio.sigma * noise
            late += obstacles[min(sender, receiver), max(sender, receiver)] / RADIO_SPEED
            stamps[:, receiver, sender] = arrival_stamps(sent[sender], clocks[receiver], path, late)
            luck = random_stream(scenario.seed, Purpose.HEARD, *link).random(frames)
            known = frozenset((sender, receiver)) in within
            heard[:, receiver, sender] = known & (luck >= radio.loss)
            if reach is not None:
                heard[:, receiver, sender] &= path <= reach
    return stamps, heard


def _antenna_delay(scene: SimulationInput, radio: Radio, index: int) -> float:
    """Of one robot, either way, true minus configured, s."""
    draw = random_stream(
        scene.scenario.seed, Purpose.ANTENNA, *robot_stream_key(scene.members[index])
    )
    return float(radio.antenna_delay * draw.standard_normal())


def _obstacles(scene: SimulationInput, sent: list[Departures]) -> dict[tuple[int, int], Floats]:
    """What outliers add to the way between each pair, the same both ways, m, shape (frames,)."""
    scenario = scene.scenario
    return {
        pair: outlier_excess(
            scenario.outliers,
            sent[pair[0]].stamp,
            random_stream(scenario.seed, Purpose.OUTLIER, *pair_stream_key(scene, pair)),
        )
        for pair in combinations(range(len(sent)), 2)
    }


def _carried(
    scene: SimulationInput,
    clocks: list[RadioClock],
    sent: list[Departures],
    odometry: Mapping[str, Odometry],
) -> tuple[Indices, Floats, Floats]:
    """Latest odometry before each packet, shape (frames, robots): stamp in ticks, v, omega."""
    shape = (sent[0].base.size, len(sent))
    ticks, v, omega = np.full(shape, -1), np.full(shape, np.nan), np.full(shape, np.nan)
    for index, member in enumerate(scene.members):
        stream_ = odometry.get(member.robot.name)
        if stream_ is None:
            continue
        since = stream_.stamp - LOG_START_NS
        latest = np.searchsorted(since, sent[index].stamp, side="right") - 1
        some = latest >= 0
        rows = latest[some]
        ticks[some, index] = _device_time(clocks[index], since)[rows]
        v[some, index], omega[some, index] = stream_.v[rows], stream_.omega[rows]
    return ticks, v, omega


def _device_time(clock: RadioClock, stamps: Stamps) -> Indices:
    """What a radio's counter shows at true times (ns since the start)."""
    whole, part = stamps // NS_PER_SECOND, stamps % NS_PER_SECOND
    base, rest = clock.read(
        whole * TICKS_PER_SECOND, np.asarray(part * (TICKS_PER_SECOND / NS_PER_SECOND), np.float64)
    )
    return wrap_counter(base + np.rint(rest).astype(np.int64))


def _as_frames(
    scene: SimulationInput,
    sent: list[Departures],
    received: tuple[Indices, Indices],
    carried: tuple[Indices, Floats, Floats],
) -> UwbPackets:
    """The packets that reached the recorder, robot after robot in every frame."""
    frames, count = sent[0].base.size, len(sent)
    stamp = np.stack([one.stamp for one in sent], axis=1)
    log_time, arrived = np.empty_like(stamp), np.empty(stamp.shape, np.bool_)
    for index, member in enumerate(scene.members):
        way = (int(Purpose.HEARD), *robot_stream_key(member))
        log_time[:, index], arrived[:, index] = deliver_messages(
            scene.scenario, None, stamp[:, index], way
        )
    keep = arrived.ravel()
    transmit = wrap_counter(np.stack([one.reading for one in sent], axis=1))
    source = np.broadcast_to(np.arange(count), stamp.shape)
    number = np.broadcast_to(np.arange(frames)[:, None], stamp.shape)
    receive, sequence = (column.reshape(-1, count)[keep] for column in received)
    ticks, v, omega = carried
    return UwbPackets(
        LOG_START_NS + stamp.ravel()[keep],
        log_time.ravel()[keep],
        source.ravel()[keep],
        number.ravel()[keep],
        transmit.ravel()[keep],
        receive,
        sequence,
        ticks.ravel()[keep],
        v.ravel()[keep],
        omega.ravel()[keep],
    )
