"""`clt streams`: a first streams file that `clt info` takes at once."""

from __future__ import annotations

import json
import random
import tomllib

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.recording import Robot, Team
from clt.log.recording.metadata import TEAM_RECORD, encode_team
from tests.log.logs import Cdr, odometry_message, pose_message, range_message, write_log
from tests.log.ros_bags import ros_bag, team

SECOND = 10**9
FLOAT, RANGE = "std_msgs/msg/Float32", "sensor_msgs/msg/Range"


def clt(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def payload(kind, stamp, moves):
    if kind == "odometry":
        return odometry_message(stamp, 0.5, 0.1)
    if kind == "pose":
        return pose_message(stamp, stamp / SECOND if moves else 3.0, -1.0, frame="map")
    if kind == "range":
        return range_message(stamp, 1, 2, 2.0)
    if kind == FLOAT:
        return Cdr().put("f", 2.0).done()
    cdr = Cdr().header(stamp).put("B", 0).put("f", 0.0, 0.0, 9.0, 2.0, 0.01)
    return cdr.done()


def log(path, topics, metadata=()):
    """{topic: kind}; topics whose name holds `still` show one place."""
    rows = {
        topic: (kind, [(t, payload(kind, t, "still" not in topic)) for t in (SECOND, 2 * SECOND)])
        for topic, kind in topics.items()
    }
    path.write_bytes(write_log(rows, metadata))
    return path


def drafted(path):
    """The draft as TOML and what `clt info` makes of it, which must take it."""
    streams = path.parent / "draft.toml"
    done = clt("streams", path, "-o", streams, "--force")
    assert done.exit_code == 0, done.output
    done = clt("info", path, "--streams", streams, "--json")
    assert done.exit_code == 0, done.output
    return tomllib.loads(streams.read_text()), json.loads(done.stdout)


def test_a_newcomers_bag(tmp_path):
    """Two robots, an anchor, the truth of one: few lines, all of which hold."""
    file, draft = drafted(ros_bag(tmp_path / "bag", team(2.0), frame="map"))
    assert file == {
        "frame": "map",
        "robots": {
            "tb1": {"odometry": "/tb1/odom", "ground_truth": "/mocap/tb1/pose"},
            "tb2": {"odometry": "/tb2/odom"},
            "beacon": {"static": True},
        },
        "ranges": [{"topic": "/uwb/{source}/{target}"}],
    }
    assert draft["ranges"] == 30
    assert [topic["name"] for topic in draft["topics"] if not topic["used"]] == ["/rosout"]


def test_the_lab_with_turtles(tmp_path):
    """Nodes by number, n_2 on the robot that is left; truth of other names."""
    path = log(
        tmp_path / "x.mcap",
        {
            "/turtle01/odom": "odometry",
            "/turtle03/odom": "odometry",
            "/vrpn_client_node/turtlebot01_cap/pose": "pose",
            "/vrpn_client_node/turtlebot3/pose": "pose",
            "/vrpn_client_node/wand/pose": "pose",
            "/uwb/tof/n_2/n_3/distance": RANGE,
            "/uwb/tof/n_3/n_2/distance": RANGE,
        },
    )
    file, draft = drafted(path)
    robots = file["robots"]
    assert robots["turtle01"] == {
        "odometry": "/turtle01/odom",
        "ground_truth": "/vrpn_client_node/turtlebot01_cap/pose",
        "alias": "n_2",
    }
    assert robots["turtle03"]["ground_truth"] == "/vrpn_client_node/turtlebot3/pose"
    assert robots["turtle03"]["alias"] == "n_3"
    assert file["ranges"] == [{"topic": "/uwb/tof/{source}/{target}/distance"}]
    assert draft["ranges"] > 0


def test_topics_that_name_the_anchor_only_are_ranges_of_the_robot_that_drives(tmp_path):
    topics = {"/odom": "odometry", "/mocap/A1_still/pose": "pose", "/front/range": RANGE}
    topics |= {f"/uwb/A{k}/distance": FLOAT for k in (0, 1, 2)}
    file, draft = drafted(log(tmp_path / "x.mcap", topics))
    assert file["robots"] == {
        "robot": {"odometry": "/odom"},
        "A0": {"static": True},
        "A1": {"static": True, "ground_truth": "/mocap/A1_still/pose"},
        "A2": {"static": True},
    }
    assert file["ranges"] == [{"topic": "/uwb/{target}/distance", "source": "robot"}]
    assert draft["ranges"] == 6


def test_which_robot_measured_is_open_where_several_drive(tmp_path):
    topics = {"/tb1/odom": "odometry", "/tb2/odom": "odometry", "/uwb/A1/distance": FLOAT}
    file, draft = drafted(log(tmp_path / "x.mcap", topics))
    assert (file.get("ranges"), draft["ranges"]) == (None, 0)


def test_seven_nodes_are_one_pattern(tmp_path):
    topics = {
        f"/uwb/tof/n_{a}/n_{b}/distance": RANGE for a in range(1, 8) for b in range(1, 8) if a != b
    }
    topics |= {f"/vrpn_client_node/turtlebot{k}/pose": "pose" for k in range(1, 4)}
    topics |= {f"/vrpn_client_node/turtlebot{k}_still/pose": "pose" for k in range(4, 7)}
    path = log(tmp_path / "x.mcap", topics)
    file, draft = drafted(path)
    assert len(draft["pairs"]) > 20
    assert len(file["ranges"]) == 1
    assert file["ground_truth"] == "/vrpn_client_node/{robot}/pose"
    assert file["robots"]["turtlebot1"] == {"alias": "n_1"}
    assert draft["robots"]["turtlebot1"]["truth"]["count"] == 2
    static = [name for name, robot in file["robots"].items() if robot.get("static", False)]
    assert static == ["turtlebot4_still", "turtlebot5_still", "turtlebot6_still", "n_7"]
    text = clt("streams", path).stdout
    assert len([line for line in text.splitlines() if line[:1] not in {"#", ""}]) < 60


def test_many_robots_are_patterns(tmp_path):
    names = [f"R{k}" for k in range(1, 6)]
    topics = {f"/{name}/wheel/odom": "odometry" for name in names}
    topics |= {f"/mocap/{name}/pose": "pose" for name in names}
    topics |= {f"/ranges/{a}_to_{b}": FLOAT for a in names for b in names if a < b}
    topics["/ranges/R1_to_A1"] = FLOAT
    file, draft = drafted(log(tmp_path / "x.mcap", topics))
    assert file == {
        "frame": "map",
        "odometry": "/{robot}/wheel/odom",
        "ground_truth": "/mocap/{robot}/pose",
        "robots": {"A1": {"static": True}},
        "ranges": [{"topic": "/ranges/{source}_to_{target}"}],
    }
    assert len(draft["pairs"]) == 11
    assert set(draft["robots"]) == {*names, "A1"}


def test_a_robot_and_its_names_in_one_level(tmp_path):
    file, _ = drafted(
        log(
            tmp_path / "x.mcap",
            {
                "/odom": "odometry",
                "/still/anchor_1/pose": "pose",
                "/uwb/range_1_2": FLOAT,
                "/battery": FLOAT,
                "/sonar_front": RANGE,
                "/uwb/rate": FLOAT,
            },
        )
    )
    assert file["robots"]["robot"] == {"odometry": "/odom"}
    assert file["ranges"] == [{"topic": "/uwb/range_1_2", "source": "n1", "target": "n2"}]


def test_what_stays_open_is_said(tmp_path):
    path = log(tmp_path / "x.mcap", {"/tb1/odom": "odometry", "/tb1/uwb": FLOAT, "/img": FLOAT})
    text = clt("streams", path).stdout
    assert "# The topic does not name both ends: fill in the robots and uncomment." in text
    assert 'source = "?"' not in text
    assert '# topic = "/tb1/uwb"' in text
    assert "# /img" in text


def test_where_a_standing_truth_is(tmp_path):
    topics = {"/tb1/odom": "odometry", "/still/A1/pose": "pose", "/uwb/tb1/A1": FLOAT}
    text = clt("streams", log(tmp_path / "x.mcap", topics)).stdout
    assert "# position = [3.000, -1.000]" in text


def test_json_and_files(tmp_path):
    path = log(tmp_path / "x.mcap", {"/tb1/odom": "odometry", "/uwb/tb1/A1": FLOAT})
    printed = json.loads(clt("streams", path, "--json").stdout)
    assert printed["robots"] == ["tb1", "A1"]
    assert printed["topics"][1]["guess"] == "range from tb1 to A1"
    assert "[robots.tb1]" in printed["streams"]
    output = tmp_path / "s.toml"
    output.write_text("mine")
    assert clt("streams", path, "-o", output).exit_code == 1
    assert output.read_text() == "mine"


@pytest.mark.parametrize(
    ("topics", "metadata", "said"),
    [
        ({"/img": FLOAT}, (), "no topic looks like odometry"),
        (
            {"/R1/odom": "odometry"},
            [(TEAM_RECORD, encode_team(Team((Robot("R1", 1),))))],
            "clt wrote",
        ),
    ],
)
def test_logs_that_need_or_allow_none(tmp_path, topics, metadata, said):
    done = clt("streams", log(tmp_path / "x.mcap", topics, metadata))
    assert done.exit_code == 1
    assert said in done.stderr
    assert done.stdout == ""


def test_info_says_what_it_did_not_read(tmp_path):
    path = log(tmp_path / "x.mcap", {"/tb1/odom": "odometry", "/uwb/tb1/A1": FLOAT, "/img": FLOAT})
    done = clt("info", path)
    assert done.exit_code == 0
    assert "range from tb1 to A1" in done.stdout
    assert "clt streams" in done.stdout
    printed = json.loads(clt("info", path, "--json").stdout)
    assert {topic["name"]: (topic["used"], topic["guess"]) for topic in printed["topics"]} == {
        "/tb1/odom": (True, None),
        "/uwb/tb1/A1": (False, "range from tb1 to A1"),
        "/img": (False, None),
    }


def test_any_names_give_a_file_that_is_taken(tmp_path):
    """Topics of random words and types: whatever is drafted, `clt info` takes."""
    rng = random.Random(7)
    words = [
        "tb1",
        "tb2",
        "n_1",
        "n_2",
        "A1",
        "uwb",
        "odom",
        "pose",
        "mocap",
        "x-y",
        "1",
        "é",
        "to",
    ]
    kinds = ["odometry", "pose", FLOAT, RANGE, "range"]
    count = 0
    for _ in range(20):
        topics = {
            "/" + "/".join(rng.choices(words, k=rng.randint(1, 3))): rng.choice(kinds)
            for _ in range(rng.randint(1, 8))
        }
        path = log(tmp_path / "x.mcap", topics)
        streams = tmp_path / "s.toml"
        if clt("streams", path, "-o", streams, "--force").exit_code != 0:
            continue
        done = clt("info", path, "--streams", streams)
        assert done.exit_code in {0, 3}, (topics, streams.read_text(), done.output)
        count += 1
    assert count > 10
