from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.document import Document
from clt.importers.rosbag2 import read_rosbag2, rosbag2_files
from clt.log.recording.load import load
from tests.importers.bags import SECOND, write_bag
from tests.log.ros_bags import ros_bag, split

STREAMS = """
[robots.tb1]
odometry = "/turtle/odom"
ground_truth = "/mocap/pose"
[robots.beacon]
static = true
position = [1.0, 2.5]
[[ranges]]
topic = "/uwb/distance"
source = "tb1"
target = "beacon"
sigma = 0.1
"""


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    stamps = [100 * SECOND + k * SECOND // 10 for k in range(20)]
    write_bag(
        tmp_path / "bag",
        {
            "/turtle/odom": [(t, (0.5, 0.1)) for t in stamps],
            "/mocap/pose": [(t, (1.0, 2.0, 0.5)) for t in stamps],
            "/uwb/distance": [(t, (3.5,)) for t in stamps],
            "/chatter/text": [(t, ()) for t in stamps[:2]],
        },
        delay=SECOND // 50,
    )
    return tmp_path / "bag"


def clt(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(map(str, words)))
    return result.exit_code, result.output


def test_topics_become_streams(bag: Path, tmp_path: Path) -> None:
    streams, out = tmp_path / "streams.toml", tmp_path / "log.mcap"
    streams.write_text(STREAMS)
    assert clt("import", "rosbag2", bag, "--streams", streams, "-o", out)[0] == 0
    loaded = load(out)
    recording = loaded.recording
    assert loaded.own
    assert recording.team.names == ("tb1", "beacon")
    assert recording.team.robots[1].position == (1.0, 2.5)
    assert len(recording.ranges.stamp) == 20
    assert np.all(recording.ranges.log_time - recording.ranges.stamp == SECOND // 50)
    assert recording.ranges.sigma == pytest.approx(0.1)
    assert recording.odometry["tb1"].v == pytest.approx(0.5)
    assert recording.truth["tb1"].heading == pytest.approx(0.5)
    assert recording.run["format"] == "rosbag2"
    notes = json.loads(recording.run["import_notes"])
    assert notes == ["topics: /mocap/pose, /turtle/odom, /uwb/distance", "1 topics were left out"]
    assert [one.name for one in recording.attachments] == ["streams.toml"]
    assert str(streams) in json.loads(recording.run["inputs"])


def test_without_streams_the_remedy_is_named(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    write_bag(bag, {"/uwb/distance": [(SECOND, (3.5,))]})
    code, said = clt("import", "rosbag2", bag, "-o", tmp_path / "log.mcap")
    assert code == 1
    assert "no topic of it is mapped to a robot" in said
    assert "--streams" in said
    assert not (tmp_path / "log.mcap").exists()


def test_streams_are_for_bags_only(bag: Path, tmp_path: Path) -> None:
    streams = tmp_path / "streams.toml"
    streams.write_text(STREAMS)
    code, said = clt("import", "pyfg", bag, "--streams", streams, "-o", tmp_path / "log.mcap")
    assert code == 2
    assert "--streams maps the topics of a ROS 2 bag" in said


@pytest.mark.parametrize("mcap", [False, True])
def test_folders_of_both_kinds_and_in_parts(tmp_path: Path, mcap: bool) -> None:
    topics = {
        "/turtle/odom": (
            "odom",
            [(100 * SECOND + k * SECOND // 10, (0.5, 0.1)) for k in range(40)],
        ),
        "/uwb/distance": (
            "distance",
            [(100 * SECOND + k * SECOND // 5, (3.5,)) for k in range(20)],
        ),
    }
    parts = [
        ros_bag(
            tmp_path / f"part{number}",
            {name: (kind, rows[part]) for name, (kind, rows) in topics.items()},
            mcap=mcap,
        )
        for number, part in enumerate((slice(None, 10), slice(10, None)))
    ]
    whole = split(tmp_path / "bag", parts)
    streams = tmp_path / "streams.toml"
    streams.write_text(STREAMS.replace('ground_truth = "/mocap/pose"\n', ""))
    document = Document.read(streams)
    assert len(rosbag2_files(whole)) == 2
    recording = read_rosbag2(whole, document)
    assert len(recording.odometry["tb1"].stamp) == 40
    assert len(recording.ranges.stamp) == 20
    (file,) = [path for path in parts[0].iterdir() if path.name != "metadata.yaml"]
    assert len(read_rosbag2(file, document).odometry["tb1"].stamp) == 10
