"""`clt record` end to end: files, standard input, sockets, pseudo-terminals, signals, crashes."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import pty
import random
import signal
import socket
import subprocess
import threading
import time
import tty
from contextlib import chdir
from itertools import count, islice
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.load import load
from tests.devices.streams import (
    ended,
    odometry_line,
    range_line,
    rcl_inertial,
    rcl_range,
    rcl_wheels,
    start,
    until,
)


def run(folder, *words, code=0):
    with chdir(folder):
        done = CliRunner().invoke(app, ["record", *words])
    assert done.exit_code == code, (done.output, done.exception)
    return done


def messages(path):
    """Topic, log time, publish time, payload of every message, by the official reader."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in reader.iter_messages(log_time_order=False)
        ]


def figures(text):
    return json.loads(text)["sources"]


def ndjson(seconds=2.0, rate=50):
    """Ranges of a pair and odometry of one robot."""
    lines = b""
    for k in range(int(seconds * rate)):
        lines += odometry_line(5.0 + k / rate) + range_line(5.0 + k / rate, k)
    return lines


def test_a_file_as_fast_as_possible(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson())
    words = ["-o", "o.mcap", "--source", "net=file:in.json,proto=ndjson", "--epoch", "1000"]
    done = run(tmp_path, *words, "--json")
    found = figures(done.stdout)["net"]
    assert (found["frames"], found["samples"], found["lost"]) == (200, 200, 0)
    assert (found["skipped_bytes"], found["tail_bytes"], found["bad_frames"]) == (0, 0, 0)
    assert found["first_stamp_ns"] == 1000 * 10**9
    recording = load(tmp_path / "o.mcap").recording
    assert recording.faults == ()
    assert recording.team.names == ("R1", "R2")
    assert [robot.static for robot in recording.team.robots] == [False, True]
    assert recording.ranges.stamp.tolist() == [10**12 + k * 20_000_000 for k in range(100)]
    assert recording.ranges.range.tolist() == [1.0 + 0.001 * k for k in range(100)]
    assert recording.odometry["R1"].omega.tolist() == [0.1] * 100
    assert list(tmp_path.glob(".*")) == []


def test_a_log_that_was_recorded_opens_elsewhere(tmp_path):
    (tmp_path / "in.bin").write_bytes(
        b"".join(
            rcl_inertial(10 * k, 0, 1, 2, 3, 4, 5, 6)
            + rcl_range(10 * k, 0, 1, 2.0)
            + rcl_wheels(10 * k, 0, 10, 0.01, 0.001)
            for k in range(50)
        )
    )
    run(tmp_path, "-o", "o.mcap", "--source", "uwb=file:in.bin,proto=rcl,map=0:R1+1:R2")
    log = tmp_path / "o.mcap"
    times = [log_time for _, log_time, _, _ in messages(log)]
    assert times == sorted(times)
    with AnyReader([log]) as reader:
        kinds = {connection.topic: connection.msgtype for connection in reader.connections}
        assert kinds == {
            "/raw/uwb": "clt_msgs/msg/RawBytes",
            "/clt/clock/uwb": "clt_msgs/msg/ClockMap",
            "/R1/imu": "sensor_msgs/msg/Imu",
            "/R1/uwb/range": "clt_msgs/msg/Range",
            "/R1/odom": "nav_msgs/msg/Odometry",
        }
        found = {
            connection.topic: reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages()
        }
    assert found["/R1/imu"].header.frame_id == "R1/base_link"
    acceleration, rate = found["/R1/imu"].linear_acceleration, found["/R1/imu"].angular_velocity
    assert [acceleration.y, acceleration.z] == pytest.approx(
        [2 * acceleration.x, 3 * acceleration.x]
    )
    assert [rate.y * 4, rate.z * 4] == pytest.approx([5 * rate.x, 6 * rate.x])
    assert acceleration.x > 0 < rate.x
    assert found["/R1/imu"].orientation_covariance.tolist() == [-1.0, *[0.0] * 8]
    assert found["/R1/odom"].twist.twist.linear.x == pytest.approx(1.0)
    assert found["/R1/odom"].pose.pose.position.x == pytest.approx(0.49, abs=0.01)
    assert found["/R1/uwb/range"].raw_range == 2.0
    assert bytes(found["/raw/uwb"].data) == (tmp_path / "in.bin").read_bytes()


def test_decoding_again_gives_the_same(tmp_path):
    data = ndjson(1.0)
    (tmp_path / "in.json").write_bytes(data[:3000] + b"{boot\n" + data[3000:] + b'{"type"')
    words = ["--source", "net=file:in.json,proto=ndjson", "-o", "o.mcap", "--json"]
    first = figures(run(tmp_path, *words, code=3).stdout)
    again = run(tmp_path, "--from", "o.mcap", "-o", "again.mcap", "--json", code=3)
    assert figures(again.stdout) == first
    assert messages(tmp_path / "again.mcap") == messages(tmp_path / "o.mcap")


def test_decoding_again_by_other_words(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson(1.0))
    run(tmp_path, "-o", "o.mcap", "--source", "net=file:in.json,proto=ndjson")
    words = ["--from", "o.mcap", "-o", "p.mcap", "--source"]
    run(tmp_path, *words, "net=file:in.json,proto=ndjson,map=R1:car+R2:mast")
    assert load(tmp_path / "p.mcap").recording.team.names == ("car", "mast")
    done = run(tmp_path, *words, "gps=file:in.json,proto=ndjson", "--force", code=2)
    assert "the log has no bytes of it; it has net" in done.stderr
    (tmp_path / "plain.mcap").write_bytes((tmp_path / "o.mcap").read_bytes())
    done = run(tmp_path, "--from", "in.json", "-o", "q.mcap", code=1)
    assert done.stderr.count("\n") == 1


def test_an_id_that_the_map_lacks_is_counted_and_kept_raw(tmp_path):
    lines = range_line(1.0, 0) + range_line(1.1, 1, "R1", "R7") + range_line(1.2, 2)
    (tmp_path / "in.json").write_bytes(lines)
    words = ["-o", "o.mcap", "--source", "net=file:in.json,proto=ndjson,map=R1:A+R2:B"]
    done = run(tmp_path, *words)
    assert "its map lacks R7 (1)" in done.stderr
    assert len(load(tmp_path / "o.mcap").recording.ranges.stamp) == 2


def test_steering_gives_the_turn_rate(tmp_path):
    speeds = b"".join(
        f"(1000.{k:02d}0000) can0 00000901#00001206007B00B9\n".encode() for k in range(50)
    )
    angles = b"".join(
        json.dumps({"type": "steer", "node": "car", "angle": 0.2, "t": 7 + 0.01 * k}).encode()
        + b"\n"
        for k in range(50)
    )
    (tmp_path / "speeds.txt").write_bytes(speeds)
    (tmp_path / "angles.json").write_bytes(angles)
    can = "odo=candump:speeds.txt,proto=vesc-can,map=1:car"
    steer = "turn=file:angles.json,proto=ndjson"
    done = run(tmp_path, "-o", "a.mcap", "--source", f"{can},steer=turn", "--source", steer)
    omega = load(tmp_path / "a.mcap").recording.odometry["car"].omega
    known = omega[-20:]
    assert known == pytest.approx(1.0 * 0.20271 / 0.25, rel=1e-3)
    assert done.exit_code == 0
    done = run(tmp_path, "-o", "b.mcap", "--source", can)
    assert "the turn rate of 50 samples is unknown" in done.stderr
    odometry = load(tmp_path / "b.mcap").recording.odometry["car"]
    assert odometry.omega.tolist() == [0.0] * 50
    assert odometry.sigma_omega.tolist() == [1000.0] * 50
    assert odometry.v == pytest.approx(1.0, abs=1e-3)


def test_a_team_file(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson(0.2))
    (tmp_path / "team.toml").write_text(
        "[robots.R2]\nstatic = true\nposition = [1.0, 2.5]\n[robots.R1]\nantenna = [0.1, 0.0]\n"
    )
    words = ["-o", "o.mcap", "--team", "team.toml", "--source", "net=file:in.json,proto=ndjson"]
    run(tmp_path, *words)
    one, other = load(tmp_path / "o.mcap").recording.team.robots
    assert (one.name, one.position, one.id) == ("R2", (1.0, 2.5), 2)
    assert (other.name, other.antenna, other.static) == ("R1", (0.1, 0.0), False)


def test_parts_lose_nothing(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson(40.0))
    words = ["--source", "net=file:in.json,proto=ndjson", "--epoch", "1000"]
    run(tmp_path, "-o", "whole.mcap", *words)
    done = run(tmp_path, "-o", "part.mcap", "--split-size", "20kB", *words, "--json")
    logs = json.loads(done.stdout)["logs"]
    assert len(logs) >= 3
    parts = [messages(tmp_path / name) for name in logs]

    def kept(found):
        return [(topic, data) for topic, _, _, data in found if topic.startswith("/R")]

    assert [one for part in parts for one in kept(part)] == kept(messages(tmp_path / "whole.mcap"))
    for name in logs[1:]:
        assert load(tmp_path / name).recording.team.names == ("R1", "R2")
    done = run(tmp_path, "-o", "part.mcap", "--split-size", "20kB", *words, code=1)
    assert "part_000.mcap: exists" in done.stderr


def test_nothing_understood_ends_with_1(tmp_path):
    (tmp_path / "in.bin").write_bytes(b"no frames at all\n" * 100)
    done = run(tmp_path, "-o", "o.mcap", "--source", "uwb=file:in.bin,proto=rcl", code=1)
    assert "1700 bytes, but nothing decodes as rcl: wrong protocol or baud?" in done.stderr
    assert len(messages(tmp_path / "o.mcap")) == 1


def test_count_ends_it_exactly(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson())
    words = ["--source", "net=file:in.json,proto=ndjson", "--count", "31"]
    run(tmp_path, "-o", "o.mcap", *words)
    topics = [topic for topic, *_ in messages(tmp_path / "o.mcap")]
    assert sum(topic.startswith("/R") for topic in topics) == 31


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "no source given"),
        (["--source", "x"], "write NAME=URL,proto=P"),
        (["--source", "x=file:in,proto=rlc"], "did you mean `rcl`"),
        (["--source", "x=file:in"], "`proto` is missing"),
        (["--source", "x=fiel:in,proto=rcl"], "did you mean `file`"),
        (["--source", "x=file:in?rate=a,proto=rcl"], "rate=a is not a number"),
        (["--source", "x=file:in?speed=1,proto=rcl"], "unknown key `speed`"),
        (["--source", "x=udp:localhost,proto=rcl"], "no port"),
        (["--source", "x=file:in,proto=rcl,map=0-R1"], "`0-R1` is not ID:ROBOT"),
        (["--source", "x=file:in,proto=rcl,map=t0:R1"], "`t0` is no id"),
        (["--source", "x=file:in,proto=rcl,bode=1"], "unknown key `bode`"),
        (["--source", "x=file:in,proto=rcl,steer=y"], "steer=y is no source"),
        (["--source", "x=file:in,proto=rcl", "--source", "x=file:in,proto=rcl"], "given twice"),
        (["--source", "x=file:in,proto=rcl", "--duration", "-1"], "--duration"),
        (["--source", "x=file:in,proto=rcl", "--split-size", "many"], "--split-size many"),
        (["--source", "x=file:in,proto=rcl", "--min-free", "1 PB"], "--min-free"),
        (["--source", "x=file:in,proto=rcl", "--team", "none.toml"], "none.toml"),
    ],
)
def test_wrong_words_are_refused_in_one_line(tmp_path, words, said):
    (tmp_path / "in").write_bytes(b"")
    done = run(tmp_path, "-o", "o.mcap", *words, code=2)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o.mcap").exists()


def test_a_source_that_does_not_open(tmp_path):
    for url in ("file:none.bin", "serial:/dev/none", "udp:203.0.113.7:9"):
        done = run(tmp_path, "-o", "o.mcap", "--source", f"x={url},proto=rcl", code=1)
        assert f"source x: {url}: " in done.stderr
        assert done.stderr.count("\n") == 1
        assert not (tmp_path / "o.mcap").exists()


def test_an_existing_log_is_not_overwritten(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson(0.2))
    (tmp_path / "o.mcap").write_bytes(b"mine")
    words = ["-o", "o.mcap", "--source", "net=file:in.json,proto=ndjson"]
    run(tmp_path, *words, code=1)
    assert (tmp_path / "o.mcap").read_bytes() == b"mine"
    run(tmp_path, *words, "--force")
    assert len(messages(tmp_path / "o.mcap")) > 10


def test_standard_input_and_output(tmp_path):
    words = ["-o", "-", "--source", "net=-,proto=ndjson"]
    process = start(tmp_path, *words, stdin=subprocess.PIPE)
    out, error = process.communicate(ndjson(1.0), timeout=60)
    assert process.returncode == 0, error
    with io.BytesIO(out) as file:
        assert make_reader(file).get_summary().statistics.message_count == 102
    assert b"100 frames" in error


@pytest.fixture
def terminal():
    """A pseudo-terminal: the device's end, and the name of the other."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


class Talker:
    """Writes lines at 2000 a second until it is closed."""

    def __init__(self, write, rate=2000):
        self.write, self.rate = write, rate
        self.said = 0
        self.closed = False
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self):
        begin = time.monotonic()
        while not self.closed:
            due = int((time.monotonic() - begin) * self.rate)
            lines = b"".join(range_line(k / self.rate, k) for k in range(self.said, due))
            try:
                self.write(lines)
            except OSError:
                return
            self.said = max(due, self.said)
            time.sleep(0.005)

    def close(self):
        self.closed = True
        self.thread.join(5)


def test_a_pseudo_terminal_and_ctrl_c(tmp_path, terminal):
    master, name = terminal
    words = ["-o", "o.mcap", "--source", f"net=serial:{name},proto=ndjson", "--json"]
    process = start(tmp_path, *words)
    until((tmp_path / "o.mcap").exists, process)
    for k in range(100):
        os.write(master, range_line(50.0 + 0.01 * k, k))
        time.sleep(0.01)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    found = figures(ended(process)[0])["net"]
    assert (found["frames"], found["lost"], found["reconnects"]) == (100, 0, 0)
    ranges = load(tmp_path / "o.mcap").recording.ranges
    assert ranges.sequence.tolist() == list(range(100))
    steps = (ranges.stamp[1:] - ranges.stamp[:-1]) * 1e-9
    assert np.median(steps) == pytest.approx(0.01, abs=1e-4)
    assert (ranges.stamp <= ranges.log_time + 1000).all()


def test_unplugged_and_plugged_in_again(tmp_path):
    link = tmp_path / "device"

    def plug():
        master, slave = pty.openpty()
        tty.setraw(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(os.ttyname(slave))
        return master, slave

    master, slave = plug()
    words = ["-o", "o.mcap", "--source", f"net=serial:{link},proto=ndjson", "--json"]
    process = start(tmp_path, *words)
    until((tmp_path / "o.mcap").exists, process)
    for k in range(40):
        os.write(master, range_line(0.01 * k, k))
        time.sleep(0.01)
    time.sleep(0.3)
    os.close(master)
    os.close(slave)
    link.unlink()
    time.sleep(0.5)
    master, slave = plug()
    talker = Talker(lambda data: os.write(master, data), rate=100)
    time.sleep(4.0)
    process.send_signal(signal.SIGTERM)
    out, error = ended(process, 3)
    talker.close()
    found = figures(out)["net"]
    assert found["reconnects"] == 1
    assert found["frames"] > 100
    assert "source net: lost: " in error
    assert "source net: back after " in error
    text = b" ".join(
        data for topic, *_, data in messages(tmp_path / "o.mcap") if topic == "/clt/log"
    )
    assert b"back after" in text
    os.close(master)
    os.close(slave)
    process = run(tmp_path, "--from", "o.mcap", "-o", "again.mcap", "--json", code=0)
    for key in ("frames", "samples", "skipped_bytes", "first_stamp_ns", "last_stamp_ns"):
        assert figures(process.stdout)["net"][key] == found[key]
    assert figures(process.stdout)["net"]["reconnects"] == 1


def free_port(kind=socket.SOCK_STREAM):
    with socket.socket(socket.AF_INET, kind) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def test_udp_and_the_end_by_duration(tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    words = ["--source", f"net=udp:127.0.0.1:{port},proto=ndjson", "--duration", "2", "--json"]
    process = start(tmp_path, "-o", "o.mcap", *words)
    until((tmp_path / "o.mcap").exists, process)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for k in range(50):
            device.sendto(range_line(0.01 * k, k), ("127.0.0.1", port))
    found = figures(ended(process)[0])["net"]
    assert (found["frames"], found["lost"]) == (50, 0)


def test_a_tcp_server_and_clients(tmp_path):
    server = socket.create_server(("127.0.0.1", 0))
    port, other = server.getsockname()[1], free_port()
    words = ["-o", "o.mcap", "--json", "--source", f"net=tcp:127.0.0.1:{port},proto=ndjson"]
    words += ["--source", f"all=tcp-listen:127.0.0.1:{other},proto=ndjson"]
    process = start(tmp_path, *words)
    device, _ = server.accept()
    until((tmp_path / "o.mcap").exists, process)
    first = socket.create_connection(("127.0.0.1", other))
    second = socket.create_connection(("127.0.0.1", other))
    for k in range(30):
        line = range_line(0.01 * k, k)
        device.sendall(line[:10])
        first.sendall(line[:20])
        second.sendall(range_line(0.01 * k, k, "R3", "R4"))
        time.sleep(0.01)
        first.sendall(line[20:])
        device.sendall(line[10:])
    first.close()
    second.close()
    time.sleep(0.3)
    process.send_signal(signal.SIGHUP)
    found = figures(ended(process)[0])
    assert (found["net"]["frames"], found["all"]["frames"]) == (30, 60)
    assert (found["all"]["bad_frames"], found["all"]["skipped_bytes"]) == (0, 0)
    topics = {topic for topic, *_ in messages(tmp_path / "o.mcap")}
    assert {"/raw/net", "/raw/all", "/raw/all/2", "/R3/uwb/range"} <= topics
    device.close()
    server.close()


def test_a_full_disk_ends_with_a_log_that_opens(tmp_path):
    port = free_port(socket.SOCK_DGRAM)
    source = f"net=udp:127.0.0.1:{port},proto=ndjson"
    process = start(tmp_path, "-o", "o.mcap", "--source", source, limit_blocks=600)
    until((tmp_path / "o.mcap").exists, process)
    device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    noise = random.Random(1)
    lines = (range_line(0.001 * k, k, distance=noise.random()) for k in count())

    def send(data):
        if data != b"":
            device.sendto(b"".join(islice(lines, 8)), ("127.0.0.1", port))

    talker = Talker(send)
    out, error = ended(process, 3)
    talker.close()
    device.close()
    assert "o.mcap: the disk is full; ended" in error
    assert (tmp_path / "o.mcap").stat().st_size <= 600 * 512
    assert len(messages(tmp_path / "o.mcap")) > 1000
    assert load(tmp_path / "o.mcap").recording.faults == ()
    del out


@pytest.mark.parametrize("delay", [0.3, 1.9, 2.4, 3.1, 3.6])
def test_killed_while_2000_messages_a_second_arrive(tmp_path, delay):
    """What was sent until a flush and a second (of a busy computer) before the end is there.

    `python -m tests.fuzz.crashes` is stricter.
    """
    port = free_port(socket.SOCK_DGRAM)
    words = ["--source", f"net=udp:127.0.0.1:{port},proto=ndjson", "--flush", "0.5"]
    process = start(tmp_path, "-o", "o.mcap", *words)
    until((tmp_path / "o.mcap").exists, process)
    device = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    history = []

    def send(data):
        lines = data.splitlines(keepends=True)
        for at in range(0, len(lines), 20):
            device.sendto(b"".join(lines[at : at + 20]), ("127.0.0.1", port))
        history.append((time.monotonic(), len(lines)))

    talker = Talker(send)
    time.sleep(delay)
    killed = time.monotonic()
    process.kill()
    process.communicate()
    talker.close()
    device.close()
    with chdir(tmp_path):
        done = CliRunner().invoke(app, ["recover", "o.mcap", "-o", "saved.mcap", "-q"])
    if delay > 1.0:
        assert done.exit_code in {0, 3}, done.output
    sent = sum(n for at, n in history if at < killed - 1.5)
    kept = 0
    if (tmp_path / "saved.mcap").exists():
        kept = sum(t == "/R1/uwb/range" for t, *_ in messages(tmp_path / "saved.mcap"))
    assert kept >= sent


CAPTURE = Path(__file__).parents[3] / "../shared/data/thu_rcl_20190418/static_20190614_test.txt.gz"


@pytest.mark.skipif(not CAPTURE.exists(), reason="the capture of a real sniffer is not here")
def test_a_real_capture_and_the_same_again(tmp_path):
    data = gzip.decompress(CAPTURE.read_bytes())
    (tmp_path / "in.bin").write_bytes(data)
    words = ["-o", "o.mcap", "--source", "uwb=file:in.bin,proto=rcl", "--json"]
    found = figures(run(tmp_path, *words, code=3).stdout)["uwb"]
    assert (found["bytes"], found["frames"], found["samples"]) == (len(data), 169_689, 169_689)
    assert (found["skipped_bytes"], found["tail_bytes"], found["bad_frames"]) == (34, 15, 0)
    again = run(tmp_path, "--from", "o.mcap", "-o", "again.mcap", "--json", code=3)
    assert figures(again.stdout)["uwb"] == found
    with (tmp_path / "o.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    topics = {number: channel.topic for number, channel in summary.channels.items()}
    counts = {
        topics[number]: count for number, count in summary.statistics.channel_message_counts.items()
    }
    assert sum(count for topic, count in counts.items() if topic.endswith("range")) == 97_897
    assert sum(count for topic, count in counts.items() if topic.endswith("imu")) == 65_265
    assert sum(count for topic, count in counts.items() if topic.endswith("odom")) == 6_527
    with (tmp_path / "o.mcap").open("rb") as one, (tmp_path / "again.mcap").open("rb") as other:
        pairs = zip(
            make_reader(one).iter_messages(log_time_order=False),
            make_reader(other).iter_messages(log_time_order=False),
            strict=True,
        )
        assert all(a[2].data == b[2].data and a[1].topic == b[1].topic for a, b in pairs)


def test_captured_bytes_are_never_overwritten(tmp_path):
    (tmp_path / "in.json").write_bytes(ndjson(0.2))
    words = ["--source", "net=file:in.json,proto=ndjson", "--force"]
    done = run(tmp_path, "-o", "in.json", *words, code=1)
    assert "is also an input" in done.stderr
    assert (tmp_path / "in.json").read_bytes() == ndjson(0.2)
    run(tmp_path, "-o", "o.mcap", *words)
    log = load(tmp_path / "o.mcap").recording
    digest = hashlib.sha256(ndjson(0.2)).hexdigest()
    assert json.loads(log.run["inputs"]) == {"in.json": digest}


def test_nobody_reads_what_is_said_any_more(tmp_path):
    """Standard error that is closed ends no recording: it goes on and is ended in order."""
    port = free_port(socket.SOCK_DGRAM)
    words = ["-o", "o.mcap", "--source", f"net=udp:127.0.0.1:{port},proto=ndjson", "--json"]
    process = start(tmp_path, *words)
    until((tmp_path / "o.mcap").exists, process)
    process.stderr.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
        for begin in (100.0, 0.0):  # A device that begins again is reported.
            for k in range(20):
                device.sendto(range_line(begin + 0.01 * k, k), ("127.0.0.1", port))
                time.sleep(0.01)
    time.sleep(0.5)
    process.send_signal(signal.SIGHUP)
    out = process.stdout.read().decode()
    assert process.wait() == 0
    process.stdout.close()
    assert figures(out)["net"]["frames"] == 40
    said = [data for topic, *_, data in messages(tmp_path / "o.mcap") if topic == "/clt/log"]
    assert b"began again" in b"".join(said)


@pytest.mark.parametrize("text", [b"x" * 100 + b"\n" + range_line(1.0)[:-1], range_line(1.0)[:-1]])
def test_a_last_line_without_an_end_is_the_same_again(tmp_path, text):
    """Its message keeps its log time: it arrived with the latest bytes, not at the end."""
    pipe = start(tmp_path, "-o", "o.mcap", "--source", "a=-,proto=ndjson", stdin=subprocess.PIPE)
    pipe.stdin.write(text)
    pipe.stdin.flush()
    until((tmp_path / "o.mcap").exists, pipe)
    time.sleep(0.3)
    pipe.stdin.close()
    pipe.wait()
    pipe.stdout.close()
    pipe.stderr.close()
    run(tmp_path, "--from", "o.mcap", "-o", "again.mcap")
    assert messages(tmp_path / "again.mcap") == messages(tmp_path / "o.mcap")
    assert "/R1/uwb/range" in [topic for topic, *_ in messages(tmp_path / "o.mcap")]


def test_a_source_that_is_mute_is_named(tmp_path):
    (tmp_path / "in.json").write_bytes(range_line(1.0))
    (tmp_path / "empty").write_bytes(b"")
    words = ["--source", "a=file:in.json,proto=ndjson", "--source", "b=file:empty,proto=ndjson"]
    done = run(tmp_path, "-o", "o.mcap", "--json", *words)
    assert json.loads(done.stdout)["warnings"] == ["source b: not one byte arrived"]


def test_powers_on_a_line_of_their_own_make_no_frame(tmp_path):
    """They do not stretch the time between frames."""
    lines = [
        f"AT+RANGE=tid:1,mask:01,seq:{k},range:(30,0,0,0,0,0,0,0),\nrssi:(-70,0,0,0,0,0,0,0)\n"
        for k in range(5)
    ]
    (tmp_path / "in").write_text("".join(lines))
    done = run(tmp_path, "-o", "o.mcap", "--json", "--source", "a=file:in,proto=makerfabs")
    found = figures(done.stdout)["a"]
    assert (found["frames"], found["skipped_bytes"]) == (5, 0)
    assert found["last_stamp_ns"] - found["first_stamp_ns"] == 400_000_000
