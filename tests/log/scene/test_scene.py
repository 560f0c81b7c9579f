"""What viewers are shown, message by message through rosbags."""

from __future__ import annotations

import io
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from clt.core.recording import Ranges
from clt.log.recording.save import save
from clt.log.scene import scene
from clt.log.scene.scene import scene_channels

ARROW, CUBE, CYLINDER, LINE_STRIP, LINE_LIST, TEXT = 0, 1, 3, 4, 5, 9


@pytest.fixture
def shown(tmp_path):
    """Save with a scene and read `/tf` and `/clt/scene` back: two lists of (log_time, message)."""

    def read(recording):
        path = tmp_path / "scene.mcap"
        with path.open("wb") as file:
            save(file, recording, {}, scene=True)
        topics = {"/tf": [], "/clt/scene": []}
        with AnyReader([path]) as reader:
            for connection, log_time, raw in reader.messages():
                if connection.topic in topics:
                    message = reader.deserialize(raw, connection.msgtype)
                    topics[connection.topic].append((log_time, message))
        return topics["/tf"], topics["/clt/scene"]

    return read


def by_name(message):
    return {(marker.ns, marker.id): marker for marker in message.markers}


def stamp(value):
    return value.sec * 10**9 + value.nanosec


def test_transforms_are_the_estimates_thinned(synthetic, shown):
    recording = synthetic(n=100)
    dense = recording.estimate["R1"]
    ticks = dense.stamp[0] + 10_000_000 * np.arange(100)
    recording = replace(
        recording, estimate=recording.estimate | {"R1": replace(dense, stamp=ticks, log_time=ticks)}
    )
    transforms, _ = shown(recording)
    by_robot = {}
    for log_time, message in transforms:
        (transform,) = message.transforms
        assert log_time == stamp(transform.header.stamp)
        assert transform.header.frame_id == "world"
        by_robot.setdefault(transform.child_frame_id, []).append(transform)
    assert {name: len(rows) for name, rows in by_robot.items()} == {
        "R1/base_link": 20, "R2/base_link": 100, "R3/base_link": 100,
    }  # fmt: skip
    third = by_robot["R2/base_link"][3].transform
    pose = recording.estimate["R2"]
    assert (third.translation.x, third.translation.y) == (pose.x[3], pose.y[3])
    assert 2 * math.atan2(third.rotation.z, third.rotation.w) == pytest.approx(pose.heading[3])


def test_without_estimates_the_truth_of_moving_robots_is_shown(synthetic, shown):
    recording = replace(synthetic(n=50), estimate={}, dead_reckoning={}, innovations=None)
    transforms, scenes = shown(recording)
    frames = {message.transforms[0].child_frame_id for _, message in transforms}
    assert frames == {"R1/base_link", "R2/base_link", "R3/base_link"}
    kinds = {marker.ns for marker in scenes[0][1].markers}
    assert kinds == {"static", "robot", "name", "trail"}


def test_nothing_is_shown_of_a_log_without_poses(synthetic):
    recording = replace(synthetic(n=50), estimate={}, truth={})
    assert scene_channels(recording) == []


def test_a_gap_of_years_is_not_filled_with_scenes(synthetic, shown):
    """A wrong clock may place one pose anywhere; scenes end when the last pose is too old."""
    recording = synthetic(n=100)
    track = recording.estimate["R1"]
    late = track.stamp.copy()
    late[-1] += 10 * 365 * 86400 * 10**9
    moved = replace(track, stamp=late, log_time=late)
    _, scenes = shown(replace(recording, estimate={"R1": moved}))
    times = np.array([time for time, _ in scenes])
    regular = (times - track.stamp[0]) / scene.SCENE_STEP_NS
    assert times[0] == track.stamp[0]
    assert regular.tolist() == pytest.approx([*range(len(times) - 1), regular[-1]])
    assert 10 <= len(times) <= 15
    assert 0 <= late[-1] - times[-1] < scene.SCENE_STEP_NS


def test_every_scene_replaces_the_last(synthetic, shown):
    _, scenes = shown(synthetic(n=100))
    names = [[(m.ns, m.id, m.type) for m in message.markers] for _, message in scenes]
    assert len(names) == 10
    assert all(row == names[0] for row in names)
    assert len(set(names[0])) == len(names[0])
    assert all(m.action == 0 for _, message in scenes for m in message.markers)
    assert all(stamp(m.header.stamp) == t for t, message in scenes for m in message.markers)


def test_the_markers_say_where_everything_is(synthetic, shown):
    recording = synthetic(n=100)
    _, scenes = shown(recording)
    markers, row = by_name(scenes[4][1]), 40
    cube, arrow = markers["static", 2], markers["robot", 3]
    assert (cube.type, cube.pose.position.x, cube.pose.position.y) == (CUBE, 6.0, 0.0)
    pose = recording.estimate["R1"]
    assert (arrow.type, arrow.pose.position.x, arrow.pose.position.y) == (
        ARROW, pose.x[row], pose.y[row],
    )  # fmt: skip
    assert arrow.color.a == 1.0
    assert (markers["name", 3].type, markers["name", 3].text) == (TEXT, "R1")
    trail, truth = markers["trail", 3], markers["truth", 3]
    assert trail.type == truth.type == LINE_STRIP
    assert [(p.x, p.y) for p in trail.points[-5:]] == [
        (pose.x[k], pose.y[k]) for k in range(0, 41, 10)
    ]
    true = recording.truth["R1"]
    assert (truth.points[-1].x, truth.points[-1].y) == (true.x[row], true.y[row])


def test_the_ellipse_is_that_of_two_sigma(synthetic, shown):
    recording = synthetic(n=20)
    _, scenes = shown(recording)
    disc = by_name(scenes[0][1])["covariance", 3]
    values, vectors = np.linalg.eigh(recording.estimate["R1"].covariance[0, :2, :2])
    assert disc.type == CYLINDER
    assert (disc.scale.y, disc.scale.x) == pytest.approx(4.0 * np.sqrt(values), rel=1e-9)
    angle = 2 * math.atan2(disc.pose.orientation.z, disc.pose.orientation.w)
    along = abs(vectors[:, 1] @ [math.cos(angle), math.sin(angle)])
    assert along == pytest.approx(1.0, abs=1e-9)


def test_links_show_what_the_filter_made_of_each_pair(synthetic, shown):
    recording = synthetic(n=100)
    _, scenes = shown(recording)
    links = by_name(scenes[4][1])["range", 0]
    assert links.type == LINE_LIST
    table = recording.innovations
    last = np.flatnonzero(table.stamp <= scenes[4][0])[-6:][::-1]
    assert len(links.points) == len(links.colors) == 2 * last.size
    for row, (a, b), color in zip(
        last,
        zip(links.points[::2], links.points[1::2], strict=True),
        links.colors[::2],
        strict=True,
    ):
        at = int(np.searchsorted(recording.estimate["R1"].stamp, scenes[4][0]))
        for end, point in ((table.source[row], a), (table.target[row], b)):
            robot = recording.team.robots[end]
            track = recording.estimate.get(robot.name)
            place = robot.position if track is None else (track.x[at], track.y[at])
            assert (point.x, point.y) == pytest.approx(place)
        expected = scene.ACCEPTED_RGB if table.accepted[row] else scene.REJECTED_RGB
        assert (color.r, color.g, color.b, color.a) == pytest.approx((*expected, 0.8), abs=1e-6)


def test_a_link_without_a_recent_range_vanishes(synthetic, shown):
    recording = replace(synthetic(n=100), innovations=None)
    begin = recording.estimate["R1"].stamp[0]
    at, one = np.array([begin + 10**9]), np.array([1.0])
    ranges = Ranges(at, at, np.array([2]), np.array([0]), one, one, one, np.array([0]))
    _, scenes = shown(replace(recording, ranges=ranges))
    alpha = [by_name(message)["range", 0].colors[0].a for _, message in scenes]
    expected = [0.8 if 2 <= index < 4 else 0.0 for index in range(10)]
    assert alpha == pytest.approx(expected, abs=1e-6)


def test_relative_estimates_are_shown_in_their_own_frame(synthetic, shown, moved):
    recording = moved(synthetic(n=50), lambda rows: rows, frame="R1/base_link")
    transforms, scenes = shown(recording)
    assert {m.transforms[0].header.frame_id for _, m in transforms} == {"R1/base_link"}
    assert {m.header.frame_id for m in scenes[0][1].markers} == {"R1/base_link"}
    assert {m.ns for m in scenes[0][1].markers} == {"robot", "name", "trail", "covariance", "range"}


def test_a_large_team_costs_no_more_messages_than_ten_robots(synthetic, shown):
    transforms, scenes = shown(synthetic(n=200, moving=20))
    assert len(scenes) == 10
    assert len(transforms) == 20 * 100


def test_a_scene_is_cheap(synthetic):
    recording = synthetic(n=6000, moving=3)

    def timed(wanted):
        began = time.process_time()
        save(io.BytesIO(), recording, {}, scene=wanted)
        return time.process_time() - began

    assert (
        min(timed(wanted=True) for _ in range(3)) < min(timed(wanted=False) for _ in range(3)) * 4
    )
