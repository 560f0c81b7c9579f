"""A recording as a log, read back by rosbags, by the official reader and by evo."""

from __future__ import annotations

import io
import json
import math
import shutil
import subprocess
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from clt.core.errors import LogError
from clt.core.geometry import heading_of_quaternion, wrap_angle
from clt.core.recording import (
    Attachment,
    Innovations,
    Odometry,
    Poses,
    Ranges,
    Recording,
    Robot,
    Team,
)
from clt.log.recording.channels import integrate_odometry
from clt.log.recording.metadata import decode_team
from clt.log.recording.save import save

START = 1_700_000_000_123_456_789
EVO = shutil.which("evo_ape")


def poses(rng, n, shift, covariance=False, frame="world"):
    s = 0.02 * np.arange(n)
    stamp = START + 50_000_000 * np.arange(n)
    root = rng.normal(size=(n, 3, 3))
    return Poses(
        frame,
        stamp,
        stamp + shift,
        3 * np.cos(s) + rng.normal(0.0, 0.1, n),
        3 * np.sin(s),
        wrap_angle(s + np.pi / 2),
        root @ root.transpose(0, 2, 1) if covariance else None,
    )


def made(n=200, seed=0):
    """A recording with something of everything."""
    rng = np.random.default_rng(seed)
    team = Team(
        (
            Robot("A1", 7, static=True, position=(0.5, -1.0)),
            Robot("Robot_3", 300, sigma_v=0.2, sigma_omega=0.1),
            Robot("R4", 4, antenna=(0.1, 0.0), twist="instant"),
        ),
        range_sigma=0.1,
    )
    stamp = START + 50_000_000 * np.arange(n)
    odometry = {
        robot.name: Odometry(
            stamp,
            stamp + 3000,
            rng.normal(1.0, 0.1, n),
            rng.normal(0.5, 0.1, n),
            np.where(np.arange(n) < 9, math.nan, 0.2),
            np.full(n, 0.1),
        )
        for robot in team.moving
    }
    m = 3 * n
    times = np.sort(START + rng.integers(0, 50_000_000 * n, m))
    source, target = rng.integers(0, 2, m), np.full(m, 2)
    measured = rng.uniform(1.0, 9.0, m)
    ranges = Ranges(
        times, times + 1000, source, target, measured, measured * 1.1,
        np.where(np.arange(m) < 5, math.nan, 0.1), np.arange(m) + 2**32 - 10,
    )  # fmt: skip
    residual, sigma = rng.normal(size=m), rng.uniform(1.0, 2.0, m)
    accepted = np.abs(residual) < 2
    names = [robot.name for robot in team.moving]
    return Recording(
        team,
        odometry,
        ranges,
        truth={name: poses(rng, n, 0) for name in names},
        estimate={name: poses(rng, n, 7, covariance=True) for name in names},
        dead_reckoning={name: poses(rng, n, 7, covariance=True) for name in names},
        innovations=Innovations(
            times, source, target, residual, sigma, (residual / sigma) ** 2, accepted
        ),
        attachments=(Attachment("scenario.toml", "application/toml", b"seed = 1\n"),),
    )


def saved(recording, **options):
    file = io.BytesIO()
    save(file, recording, {"seed": "1"}, **options)
    return file.getvalue()


def bag(path):
    """All messages of all topics through rosbags: {topic: [(log_time, message)]}."""
    topics = {}
    with AnyReader([path]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            topics.setdefault(connection.topic, []).append((time, message))
    return topics


@pytest.fixture(scope="module")
def recording():
    return made()


@pytest.fixture(scope="module")
def path(recording, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "all.mcap"
    path.write_bytes(saved(recording, scene=True))
    return path


@pytest.fixture(scope="module")
def topics(path):
    return bag(path)


def stamps(header_or_stamp):
    return header_or_stamp.sec * 10**9 + header_or_stamp.nanosec


def column(messages, path):
    """One field of every message."""
    values = []
    for _, message in messages:
        value = message
        for part in path.split("."):
            value = getattr(value, part)
        values.append(value)
    return np.array(values)


def heading(messages, path):
    return heading_of_quaternion(*(column(messages, f"{path}.orientation.{a}") for a in "xyzw"))


def test_every_topic_of_the_contract_is_there(recording, topics):
    n, m = 200, 600
    sources = Counter(recording.ranges.source.tolist())
    counts = {topic: len(messages) for topic, messages in topics.items()}
    expected = {"/A1/uwb/range": sources[0], "/Robot_3/uwb/range": sources[1]}
    for name in ("Robot_3", "R4"):
        kinds = ("odom", "ground_truth", "estimate", "dead_reckoning")
        expected |= {f"/{name}/{kind}": n for kind in kinds}
    expected |= {"/clt/innovation": m, "/tf": 2 * n, "/clt/scene": 20}
    assert counts == expected


@pytest.mark.parametrize("name", ["Robot_3", "R4"])
def test_odometry(recording, topics, name):
    odometry, messages = recording.odometry[name], topics[f"/{name}/odom"]
    assert [time for time, _ in messages] == odometry.log_time.tolist()
    assert [stamps(s) for s in column(messages, "header.stamp")] == odometry.stamp.tolist()
    assert set(column(messages, "header.frame_id")) == {f"{name}/odom"}
    assert set(column(messages, "child_frame_id")) == {f"{name}/base_link"}
    np.testing.assert_array_equal(column(messages, "twist.twist.linear.x"), odometry.v)
    np.testing.assert_array_equal(column(messages, "twist.twist.angular.z"), odometry.omega)
    covariance = column(messages, "twist.covariance").reshape(-1, 6, 6)
    np.testing.assert_array_equal(np.sqrt(covariance[9:, 0, 0]), odometry.sigma_v[9:])
    assert np.all(covariance[:9, 0, 0] == 0.0)
    np.testing.assert_array_equal(np.sqrt(covariance[:, 5, 5]), odometry.sigma_omega)
    assert np.count_nonzero(covariance) == 200 + 191
    turned = heading(messages, "pose.pose")
    x, y, expected = integrate_odometry(odometry, mean=name == "Robot_3")
    np.testing.assert_array_equal(column(messages, "pose.pose.position.x"), x)
    np.testing.assert_array_equal(column(messages, "pose.pose.position.y"), y)
    np.testing.assert_allclose(wrap_angle(turned - expected), 0.0, atol=1e-12)


def test_ranges(recording, topics):
    ranges = recording.ranges
    for index, name in enumerate(["A1", "Robot_3"]):
        rows = ranges.source == index
        messages = topics[f"/{name}/uwb/range"]
        assert [time for time, _ in messages] == ranges.log_time[rows].tolist()
        assert [stamps(s) for s in column(messages, "stamp")] == ranges.stamp[rows].tolist()
        assert set(column(messages, "source")) == {(7, 300)[index]}
        assert set(column(messages, "target")) == {4}
        np.testing.assert_array_equal(column(messages, "range"), ranges.range[rows])
        np.testing.assert_array_equal(column(messages, "raw_range"), ranges.raw[rows])
        np.testing.assert_array_equal(column(messages, "sigma"), ranges.sigma[rows])
        sequence = column(messages, "sequence").astype(np.int64)
        np.testing.assert_array_equal(sequence, ranges.sequence[rows] % 2**32)
        for end in ("source", "target"):
            assert np.isnan(column(messages, f"received_power_at_{end}")).all()


@pytest.mark.parametrize("kind", ["truth", "estimate", "dead_reckoning"])
def test_poses(recording, topics, kind):
    for name, track in getattr(recording, kind).items():
        messages = topics[f"/{name}/{'ground_truth' if kind == 'truth' else kind}"]
        pose = "pose" if kind == "truth" else "pose.pose"
        assert [time for time, _ in messages] == track.log_time.tolist()
        assert [stamps(s) for s in column(messages, "header.stamp")] == track.stamp.tolist()
        assert set(column(messages, "header.frame_id")) == {"world"}
        np.testing.assert_array_equal(column(messages, f"{pose}.position.x"), track.x)
        np.testing.assert_array_equal(column(messages, f"{pose}.position.y"), track.y)
        error = wrap_angle(heading(messages, pose) - track.heading)
        np.testing.assert_allclose(error, 0.0, atol=1e-12)
        if kind != "truth":
            full = column(messages, "pose.covariance").reshape(-1, 6, 6)
            np.testing.assert_array_equal(full[:, [[0], [1], [5]], [0, 1, 5]], track.covariance)
            assert not full[:, 2:5].any()


def test_innovations(recording, topics):
    table, messages = recording.innovations, topics["/clt/innovation"]
    ids = np.array([7, 300, 4])
    assert [time for time, _ in messages] == table.stamp.tolist()
    np.testing.assert_array_equal(column(messages, "source"), ids[table.source])
    np.testing.assert_array_equal(column(messages, "target"), ids[table.target])
    for name in ("residual", "sigma", "nis", "accepted"):
        np.testing.assert_array_equal(column(messages, name), getattr(table, name))


def test_metadata_and_attachments(recording):
    calibrated = replace(recording, run={"calibration": '{"range":{"gain":0.9}}'})
    reader = make_reader(io.BytesIO(saved(calibrated)))
    metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert metadata["clt.run"] == {"seed": "1"}
    assert repr(decode_team(metadata["clt.team"])) == repr(recording.team)
    assert json.loads(metadata["clt.team"]["calibration"]) == {"range": {"gain": 0.9}}
    (attachment,) = reader.iter_attachments()
    assert (attachment.name, attachment.media_type, attachment.data) == (
        "scenario.toml", "application/toml", b"seed = 1\n",
    )  # fmt: skip
    assert reader.get_header().profile == "ros2"


def test_an_unknown_heading_is_a_quaternion_of_zeros(tmp_path):
    track = poses(np.random.default_rng(0), 5, 0, frame="mocap")
    track = replace(track, heading=np.full(5, math.nan))
    path = tmp_path / "a.mcap"
    recording = Recording(Team((Robot("R1", 1),)), truth={"R1": track})
    path.write_bytes(saved(recording, scene=True))
    topics = bag(path)
    for _, message in topics["/R1/ground_truth"]:
        q = message.pose.orientation
        assert (q.x, q.y, q.z, q.w) == (0.0, 0.0, 0.0, 0.0)
        assert message.header.frame_id == "mocap"
    assert all(message.transforms[0].transform.rotation.w == 1.0 for _, message in topics["/tf"])


@pytest.mark.parametrize("scene", [False, True])
def test_a_team_without_data(tmp_path, scene):
    path = tmp_path / "empty.mcap"
    path.write_bytes(saved(Recording(Team((Robot("R1", 1),))), scene=scene))
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_summary().statistics.message_count == 0
        assert {record.name for record in reader.iter_metadata()} == {"clt.team", "clt.run"}


def test_same_recording_same_bytes(path):
    assert saved(made(), scene=True) == path.read_bytes()


@pytest.mark.parametrize(
    ("stream", "field"),
    [
        ("odometry", "v"),
        ("truth", "x"),
        ("estimate", "heading"),
        ("estimate", "covariance"),
        ("dead_reckoning", "y"),
    ],
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_no_log_holds_values_that_are_not_finite(recording, stream, field, value):
    tracks = dict(getattr(recording, stream))
    values = getattr(tracks["R4"], field).copy()
    values[3] = value
    tracks["R4"] = replace(tracks["R4"], **{field: values})
    with pytest.raises(LogError, match=r"^/R4/.*values are not finite$"):
        saved(replace(recording, **{stream: tracks}))


@pytest.mark.parametrize(("v", "omega"), [(1.0, 0.0), (1.0, 0.5), (-2.0, -1.0), (0.0, 2.0)])
@pytest.mark.parametrize("mean", [True, False])
def test_dead_reckoning_of_a_constant_twist_is_an_arc(v, omega, mean):
    stamp = START + np.cumsum(np.random.default_rng(0).integers(1, 10**8, 100))
    t = (stamp - stamp[0]) * 1e-9
    full = np.full(100, np.nan)
    odometry = Odometry(stamp, stamp, np.full(100, v), np.full(100, omega), full, full)
    x, y, heading = integrate_odometry(odometry, mean)
    radius = v / omega if omega != 0.0 else 0.0
    arc_x = radius * np.sin(omega * t) if omega != 0.0 else v * t
    np.testing.assert_allclose(x, arc_x, atol=1e-12)
    np.testing.assert_allclose(y, radius * (1.0 - np.cos(omega * t)), atol=1e-12)
    np.testing.assert_allclose(heading, omega * t, atol=1e-12)


def test_mean_and_instant_twists_differ_by_half_a_step():
    stamp, v = START + 10**9 * np.arange(3), np.array([5.0, 1.0, 3.0])
    zero = np.zeros(3)
    odometry = Odometry(stamp, stamp, v, zero, zero, zero)
    assert integrate_odometry(odometry, mean=True)[0].tolist() == [0.0, 1.0, 4.0]
    assert integrate_odometry(odometry, mean=False)[0].tolist() == [0.0, 3.0, 5.0]


@pytest.mark.parametrize("n", [0, 1])
def test_dead_reckoning_of_hardly_anything(n):
    empty = np.zeros(n)
    odometry = Odometry(np.full(n, START), np.full(n, START), empty, empty, empty, empty)
    assert all(values.tolist() == [0.0] * n for values in integrate_odometry(odometry, mean=True))
    assert all(values.tolist() == [0.0] * n for values in integrate_odometry(odometry, mean=False))


@pytest.mark.skipif(EVO is None, reason="evo_ape is not installed")
def test_evo_opens_the_log(recording, path, tmp_path):
    results = tmp_path / "results.zip"
    command = [EVO, "mcap", path, "/Robot_3/ground_truth", "/Robot_3/estimate"]
    subprocess.run([*command, "--save_results", results], check=True, capture_output=True)
    shutil.unpack_archive(results, tmp_path)
    stats = json.loads((tmp_path / "stats.json").read_text())
    truth, estimate = recording.truth["Robot_3"], recording.estimate["Robot_3"]
    error = np.hypot(truth.x - estimate.x, truth.y - estimate.y)
    assert stats["rmse"] == pytest.approx(math.sqrt(np.mean(error**2)), abs=1e-9)
    assert stats["max"] == pytest.approx(error.max(), abs=1e-9)
