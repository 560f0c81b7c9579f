"""Patterns of topics in streams files."""

from __future__ import annotations

import pytest

from clt.core.errors import UsageError
from clt.log.recording.load import load
from tests.log.logs import odometry_message, pose_message, range_message, write_log

SECOND = 10**9
TOPICS = {
    "/R1/odom": "odometry",
    "/R2/odom": "odometry",
    "/R10/odom": "odometry",
    "/vrpn/R1/pose": "pose",
    "/vrpn/box/pose": "pose",
    "/uwb/n_1/n_2": "range",
    "/uwb/n_2/n_1": "range",
    "/uwb/n_1/n_10": "range",
    "/uwb/n_1/n_7": "range",
    "/uwb/n_1/n_1": "range",
}

TOPIC = list(TOPICS)


@pytest.fixture
def log(tmp_path):
    def rows(kind, topic):
        made = {
            "odometry": lambda t: odometry_message(t, 1.0, 0.0),
            "pose": lambda t: pose_message(t, 1.0, 2.0, frame="map"),
            "range": lambda t: range_message(t, 1, 2, 2.0 + TOPIC.index(topic)),
        }[kind]
        return kind, [(t, made(t)) for t in range(SECOND, 3 * SECOND, SECOND // 2)]

    path = tmp_path / "x.mcap"
    path.write_bytes(write_log({topic: rows(kind, topic) for topic, kind in TOPICS.items()}))
    return path


def mapped(log, text):
    path = log.with_name("s.toml")
    path.write_text(text)
    return load(log, path).recording


WHOLE = """
frame = "map"
odometry = "/{robot}/odom"
ground_truth = "/vrpn/{robot}/pose"
[robots.R1]
alias = "n_1"
[robots.R2]
alias = ["n_2", "two"]
[robots.R10]
alias = "n_10"
[[ranges]]
topic = "/uwb/{source}/{target}"
sigma = 0.2
"""


def test_patterns_name_robots_and_ends(log):
    recording = mapped(log, WHOLE)
    assert recording.team.names == ("R1", "R2", "R10")
    assert recording.team.frame == "map"
    assert list(recording.odometry) == ["R1", "R2", "R10"]
    assert list(recording.truth) == ["R1"]
    ends = set(zip(recording.ranges.source.tolist(), recording.ranges.target.tolist(), strict=True))
    assert ends == {(0, 1), (1, 0), (0, 2)}
    assert set(recording.ranges.sigma) == {0.2}
    assert {fault.kind for fault in recording.faults} == {"unknown"}
    said = " ".join(fault.text for fault in recording.faults)
    for topic in ("/vrpn/box/pose", "/uwb/n_1/n_7", "/uwb/n_1/n_1"):
        assert topic in said
    assert not any(fault.data_lost for fault in recording.faults)


def test_a_topic_that_is_named_is_no_part_of_a_pattern(log):
    extra = '[[ranges]]\ntopic = "/uwb/n_1/n_2"\nsource = "R1"\ntarget = "R2"\noffset = 5.0\n'
    recording = mapped(log, WHOLE + extra)
    first = (recording.ranges.source == 0) & (recording.ranges.target == 1)
    assert set(recording.ranges.range[first]) == {2.0 + TOPIC.index("/uwb/n_1/n_2") + 5.0}
    assert len(recording.ranges.range[first]) == 4


def test_one_end_may_stand_in_the_pattern(log):
    text = WHOLE.replace("{source}", "n_1").replace("sigma", 'source = "R1"\nsigma')
    recording = mapped(log, text)
    assert set(recording.ranges.source) == {0}
    assert set(recording.ranges.target) == {1, 2}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (WHOLE.replace("/uwb/{source}", "/uwb/{sender}"), "braces may hold {source}, {target}"),
        (WHOLE.replace("{target}", "{target"), "braces"),
        (WHOLE.replace("{target}", "{source}"), "may stand there once"),
        (WHOLE.replace("/{target}", "/n_2"), "both source and target"),
        (WHOLE.replace("sigma", 'source = "R1"\nsigma'), "gives the source already"),
        (WHOLE.replace("/{robot}/odom", "/odom"), "needs {robot}"),
        (WHOLE.replace("/uwb/", "/uwbs/"), "no topic like `/uwbs/{source}/{target}`"),
        (WHOLE.replace('"n_10"', '"n_1"'), "two robots are called `n_1`"),
        ('[[ranges]]\ntopic = "/uwb/{source}/{target}"\n', "no robots"),
        ('frame = ""\n' + WHOLE.replace('frame = "map"', ""), "frame"),
    ],
)
def test_wrong_patterns_are_named(log, text, said):
    with pytest.raises(UsageError) as caught:
        mapped(log, text)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
