"""Small logs that claim much: bounded work, one line that names the file."""

from __future__ import annotations

import json
import time
import zlib
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.writer import Writer
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.errors import LogError
from clt.core.printable import printable, printable_name
from clt.core.recording import Robot, Team, UwbPackets
from clt.log.mcap import chunk
from clt.log.mcap.records import MCAP_MAGIC
from clt.log.mcap.write import write_log as write
from clt.log.recording.load import load
from clt.log.recording.packets import packet_channel
from clt.log.recording.summary import info_dict, summarize_recording
from tests.log.logs import odometry_message, pose_message, range_message, write_log
from tests.machine import times_slower

SECOND = 10**9
TIME = 4.0
"""s of this process; each takes less than half a second."""


def typed(text, payload=b"\0\1\0\0" + bytes(64), kind="nav_msgs/msg/Odometry", topic="/R1/odom"):
    """A log of one message whose type is defined by `text`."""
    stream = BytesIO()
    writer = Writer(stream)
    writer.start(profile="ros2", library="tests")
    schema = writer.register_schema(kind, "ros2msg", text.encode())
    writer.add_message(writer.register_channel(topic, "cdr", schema), 1, payload, 1)
    writer.finish()
    return stream.getvalue()


def nested(depth, innermost=""):
    parts = [f"p/E{k + 1} a\np/E{k + 1} b" for k in range(depth)] + [innermost]
    titles = [f"\n{'=' * 80}\nMSG: p/E{k}\n" for k in range(1, depth + 1)]
    return parts[0] + "".join(t + part for t, part in zip(titles, parts[1:], strict=True))


def read(tmp_path, data):
    path = tmp_path / "log.mcap"
    path.write_bytes(data)
    started = time.process_time()
    try:
        return load(path)
    finally:
        assert time.process_time() - started < TIME * times_slower()


@pytest.mark.parametrize(
    "text",
    [
        f"int8[{'9' * 5000}] a",
        "int8[0] a",
        "int8[00000000000] a",
        "p/Foo[1000000000000] z\n===\nMSG: p/Foo\n",
        "p/Foo[999999999] z\n===\nMSG: p/Foo\n",
        "p/Foo[] z\n===\nMSG: p/Foo\nint8[0] a",
        nested(28),
        nested(28, "int8[0] a"),
        "int8 a\n" * 100_000,
        "float64[999999999] twist",
        "\x1b[2J\nclt: error: fake",
    ],
)
def test_definitions_that_claim_much(tmp_path, text):
    with pytest.raises(LogError, match=r"log\.mcap") as caught:
        read(tmp_path, typed(text))
    assert len(str(caught.value)) < 1000
    assert str(caught.value).isprintable()


def test_a_covariance_that_claims_much(tmp_path):
    text = "\n".join(f"float64 {n}" for n in ("x", "y")) + "\nfloat64[999999999] covariance"
    text = f"p/P pose\n===\nMSG: p/P\n{text}"
    with pytest.raises(LogError):
        read(tmp_path, typed(text, kind="geometry_msgs/msg/PoseWithCovarianceStamped"))


@pytest.mark.parametrize("kind", ["float64[3]", "float64", "string[2]", "p/Foo", "wstring"])
def test_a_frame_id_that_is_no_text(tmp_path, kind):
    fields = "".join(f"float64 {n}\n" for n in "xyzw")
    text = (
        "p/H header\ngeometry_msgs/Pose pose\n===\nMSG: p/H\n"
        f"builtin_interfaces/Time stamp\n{kind} frame_id\n===\nMSG: p/Foo\nint8 a\n"
        f"===\nMSG: geometry_msgs/Pose\np/V position\np/V orientation\n===\nMSG: p/V\n{fields}"
    )
    data = typed(text, bytes([0, 1]) + bytes(400), "geometry_msgs/msg/PoseStamped", "/R1/estimate")
    with pytest.raises(LogError, match=r"log\.mcap.*frame_id"):
        read(tmp_path, data)


def test_digits_in_topics_and_names(tmp_path):
    topics = {
        "/R1/odom": ("odometry", [(SECOND, odometry_message(SECOND, 1.0, 0.0))]),
        f"/R{'9' * 5000}/odom": ("odometry", [(SECOND, odometry_message(SECOND, 1.0, 0.0))]),
    }
    loaded = read(tmp_path, write_log(topics))
    assert len(loaded.recording.odometry) == 2


def test_thousands_of_channels(tmp_path):
    message = range_message(SECOND, 1, 2, 3.0)
    topics = {f"/x{k}": ("range", [(SECOND, message)]) for k in range(4000)}
    topics["/R1/uwb/range"] = ("range", [(SECOND, message)])
    data = write_log(topics, options={"chunk_size": 1 << 20})
    loaded = read(tmp_path, data)
    assert len(loaded.topics) == 4001
    assert len(loaded.recording.ranges.stamp) == 1


def test_thousands_of_channels_before_their_schema(tmp_path):
    """Each waits; looking at all of them for each new one would take minutes."""
    builder = RecordBuilder()
    records.Header("ros2", "tests").write(builder)
    for number in range(1, 8_001):
        records.Channel(number, f"/R{number}/odom", "cdr", {}, 1 + number % 7).write(builder)
    for number in range(1, 8):
        records.Schema(number, b"int32 a", "ros2msg", "a/msg/B").write(builder)
    records.Message(1, 0, b"\0\1\0\0\1\0\0\0", 0, 0).write(builder)
    with pytest.raises(LogError, match=r"log\.mcap"):
        read(tmp_path, MCAP_MAGIC + bytes(builder.end()))


def test_a_zip_bomb_ends_early(tmp_path, monkeypatch):
    """Chunks beyond the limit are faults; what stands beside them is read."""
    monkeypatch.setattr(chunk, "FREE_INFLATED_BYTES", 1 << 20)
    monkeypatch.setattr("clt.log.mcap.record_stream.FREE_INFLATED_BYTES", 1 << 20)
    row = b"\x05" + (22 + 4096).to_bytes(8, "little") + bytes(22 + 4096)
    big = row * 128
    packed = zstandard.compress(big)
    builder = RecordBuilder()
    for _ in range(20):
        records.Chunk("zstd", packed, 0, 0, zlib.crc32(big), len(big)).write(builder)
    sound = write_log({"/R1/uwb/range": ("range", [(SECOND, range_message(SECOND, 1, 2, 3.0))])})
    at = sound.index(b"\x01") + 9 + int.from_bytes(sound[9:17], "little")
    loaded = read(tmp_path, sound[:at] + bytes(builder.end()) + sound[at:])
    assert len(loaded.recording.ranges.stamp) == 1
    faults = [fault for fault in loaded.recording.faults if fault.kind == "chunk"]
    assert sum(fault.count for fault in faults) >= 17
    assert "log.mcap" in faults[0].text
    assert "zip bomb" in faults[0].text


def test_one_long_frame_id_among_many_poses(tmp_path):
    poses = [
        (k, pose_message(k, 1.0, 2.0, frame="w" * 10**6 if k == 9 else "world"))
        for k in range(1, 3000)
    ]
    loaded = read(tmp_path, write_log({"/R1/ground_truth": ("pose", poses)}))
    assert len(loaded.recording.truth["R1"].stamp) == 2998
    assert max(len(fault.text) for fault in loaded.recording.faults) < 1000


@pytest.mark.parametrize(
    "value", ["1e400", "[1, -1e999]", "NaN", "9" * 5000, "[" * 900 + "]" * 900, '"\\ud800"']
)
def test_run_records_that_are_no_plain_json(tmp_path, value):
    data = write_log(
        {"/R1/uwb/range": ("range", [(SECOND, range_message(SECOND, 1, 2, 3.0))])},
        [("clt.run", {"seed": value})],
    )
    loaded = read(tmp_path, data)
    json.dumps(info_dict(loaded, summarize_recording(loaded.recording)), allow_nan=False, indent=1)


@pytest.mark.parametrize("place", ["antenna", "position", "id", "sigma_v"])
@pytest.mark.parametrize("value", ["9" * 4000, "1e999", "[[[[1]]]]", "NaN", "true"])
def test_team_records_with_wild_numbers(tmp_path, place, value):
    value = f"[{value}, 0]" if place in {"antenna", "position"} else value
    data = write_log(
        {"/R1/uwb/range": ("range", [(SECOND, range_message(SECOND, 1, 2, 3.0))])},
        [("clt.team", {"robots": f'[{{"name": "R1", "id": 1, "{place}": {value}}}]'})],
    )
    with pytest.raises(LogError, match=rf"log\.mcap.*{place}"):
        read(tmp_path, data)


def test_nothing_of_a_log_moves_the_cursor(tmp_path):
    evil = "a\x1b]0;pwned\x07\n\u202eclt: error: fake\x9b2J"
    data = write_log(
        {
            "/R1/uwb/range": ("range", [(SECOND, range_message(SECOND, 1, 2, 3.0))]),
            f"/{evil}": ("range", []),
            "/R1/ground_truth": (
                "pose",
                [(k, pose_message(k, 0, 0, frame=f"{evil}{k % 2}")) for k in range(1, 9)],
            ),
        },
        [("clt.run", {"command": evil, "filter": evil}), (evil, {evil: evil})],
        [(evil, evil, b"")],
    )
    path = tmp_path / "log.mcap"
    path.write_bytes(data.replace(b"tests", b"\x1b[2Jt"))
    found = CliRunner().invoke(app, ["info", str(path)])
    assert found.exit_code == 3
    for line in (found.stdout + found.stderr).splitlines():
        assert line.isprintable()
        assert not line.startswith("clt: error")
    assert "\\x1b]0;pwned" in found.stdout


def test_text_is_made_printable():
    assert printable("plain äöü 你好") == "plain äöü 你好"
    assert printable("a\x1b[31m\r\nb\u202e\x9b\u2028\ud800") == (
        "a\\x1b[31m\\r\\nb\\u202e\\x9b\\u2028\\ud800"
    )
    assert len(printable("x" * 10**6)) < 4100
    assert printable_name("x" * 200) == "x" * 50 + "..." + "x" * 50


def test_a_command_says_when_memory_runs_out(tmp_path, monkeypatch):
    def gone(*_, **__):
        raise MemoryError

    monkeypatch.setattr("clt.log.recording.load.load", gone)
    path = tmp_path / "log.mcap"
    path.write_bytes(b"")
    found = CliRunner().invoke(app, ["info", str(path)])
    assert found.exit_code == 1
    assert found.stderr.count("\n") == 1
    assert "log.mcap" in found.stderr
    assert "memory" in found.stderr


def test_packets_of_a_team_too_large(tmp_path, monkeypatch):
    """Receptions are a table of packets by robots; a team of thousands may ask for all memory."""
    monkeypatch.setattr("clt.log.recording.packets.MAX_PACKET_ENTRIES", 100)
    robots = [{"name": f"R{k}", "id": k} for k in range(1, 102)]
    team = Team(tuple(Robot(robot["name"], robot["id"]) for robot in robots))
    one, none = np.array([SECOND]), np.full((1, len(robots)), -1)
    zero = np.zeros(1, np.int64)
    x = np.zeros(1)
    frames = UwbPackets(one, one, zero, zero, zero, none, none, zero - 1, x * np.nan, x * np.nan)
    few = replace(frames, receive=none[:, :2], heard=none[:, :2])
    channel = packet_channel(Team(team.robots[:2]), 0, few)
    file = BytesIO()
    write(file, [channel], {"clt.team": {"robots": json.dumps(robots)}})
    with pytest.raises(LogError, match=r"log\.mcap: /R1/uwb/frame: 1 packets among 101 robots"):
        read(tmp_path, file.getvalue())
