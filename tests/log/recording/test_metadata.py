"""`clt.team` there and back, and nonsense refused."""

from __future__ import annotations

import json
import math
from dataclasses import astuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.core.errors import LogError
from clt.core.recording import Communication, Robot, Team
from clt.log.recording.metadata import decode_team, encode_team

finite = st.floats(-1e12, 1e12)
sigma = st.one_of(st.just(math.nan), st.floats(0.0, 1e9))
robots = st.builds(
    Robot,
    name=st.from_regex(r"[A-Za-z][A-Za-z0-9_]*", fullmatch=True),
    id=st.integers(0, 2**16 - 1),
    static=st.booleans(),
    position=st.none() | st.tuples(finite, finite),
    antenna=st.tuples(finite, finite),
    twist=st.sampled_from(["mean", "instant"]),
    sigma_v=sigma,
    sigma_omega=sigma,
)
teams = st.builds(
    Team,
    robots=st.lists(
        robots, max_size=5, unique_by=(lambda robot: robot.name, lambda robot: robot.id)
    ).map(tuple),
    range_sigma=sigma,
    range_correlation=st.floats(0.0, 1e6),
    communication=st.none()
    | st.builds(
        Communication,
        graph=st.text(),
        reach=st.floats(0.0, 1e6) | st.just(math.inf),
        rate=st.floats(1e-3, 1e3),
        loss=st.floats(0.0, 0.99),
        delay=st.floats(0.0, 1e3),
    ),
    frame=st.sampled_from(["world", "map", "\u00e9"]),
)


@given(teams)
def test_there_and_back(team):
    record = encode_team(team)
    assert all(isinstance(json.loads(text), object) for text in record.values())
    again = decode_team(record)
    assert repr(astuple(again)) == repr(astuple(team))


def test_a_frame_must_have_a_name():
    record = encode_team(Team((Robot("R1", 1),)))
    assert "frame" not in record
    for wrong in ('""', "3", "null"):
        with pytest.raises(LogError, match="`frame` is not a frame id"):
            decode_team(record | {"frame": wrong})


def test_what_is_not_known_is_null():
    record = encode_team(Team((Robot("R1", 1),)))
    assert record["range_sigma"] == "null"
    assert json.loads(record["robots"])[0] == {
        "name": "R1",
        "id": 1,
        "static": False,
        "position": None,
        "antenna": [0.0, 0.0],
        "twist": "mean",
        "sigma_v": None,
        "sigma_omega": None,
    }


def test_the_calibration_travels_along():
    record = encode_team(Team(()), {"range": {"gain": 0.9567, "offset": 0.6245}})
    assert json.loads(record["calibration"]) == {"range": {"gain": 0.9567, "offset": 0.6245}}
    assert "calibration" not in encode_team(Team(()))


def robot(**change):
    return {"robots": json.dumps([{"name": "R1", "id": 1, **change}])}


def test_a_short_record_is_enough():
    assert repr(decode_team(robot())) == repr(Team((Robot("R1", 1),)))


@pytest.mark.parametrize(
    ("record", "place"),
    [
        ({}, "`robots` is missing"),
        ({"robots": "nonsense"}, "`robots` is not JSON"),
        ({"robots": "[" * 100_000}, "`robots` is not JSON"),
        (robot(sigma_v=1e300), r"`robots\[0\].sigma_v` is not a number >= 0 up to 1e\+12"),
        (
            robot(position=[0.0, -1e300]),
            r"`robots\[0\].position` is not a finite number up to 1e\+12",
        ),
        ({"robots": "{}"}, "`robots` is not a list"),
        ({"robots": "[1]"}, r"`robots\[0\]` is not a table"),
        (robot(name="1R"), r"robots\[0\].name"),
        (robot(name="R/1"), r"robots\[0\].name"),
        (robot(name="R1\n"), r"robots\[0\].name"),
        (robot(name=7), r"robots\[0\].name"),
        (robot(id=-1), r"robots\[0\].id"),
        (robot(id=65536), r"robots\[0\].id"),
        (robot(id=True), r"robots\[0\].id"),
        (robot(id=1.5), r"robots\[0\].id"),
        (robot(static=1), "static"),
        (robot(twist="middle"), "twist"),
        (robot(twist=[]), "twist"),
        (robot(position=[1.0]), "position"),
        (robot(position=[1.0, None]), "position"),
        (robot(position=[1.0, "2"]), "position"),
        (robot(antenna=None), "antenna"),
        (robot(antenna=[math.inf, 0.0]), "antenna"),
        (robot(sigma_v=-0.1), "sigma_v"),
        (robot(sigma_v=math.nan), "sigma_v"),
        (robot(sigma_omega=True), "sigma_omega"),
        (robot(sigma_omega=10**400), "sigma_omega"),
        (robot() | {"range_sigma": '"a"'}, "range_sigma"),
        (robot() | {"communication": "[]"}, "communication"),
        (robot() | {"communication": '{"graph": 1}'}, "communication"),
        (robot() | {"communication": '{"rate": 0}'}, "communication.rate"),
        (robot() | {"communication": '{"loss": "much"}'}, "communication.loss"),
        ({"robots": json.dumps([{"name": "R1", "id": 1}] * 2)}, "two robots share one name"),
        (
            {"robots": json.dumps([{"name": "R1", "id": 1}, {"name": "R2", "id": 1}])},
            "two robots share one id",
        ),
    ],
)
def test_nonsense_is_refused_in_one_line(record, place):
    with pytest.raises(LogError, match=place) as caught:
        decode_team(record)
    assert "\n" not in str(caught.value)
