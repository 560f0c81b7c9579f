"""A team that grows while it is recorded."""

from __future__ import annotations

import io
import json

import pytest

from clt.core.recording import Robot, Team
from clt.log.mcap.live_writer import LiveWriter
from clt.log.recording.load import load
from clt.log.recording.metadata import TEAM_RECORD, encode_team
from tests.log.logs import range_message

ONE = Robot("R1", 1, static=True)
OTHER = Robot("R2", 2, static=True)
MOVING = Robot("R1", 1)


def loaded(tmp_path, *records):
    file = io.BytesIO()
    with LiveWriter(file, {}) as log:
        for record in records:
            log.metadata(TEAM_RECORD, record)
        channel = log.channel("/R1/uwb/range", "clt_msgs/msg/Range")
        log.write(channel, 5, 5, range_message(5, 1, 2, 3.0))
    (tmp_path / "o.mcap").write_bytes(file.getvalue())
    return load(tmp_path / "o.mcap").recording


def test_the_last_record_of_a_team_that_grows_holds(tmp_path):
    teams = [Team(()), Team((ONE,)), Team((ONE, OTHER)), Team((MOVING, OTHER))]
    recording = loaded(tmp_path, *map(encode_team, teams))
    assert [(robot.name, robot.static) for robot in recording.team.robots] == [
        ("R1", False), ("R2", True),
    ]  # fmt: skip
    assert recording.faults == ()


@pytest.mark.parametrize(
    "later",
    [
        Team((OTHER,)),
        Team((Robot("R1", 3, static=True), OTHER)),
        Team((Robot("R1", 1, static=True, antenna=(0.1, 0.0)), OTHER)),
        Team((ONE, OTHER), range_sigma=0.5),
    ],
)
def test_another_team_is_a_fault(tmp_path, later):
    recording = loaded(tmp_path, encode_team(Team((ONE,))), encode_team(later))
    assert recording.team.names[0] == "R1"
    assert recording.team.robots[0].id == 1
    assert "team" in [fault.kind for fault in recording.faults]


def test_a_later_record_that_makes_no_sense_is_a_fault(tmp_path):
    first = encode_team(Team((ONE, OTHER)))
    recording = loaded(tmp_path, first, {"robots": json.dumps([1])})
    assert recording.team.names == ("R1", "R2")
    assert [fault.kind for fault in recording.faults] == ["team"]
