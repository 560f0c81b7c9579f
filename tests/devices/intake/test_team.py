"""Robots of a recording: names, ids, who moves."""

from __future__ import annotations

import pytest

from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.recording import Robot, Team
from clt.devices.intake.team import GrowingTeam, read_team


def test_ids_are_those_of_names_then_of_devices_then_free_ones():
    team = GrowingTeam()
    ids = [team.robot(*words).id for words in (("R3", "0"), ("car", "7"), ("bus", "3"), ("x", "y"))]
    assert ids == [3, 7, 1, 2]
    assert team.robot("R3", "9").id == 3


def test_who_has_odometry_moves_unless_the_file_says_otherwise():
    team = GrowingTeam(Team((Robot("A", 1, static=True),)))
    team.robot("B10", "10")
    team.robot("B2", "2")
    team.written()
    team.moves("A")
    assert not team.changed
    team.moves("B2")
    assert team.changed
    assert [(robot.name, robot.static) for robot in team.team().robots] == [
        ("A", True), ("B2", False), ("B10", True),
    ]  # fmt: skip


def read(tmp_path, text):
    path = tmp_path / "team.toml"
    path.write_text(text)
    return read_team(Document.read(path))


def test_a_team_file(tmp_path):
    team = read(
        tmp_path,
        "[robots.R7]\nstatic = true\nposition = [1, 2.5]\n[robots.car]\nid = 1\n"
        "twist = 'instant'\nsigma_v = 0.1\n[robots.bus]\nantenna = [0.1, 0]\n",
    )
    assert [(robot.name, robot.id) for robot in team.robots] == [("R7", 7), ("car", 1), ("bus", 2)]
    assert team.robots[0].position == (1.0, 2.5)
    assert (team.robots[1].twist, team.robots[1].sigma_v) == ("instant", 0.1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[", "not a TOML file"),
        ("x = 1", "no|not known"),
        ("[robots.1]", "a name is a letter"),
        ("[robots.R1]\nsttaic = true", "did you mean `static`"),
        ("[robots.R1]\nstatic = 1", "neither true nor false"),
        ("[robots.R1]\nposition = [1, 2]", "add static = true"),
        ("[robots.R1]\nstatic = true\nposition = [1, nan]", r"`position` is not \[x, y\]"),
        ("[robots.R1]\nid = 70000", "`id` is not an integer"),
        ("[robots.R1]\nid = 2\n[robots.R3]\nid = 2", "two robots share one id"),
        ("[robots.R1]\ntwist = 'often'", "`twist`"),
        ("[robots.R1]\nsigma_v = -1.0", "`sigma_v` is not a number above 0"),
    ],
)
def test_a_wrong_team_file_is_named(tmp_path, text, said):
    with pytest.raises(UsageError, match=f"team.toml.*({said})"):
        read(tmp_path, text)
