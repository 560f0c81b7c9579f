"""Simulated logs through the bytes of every device and back: only what a format rounds differs."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from clt.core.recording import Ranges, Recording, Robot, Team
from clt.devices.decoders.table import DECODERS, make_decoder
from clt.devices.emission.emission import NO_ID, prepare_emission
from clt.devices.emission.log_samples import log_samples
from clt.devices.encoders.encoder import NOT_CARRIED_PAIR, PACKET_ODOMETRY, TOO_OLD
from clt.devices.encoders.table import ENCODERS
from clt.devices.samples import (
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
)
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate


class Rounding(NamedTuple):
    """What a format rounds: half its last place."""

    time_ns: float = 0.0
    metres: float = 0.0
    v: float = 0.0
    omega: float = 0.0


CENTIMETRE, MILLISECOND = Rounding(metres=0.005 + 1e-9), 500_000
ROUNDING = {
    "dwm1001": CENTIMETRE,
    "lps-sniffer": Rounding(),
    "makerfabs": CENTIMETRE,
    "ndjson": Rounding(),
    "qorvo-cli": CENTIMETRE,
    "rcl": Rounding(time_ns=MILLISECOND, v=1e-6, omega=1e-6),
    "trek1000": Rounding(time_ns=MILLISECOND, metres=0.0005 + 1e-9),
    "vesc": Rounding(v=0.5 / 4614 + 1e-9),
    "vesc-can": Rounding(time_ns=500, v=0.5 / 4614 + 1e-9),
}


def simulated(name, **overrides):
    return simulate(load_scenario(name, {"duration": 3.0, **overrides}, {}))


@pytest.fixture(scope="module")
def shi():
    """Two robots that stand still, three that move; whole milliseconds."""
    return simulated("shi-sim", **{"sensors.range.pairs": "all"})


@pytest.fixture(scope="module")
def araki():
    """Five cars, none of which stands still, at odd times."""
    return simulated("araki-five")


def through(recording, proto, robot=None, step=997):
    """The emission of a log, and what its decoder makes of it."""
    emission = prepare_emission(recording, proto, robot, "log")
    options = {} if robot is None else {"node": robot}
    decoder = make_decoder(proto, options, "uwb")
    data = b"".join(data for _, data in emission)
    found = []
    for at in range(0, len(data), step):
        found += decoder.feed(data[at : at + step])
    found += decoder.finish()
    counts = decoder.counts
    assert (counts.bad_frames, counts.skipped_bytes, decoder.tail_bytes) == (0, 0, 0)
    assert counts.frame_bytes == len(data)
    return emission, found


def named(emission, found, kind):
    """Samples of one kind under the names of robots."""
    names = emission.robots

    def renamed(sample):
        if isinstance(sample, RangeSample):
            source, target = (names.get(one, one) for one in (sample.source, sample.target))
            return sample._replace(source=source, target=target)
        return sample._replace(node=names.get(sample.node, sample.node))

    return [renamed(one) for one in found if isinstance(one, kind)]


def odometry_of(recording):
    rows = [
        (int(stamp), name, float(v), float(omega))
        for name, one in recording.odometry.items()
        for stamp, v, omega in zip(one.stamp, one.v, one.omega, strict=True)
    ]
    return sorted(rows)


def ranges_of(recording, keep=lambda _one, _other: True):
    ranges, names = recording.ranges, recording.team.names
    rows = [
        (int(stamp), *sorted((names[one], names[other])), float(value), float(raw))
        for stamp, one, other, value, raw in zip(
            ranges.stamp, ranges.source, ranges.target, ranges.range, ranges.raw, strict=True
        )
        if keep(names[one], names[other])
    ]
    return sorted(rows)


def origin(recording):
    first = min(rows[0][0] for rows in (ranges_of(recording), odometry_of(recording)) if rows)
    first = min([first, *(int(one.stamp[0]) for one in recording.truth.values())])
    return first // 10**6 * 10**6


def check_ranges(recording, emission, found, expected):
    """The same pairs in the same order within the rounding of the format."""
    rounding, first = ROUNDING[emission.proto], origin(recording)
    timed = DECODERS[emission.proto].device_time
    rows = [
        (
            0 if one.device_ns is None else first + one.device_ns,
            *sorted((one.source, one.target)),
            one.distance,
            one.raw_distance,
        )
        for one in named(emission, found, RangeSample)
    ]
    assert Counter(row[1:3] for row in rows) == Counter(row[1:3] for row in expected)
    for pair in {row[1:3] for row in expected}:
        here = np.array([(row[0], *row[3:]) for row in rows if row[1:3] == pair])
        there = np.array([(row[0], *row[3:]) for row in expected if row[1:3] == pair])
        if timed:
            # How long before its line a tag's first exchange happened is not known.
            begin = int(emission.proto == "trek1000")
            here, there = here[begin:], there[begin:]
            assert np.abs(here[:, 0] - there[:, 0]).max() <= rounding.time_ns + 512, pair
        assert np.abs(here[:, 1] - there[:, 1]).max() <= rounding.metres, pair


def test_rcl(shi):
    emission, found = through(shi, "rcl")
    check_ranges(shi, emission, found, ranges_of(shi))
    first = origin(shi)
    odometry = sorted(
        (first + one.device_ns, one.node, one.v, one.omega)
        for one in named(emission, found, OdometrySample)
    )
    expected = odometry_of(shi)
    assert [row[:2] for row in odometry] == [row[:2] for row in expected]
    differences = np.array([row[2:] for row in odometry]) - [row[2:] for row in expected]
    assert np.abs(differences).max() <= ROUNDING["rcl"].v
    assert emission.left_out == {}
    assert emission.robots == {str(n): f"R{n}" for n in range(1, 6)}


def test_ndjson(araki):
    emission, found = through(araki, "ndjson")
    assert emission.left_out == {}
    sent = [sample for _, samples in log_samples(emission.streams) for sample in samples]
    assert {type(one) for one in sent} == {RangeSample, OdometrySample, PoseSample}
    assert [str(one._replace(frame=0)) for one in found] == [str(one) for one in sent]


def test_trek1000_with_anchors(shi):
    emission, found = through(shi, "trek1000")
    assert emission.robots == {"a0": "R1", "a1": "R2", "t0": "R3", "t1": "R4", "t2": "R5"}
    static = {"R1", "R2"}
    carried = ranges_of(shi, lambda one, other: one in static or other in static)
    check_ranges(shi, emission, found, carried)
    left_out = len(ranges_of(shi)) - len(carried)
    assert left_out > 0
    assert emission.left_out == {NOT_CARRIED_PAIR: left_out}


def test_trek1000_of_cars(araki):
    """Four of five cars are anchors; pairs among anchors are those of `ma` lines."""
    emission, found = through(araki, "trek1000")
    ids = {name: number for number, name in emission.robots.items()}
    assert sorted(ids.values()) == ["a0", "a1", "a2", "a3", "t0"]

    def carried(one, other):
        return "t0" in {ids[one], ids[other]} or "a3" not in {ids[one], ids[other]}

    expected = ranges_of(araki, carried)
    ordered = sorted(row[0] for row in expected)
    assert ordered != [row[0] // 10**6 * 10**6 for row in expected]
    check_ranges(araki, emission, found, expected)


@pytest.mark.parametrize("proto", ["dwm1001", "qorvo-cli"])
def test_modules_of_one_robot(shi, proto):
    emission, found = through(shi, proto, "R3")
    assert "R3" not in emission.robots.values()
    check_ranges(shi, emission, found, ranges_of(shi, lambda one, other: "R3" in {one, other}))
    assert {one.source for one in found} == {"R3"}
    assert emission.left_out == {}


def test_makerfabs(shi):
    emission, found = through(shi, "makerfabs")
    static = {"R1", "R2"}
    carried = ranges_of(shi, lambda one, other: (one in static) != (other in static))
    check_ranges(shi, emission, found, carried)
    assert emission.left_out == {NOT_CARRIED_PAIR: len(ranges_of(shi)) - len(carried)}


@pytest.mark.parametrize("proto", ["vesc", "vesc-can"])
def test_motor_controllers(araki, proto):
    robot = "car2" if proto == "vesc" else None
    emission, found = through(araki, proto, robot)
    expected = [row for row in odometry_of(araki) if robot in {None, row[1]}]
    rows = [(one.node, one.v) for one in named(emission, found, OdometrySample)]
    assert [row[0] for row in rows] == [row[1] for row in expected]
    differences = [abs(one[1] - other[2]) for one, other in zip(rows, expected, strict=True)]
    assert max(differences) <= ROUNDING[proto].v
    assert all(np.isnan(one.omega) for one in found)
    if proto == "vesc-can":
        times = [origin(araki) + one.device_ns for one in found]
        assert max(abs(a - row[0]) for a, row in zip(times, expected, strict=True)) <= 500


@pytest.fixture(scope="module")
def broadcast():
    """A network of four radios at 50 Hz, odometry in the packets."""
    return simulated("shi-three", duration=2.0, radio={"rate": 50.0})


def test_raw_packets_in_ndjson(broadcast):
    emission, found = through(broadcast, "ndjson")
    sent = [sample for _, samples in log_samples(emission.streams) for sample in samples]
    assert any(isinstance(one, PacketSample) for one in sent)
    assert [str(one._replace(frame=0)) for one in found] == [str(one) for one in sent]


def test_lps_sniffer(broadcast):
    emission, found = through(broadcast, "lps-sniffer")
    sent = [sample for _, samples in log_samples(emission.streams) for sample in samples]
    assert emission.left_out.keys() <= {PACKET_ODOMETRY, TOO_OLD}
    assert len(found) == len(sent)
    ahead, sequences = {}, {}
    for one, other in zip(found, sent, strict=True):
        assert (one.node, one.device_ns) == (other.node, other.device_ns)
        turns = (one.transmit - other.transmit) % 2**40
        assert turns == ahead.setdefault(one.node, turns)
        assert turns % 2**32 == 0
        ages = {x.node: (one.transmit - x.ticks) % 2**40 for x in one.received}
        expected = {x.node: (other.transmit - x.ticks) % 2**40 for x in other.received}
        assert {name: expected[name] for name in ages} == ages
        for x, y in zip(one.received, [y for y in other.received if y.node in ages], strict=True):
            assert x.sequence - y.sequence == sequences.setdefault(x.node, x.sequence - y.sequence)
        shift = one.sequence - other.sequence
        assert shift == sequences.setdefault(one.node, shift)


def test_robots_beyond_the_ids_are_left_out_and_counted():
    """Seven robots, two with ids that the sniffer does not have: one gets a free one."""
    ids = [0, 1, 2, 3, 4, 70, 80]
    team = Team(tuple(Robot(f"R{number}", number) for number in ids))
    stamp = np.arange(6, dtype=np.int64) * 10**7
    one = np.zeros(6, np.int64)
    value = np.ones(6)
    ranges = Ranges(stamp, stamp, one, np.arange(1, 7), value, value, value, one)
    recording = Recording(team, ranges=ranges)
    emission, found = through(recording, "rcl")
    assert emission.robots == {str(k): f"R{n}" for k, n in enumerate([*range(5), 70])}
    assert len(found) == 5
    assert emission.left_out == {NO_ID: 1}
    assert replace(emission).left_out is emission.left_out


def test_every_protocol_is_tried():
    assert ENCODERS.keys() == DECODERS.keys() == ROUNDING.keys()
