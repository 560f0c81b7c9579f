"""UWB frames that come from elsewhere."""

import struct
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.core.recording import Robot, Team
from clt.log.recording.load import load
from clt.log.recording.metadata import TEAM_RECORD, encode_team
from clt.log.recording.save import save
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.log.logs import range_message, write_log

SECOND = 10**9
TYPE = "clt_msgs/msg/UwbFrame"
THREE = Team((Robot("R1", 1), Robot("R2", 2), Robot("R3", 3, static=True)))


def packet(stamp, source, heard=(), *, ticks=5, odometry=(1, 7, 0.5, 0.1), sequence=3):
    """A payload from (id, sequence, ticks) of the heard neighbours."""
    places = [*heard, *[None] * (16 - len(heard))]
    valid, when, v, omega = odometry
    head = (*divmod(stamp, SECOND), sequence, source, valid, ticks, when, v, omega)
    data = struct.pack("<iIIHBxQQdd", *head)
    data += bytes(one is not None for one in places)
    for code, index in (("H", 0), ("I", 1), ("Q", 2)):
        data += struct.pack(f"<16{code}", *(0 if one is None else one[index] for one in places))
    return b"\x00\x01\x00\x00" + data


def loaded(tmp_path, *payloads, team=THREE, robot="R1", kind=TYPE):
    """The recording of a log whose one topic holds the payloads, a second apart."""
    rows = [(index * SECOND, payload) for index, payload in enumerate(payloads, 1)]
    metadata = [] if team is None else [(TEAM_RECORD, encode_team(team))]
    path = tmp_path / "log.mcap"
    path.write_bytes(write_log({f"/{robot}/uwb/frame": (kind, rows)}, metadata))
    return load(path).recording


def kinds(recording):
    return [(fault.kind, fault.count, fault.data_lost) for fault in recording.faults]


def test_a_packet_as_its_definition_says(tmp_path):
    payload = packet(3 * SECOND, 1, [(3, 8, 99), (2, 2**32 - 1, 2**40 - 1)], ticks=2**40 - 2)
    assert len(payload) == 4 + 288
    recording = loaded(tmp_path, payload)
    frames = recording.frames
    assert frames.stamp.tolist() == [3 * SECOND]
    assert (frames.source[0], frames.sequence[0], frames.transmit[0]) == (0, 3, 2**40 - 2)
    assert frames.receive.tolist() == [[-1, 2**40 - 1, 99]]
    assert frames.heard.tolist() == [[-1, 2**32 - 1, 8]]
    assert (frames.odometry_stamp[0], frames.v[0], frames.omega[0]) == (7, 0.5, 0.1)
    assert kinds(recording) == []


def test_without_odometry_its_fields_mean_nothing(tmp_path):
    frames = loaded(tmp_path, packet(1, 1, odometry=(0, 2**63, np.nan, np.inf))).frames
    assert frames.odometry_stamp.tolist() == [-1]
    assert np.isnan(frames.v[0])
    assert np.isnan(frames.omega[0])


@pytest.mark.parametrize(
    ("payload", "kind"),
    [
        (packet(2, 7), "unknown"),
        (packet(2, 1, ticks=2**40), "ticks"),
        (packet(2, 1, ticks=2**64 - 1), "ticks"),
        (packet(2, 1, [(2, 1, 2**40)]), "ticks"),
        (packet(2, 1, odometry=(1, 2**40, 0.0, 0.0)), "ticks"),
        (packet(2, 1, odometry=(1, 7, np.nan, 0.0)), "nan"),
        (packet(2, 1)[:-9], "decode"),
    ],
)
def test_bad_packets_are_counted_and_dropped(tmp_path, payload, kind):
    recording = loaded(tmp_path, packet(1, 1), payload, packet(3, 1))
    assert recording.frames.stamp.tolist() == [1, 3]
    assert kinds(recording) == [(kind, 1, True)]


@pytest.mark.parametrize("stranger", [7, 1])
def test_receptions_of_strangers_are_dropped_alone(tmp_path, stranger):
    recording = loaded(tmp_path, packet(1, 1, [(stranger, 1, 5), (2, 1, 6)]))
    assert recording.frames.receive.tolist() == [[-1, 6, -1]]
    assert kinds(recording) == [("unknown", 1, True)]


def test_order_and_repetition(tmp_path):
    recording = loaded(tmp_path, packet(2, 1), packet(1, 1), packet(2, 1))
    assert recording.frames.stamp.tolist() == [1, 2]
    assert {fault.kind for fault in recording.faults} == {"backwards", "duplicate"}


def test_another_type_is_refused_in_one_line(tmp_path):
    with pytest.raises(LogError, match=r"/R1/uwb/frame: .*Range is not clt_msgs/UwbFrame"):
        loaded(tmp_path, range_message(1, 1, 2, 3.0), kind="range")


def test_a_team_is_inferred_from_packets(tmp_path):
    team = loaded(tmp_path, packet(1, 5, odometry=(0, 0, 0.0, 0.0)), team=None).team
    assert [(robot.name, robot.id, robot.static) for robot in team.robots] == [("R1", 5, True)]
    team = loaded(tmp_path, packet(1, 5), team=None).team
    assert not team.robots[0].static


def test_a_large_team_fits_no_frame():
    recording = simulate(load_scenario("shi-sim", {"duration": 1.0, "radio.rate": 10.0}))
    robots = tuple(Robot(f"N{number}", number) for number in range(18))
    crowd = replace(recording, team=Team(robots))
    with pytest.raises(LogError, match="17 neighbours; a frame holds 16"):
        save(BytesIO(), crowd, {})
