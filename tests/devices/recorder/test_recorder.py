"""The recorder with sources and clocks of the test's own."""

from __future__ import annotations

import json
import struct
import time
from contextlib import suppress
from math import tan

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader

from clt.cli.messages.render import diagnostic_text
from clt.devices.decoders.lines import LineDecoder
from clt.devices.intake.intake import Intake
from clt.devices.intake.summary import summary_diagnostics
from clt.devices.intake.team import GrowingTeam
from clt.devices.recorder import recorder as module
from clt.devices.recorder.inbox import Dropped, Inbox, Opened
from clt.devices.recorder.recorder import Recorder
from clt.devices.recorder.status import RecorderOptions
from clt.devices.source_spec import parse_source
from clt.devices.sources.source import Chunk, DisconnectedError, Joined, SourceKind
from clt.devices.sources.table import SOURCES
from clt.devices.stamping.host_clock import HostClock, SystemTime
from clt.devices.storage.log_parts import LogParts
from clt.log.recording.load import load
from tests.devices.clocks import FakeTime
from tests.devices.streams import range_line


class Script:
    """A source that does one thing after another: bytes, errors, functions."""

    def __init__(self, *steps):
        self.steps = list(steps)
        self.lost = 0
        self.written = []
        self.clock = None
        self.opened = 0

    def open(self, _url, opening):
        self.opened += 1
        self.clock = opening.clock
        if len(self.steps) > 0 and self.steps[0] == "refuse":
            self.steps.pop(0)
            raise DisconnectedError("not there")
        return self

    def read(self, timeout_s):
        if len(self.steps) == 0:
            raise EOFError
        step = self.steps.pop(0)
        if isinstance(step, Exception):
            raise step
        if callable(step):
            step = step()
        if isinstance(step, Chunk | Joined):
            return [step]
        if step is None:
            self.clock.host.sleep(timeout_s)
            return []
        return [Chunk(self.clock.now_ns(), step)]

    def write(self, data):
        self.written.append(data)

    def close(self):
        pass


@pytest.fixture
def record(tmp_path, monkeypatch):
    """Record scripts until they end; the recorder's findings, tallies and messages."""

    def run(
        *scripts,
        options=None,
        host=None,
        inbox=None,
        waits=False,
        words="proto=ndjson",
        flush_s=1.0,
        listens=False,
    ):
        specs = []
        for number, script in enumerate(scripts):
            kind = SourceKind(
                script.open, lambda _: None, reconnects=True, waits=waits, listens=listens
            )
            monkeypatch.setitem(SOURCES, f"s{number}", kind)
            specs.append(parse_source(f"x{number}=s{number}:here,{words}"))
        clock = HostClock(host or SystemTime())
        events = []
        recorder = Recorder(
            specs,
            options or RecorderOptions(stall_s=0.0),
            clock,
            words=diagnostic_text,
            on_event=events.append,
            on_status=lambda _: None,
            inbox=inbox,
        )
        for script in scripts:
            script.recorder = recorder
        recorder.open()
        parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}}, force=True, flush_s=flush_s)
        intake = Intake(parts, specs, GrowingTeam(), clock.now_ns())
        recorder.run(intake, parts)
        with (tmp_path / "o.mcap").open("rb") as file:
            found = [
                (channel.topic, message.log_time, message.data)
                for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
            ]
        assert [time for _, time, _ in found] == sorted(time for _, time, _ in found)
        return events, intake.tallies, found

    return run


def kinds(events):
    return [(one.kind, one.subject) for one in events]


def raw(found, name="x0"):
    """What was kept of the bytes, chunk by chunk."""
    return [data[16:] for topic, _, data in found if topic == f"/raw/{name}"]


def test_a_lost_source_is_opened_again_and_the_gap_is_told(record):
    lines = [range_line(0.1 * k, k) for k in range(6)]
    script = Script(
        lines[0], lines[1][:20], DisconnectedError("unplugged"), "refuse", "refuse", *lines[2:]
    )
    events, tallies, found = record(script, host=FakeTime())
    assert kinds(events) == [("source_lost", "x0"), ("source_back", "x0")]
    assert events[0].values["why"] == "unplugged"
    assert events[1].values["gap_s"] == pytest.approx(0.2 + 0.4 + 0.8, abs=0.2)
    assert (tallies["x0"].frames, tallies["x0"].reconnects, tallies["x0"].samples) == (5, 1, 5)
    assert raw(found) == [lines[0], lines[1][:20], b"", *lines[2:]]
    texts = [data for topic, _, data in found if topic == "/clt/log"]
    assert b"source x0: lost: unplugged" in texts[0]
    assert texts[0][12] == 40
    assert texts[1][12] == 20


def test_without_reconnect_a_lost_source_ends(record):
    options = RecorderOptions(stall_s=0.0, reconnect=False)
    script = Script(range_line(0, 0), DisconnectedError("unplugged"), range_line(1, 1))
    events, tallies, _ = record(script, options=options)
    assert kinds(events) == [("source_lost", "x0")]
    assert tallies["x0"].frames == 1


def test_silence_opens_a_source_again(record):
    script = Script(range_line(0, 0), *[None] * 150, range_line(1, 1))
    options = RecorderOptions(stall_s=5.0)
    events, tallies, _ = record(script, options=options, host=FakeTime())
    assert events[0].values["why"] == "silent for 5 s"
    assert script.opened == 2
    assert tallies["x0"].frames == 2


def test_what_finds_no_room_is_counted(record):
    """The inbox holds one line; the writer is held up until all were offered."""
    lines = [range_line(0.1 * k, k) for k in range(20)]
    inbox = Inbox(len(lines[0]) + 500)
    script = Script(*lines)
    taken = inbox.take
    script_done = lambda: len(script.steps) == 0  # noqa: E731

    def late(wait_s):
        if not script_done():
            SystemTime().sleep(0.001)
            return []
        return taken(wait_s)

    inbox.take = late
    roomy = RecorderOptions(stall_s=0.0, busy_fill=1e9)
    events, tallies, found = record(script, inbox=inbox, options=roomy)
    tally = tallies["x0"]
    assert tally.lost == 19
    assert tally.frames == 1
    assert ("bytes_dropped", "x0") in kinds(events)
    assert raw(found) == [lines[0], b""]


def test_decoding_is_given_up_before_bytes_are(record):
    lines = [range_line(0.1 * k, k) for k in range(5)]
    options = RecorderOptions(stall_s=0.0, busy_fill=-1.0)
    events, tallies, found = record(Script(*lines), options=options)
    tally = tallies["x0"]
    assert raw(found) == lines
    assert (tally.frames, tally.undecoded_bytes) == (0, sum(map(len, lines)))
    assert ("overload", "x0") in kinds(events)


def test_a_source_that_can_wait_is_always_decoded(record):
    lines = [range_line(0.1 * k, k) for k in range(50)]
    inbox = Inbox(500)
    options = RecorderOptions(stall_s=0.0, busy_fill=-1.0)
    _, tallies, _ = record(Script(*lines), inbox=inbox, waits=True, options=options)
    assert (tallies["x0"].frames, tallies["x0"].lost) == (50, 0)


def test_the_end_after_a_duration(record):
    script = Script(*[range_line(0.1, 0), None] * 1000)
    options = RecorderOptions(duration_s=0.3, stall_s=0.0)
    _, tallies, _ = record(script, options=options)
    assert 0 < tallies["x0"].frames < 100


def test_a_stop_writes_what_waits_a_second_one_does_not(record):
    for stops in (1, 2):
        inbox = Inbox()
        script = Script()

        def hold(wait_s, inbox=inbox, script=script):
            del wait_s
            if len(script.steps) > 0:
                SystemTime().sleep(0.001)
                return []
            return Inbox.take(inbox, 0.0)

        def stop(script=script, stops=stops):
            for _ in range(stops):
                script.recorder.stop()

        script.steps = [*[range_line(0.1 * k, k) for k in range(10)], stop]
        inbox.take = hold
        _, tallies, _ = record(script, inbox=inbox)
        assert (tallies["x0"].frames, tallies["x0"].lost) == ((10, 0) if stops == 1 else (0, 10))


def test_bytes_of_which_nothing_decodes(record):
    script = Script(*[b"\xff" * 100, None] * 100)
    events, tallies, _ = record(script, host=FakeTime(), words="proto=rcl")
    assert ("nothing_decoded", "x0") in kinds(events)
    assert kinds(events).count(("nothing_decoded", "x0")) == 1
    assert tallies["x0"].skipped_bytes == 10_000


def test_a_wall_clock_that_is_set_does_not_move_the_log(record):
    host = FakeTime()

    def step():
        host.step(3600)

    script = Script(range_line(0, 0), step, *[None] * 30, range_line(1, 1))
    events, _, found = record(script, host=host)
    assert [one.values["step_s"] for one in events if one.kind == "wall_clock_set"] == [3600]
    assert found[-1][1] - found[0][1] < 10_000_000_000


def test_a_disk_that_runs_low_ends_the_recording(record, monkeypatch):
    monkeypatch.setattr(module, "free_bytes", lambda _: 99)

    def slow():
        SystemTime().sleep(0.002)
        return range_line(0, 0)

    script = Script(*[slow, None] * 500)
    options = RecorderOptions(stall_s=0.0, min_free_bytes=100)
    events, tallies, _ = record(script, host=FakeTime(), options=options)
    assert kinds(events)[0][0] == "disk_low"
    assert tallies["x0"].frames < 500


def test_a_device_that_began_again(record):
    lines = [range_line(t, k) for k, t in enumerate([100.0, 100.1, 0.0, 0.1, 0.2, 0.3])]
    events, tallies, found = record(Script(*lines), host=FakeTime())
    assert ("device_restarted", "x0") in kinds(events)
    assert tallies["x0"].restarts == 1
    maps = [data for topic, _, data in found if topic == "/clt/clock/x0"]
    assert struct.unpack_from("<I", maps[-1], 4 + 8 + 24)[0] == 1


def test_decoders_are_started_on_every_connection_and_polled(record, monkeypatch):
    script = Script(None, None, DisconnectedError("unplugged"), *[None] * 5)
    started = []

    class Asking:
        """Counts what it is asked."""

        def __init__(self, decoder):
            self.decoder = decoder

        def __getattr__(self, name):
            return getattr(self.decoder, name)

        def start(self):
            started.append(1)
            return b"start"

        def poll(self, _now):
            return b"poll"

    ask = Intake.decoder
    monkeypatch.setattr(Intake, "decoder", lambda *words: Asking(ask(*words)))
    record(script)
    assert len(started) == 2
    assert script.written.count(b"start") == 2
    assert b"poll" in script.written


def test_several_files_advance_together(tmp_path):
    """The one that is furthest behind is read next."""
    paths = []
    for name in ("a", "b"):
        path = tmp_path / name
        path.write_bytes(b"".join(range_line(0.01 * k, k, name, "c") for k in range(500)))
        paths.append(path)
    specs = [parse_source(f"{path.name}=file:{path},proto=ndjson") for path in paths]
    clock = HostClock(SystemTime())
    recorder = Recorder(
        specs,
        RecorderOptions(),
        clock,
        words=diagnostic_text,
        on_event=lambda _: None,
        on_status=lambda _: None,
    )
    recorder.open()
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}})
    intake = Intake(parts, specs, GrowingTeam(), 0)
    recorder.run(intake, parts)
    with (tmp_path / "o.mcap").open("rb") as file:
        reader = make_reader(file)
        stamps = [
            message.publish_time
            for _, channel, message in reader.iter_messages(log_time_order=False)
            if channel.topic.endswith("range")
        ]
    assert len(stamps) == 1000
    latest = 0
    for stamp in stamps:
        assert stamp > latest - 500_000_000
        latest = max(latest, stamp)


def test_an_item_of_the_inbox_that_is_no_chunk_always_finds_room():
    inbox = Inbox(10)
    assert not inbox.put("x", Chunk(0, bytes(100)))
    assert inbox.put("x", Opened(Script()))


def test_a_decoder_that_raises_costs_no_bytes(record, monkeypatch):
    script = Script(*[range_line(0.1 * k, k) for k in range(5)])
    feed = LineDecoder.feed

    def fail(self, data):
        if b'"seq": 2' in self._kept + data:
            raise ValueError("not\nfit")
        return feed(self, data)

    monkeypatch.setattr(LineDecoder, "feed", fail)
    _, tallies, found = record(script)
    tally = tallies["x0"]
    assert len(raw(found)) == 5
    assert tally.decoder_error == "ValueError: not fit"
    assert (tally.frames, tally.bad_frames) == (4, 1)
    kinds_found = [one.kind for one in summary_diagnostics(tallies)]
    assert kinds_found == ["decoder_failed", "source_damaged"]


def test_a_source_that_raises_ends_or_begins_again(record):
    script = Script(range_line(0, 0), ZeroDivisionError("oh"), range_line(1, 1))
    events, tallies, _ = record(script)
    assert events[0].values["why"] == "ZeroDivisionError: oh"
    assert tallies["x0"].frames == 2


def test_angles_of_a_file_advance_with_the_speeds_of_another(tmp_path):
    """Steering is no message, but it is read no further ahead than its own times say."""
    lines = {
        "turn": [
            {"type": "steer", "node": "car", "angle": 0.001 * k, "t": 0.1 * k} for k in range(600)
        ],
        "odo": [{"type": "odom", "node": "car", "v": 1.0, "t": 0.1 * k} for k in range(600)],
    }
    for name, said in lines.items():
        (tmp_path / name).write_text("".join(json.dumps(one) + "\n" for one in said))
    specs = [
        parse_source(f"turn=file:{tmp_path}/turn,proto=ndjson"),
        parse_source(f"odo=file:{tmp_path}/odo,proto=ndjson,steer=turn,wheelbase=1"),
    ]
    recorder = Recorder(
        specs,
        RecorderOptions(),
        HostClock(SystemTime()),
        words=diagnostic_text,
        on_event=lambda _: None,
        on_status=lambda _: None,
    )
    recorder.open()
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}})
    intake = Intake(parts, specs, GrowingTeam(), 0)
    recorder.run(intake, parts)
    assert intake.tallies["odo"].unknown_turns == 0
    turn_rates = load(tmp_path / "o.mcap").recording.odometry["car"].omega
    assert turn_rates == pytest.approx([tan(0.001 * k) for k in range(600)], abs=1e-9)


@pytest.mark.parametrize("rate", [0, 1])
def test_times_beyond_all_sense_do_no_harm(tmp_path, rate):
    """A clock map has 64 bits; what does not fit is not written, the sample is refused or kept."""
    line = b"(9999999999.000000) can0 00000901#0000240C007B00B9\n"
    (tmp_path / "can.log").write_bytes(5 * line)
    spec = parse_source(f"can=candump:{tmp_path}/can.log?rate={rate},proto=vesc-can")
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}})
    intake = Intake(parts, [spec], GrowingTeam(), 0)
    intake.take("can", Chunk(1, 5 * line))
    intake.finish(2)
    parts.finish()
    assert intake.tallies["can"].frames == 5


def test_a_source_that_fails_in_an_unforeseen_way_is_lost_and_opened_again(record):
    """No thread dies and leaves a recording that waits for ever."""
    script = Script(range_line(0.0), OSError(5, "broken"), range_line(1.0), ValueError("torn"))
    events, tallies, _ = record(script)
    assert [one.kind for one in events].count("source_lost") == 2
    assert tallies["x0"].frames == 2
    assert "broken" in str(events[0].values["why"])


def test_a_file_that_cannot_be_read_on_is_lost(tmp_path):
    """A log is ended and says why there is no more."""
    (tmp_path / "in").write_bytes(range_line(0.0))
    spec = parse_source(f"x=file:{tmp_path}/in,proto=ndjson")
    events = []
    recorder = Recorder(
        [spec],
        RecorderOptions(),
        HostClock(SystemTime()),
        words=diagnostic_text,
        on_event=events.append,
        on_status=lambda _: None,
    )
    recorder.open()
    steps = Script(range_line(0.0), OSError(5, "Input/output error"))
    steps.clock = HostClock(SystemTime())
    recorder._readers["x"].connection.close()
    recorder._readers["x"].connection = steps
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}})
    recorder.run(Intake(parts, [spec], GrowingTeam(), 0), parts)
    assert kinds(events) == [("source_lost", "x")]
    with (tmp_path / "o.mcap").open("rb") as file:
        assert make_reader(file).get_summary() is not None


def test_a_datagram_of_one_object_needs_no_end_of_line(tmp_path):
    spec = parse_source("net=udp:127.0.0.1:9,proto=ndjson")
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}})
    intake = Intake(parts, [spec], GrowingTeam(), 0)
    line = range_line(0.0).rstrip()
    pieces = [line, line + b"\n" + line + b"\n", line[:20], line[20:] + b"\n", line + b"\r", line]
    for k, piece in enumerate(pieces):
        intake.take("net", Chunk(k, piece))
    intake.finish()
    parts.finish()
    tally = intake.tallies["net"]
    assert (tally.frames, tally.bad_frames, tally.bytes) == (6, 0, sum(map(len, pieces)))


def counted_messages(path):
    """Messages of the chunks that reached the file."""
    found = 0
    with path.open("rb") as file, suppress(Exception):
        for record in StreamReader(file).records:
            found += isinstance(record, Message)
    return found


@pytest.mark.parametrize(("flush_s", "kept"), [(0.05, True), (60.0, False)])
def test_a_flush_comes_when_it_is_due_and_not_before(record, tmp_path, flush_s, kept):
    """Though a single message is all that comes, and seconds of the recorder's clock go by."""
    seen = []

    def wait():
        end = time.monotonic() + 0.4
        while time.monotonic() < end and not (seen and seen[-1] > 0):
            time.sleep(0.02)
            seen.append(counted_messages(tmp_path / "o.mcap"))

    script = Script(range_line(0.0), *[None] * 40, wait)
    record(script, host=FakeTime(), flush_s=flush_s)
    assert (seen[-1] > 0) == kept


def test_what_was_taken_from_a_pipe_is_kept_at_the_stop(record):
    """The inbox is full while the writer is held up: the reader keeps what it has read."""
    line = range_line(0.0)
    inbox, script = Inbox(len(line) + 450), Script()
    taken = inbox.take

    def late(wait_s):
        if not script.recorder.is_stopping:
            time.sleep(0.002)
            return []
        return taken(wait_s)

    def stop():
        script.recorder.stop()
        return range_line(0.2, 2)

    inbox.take = late
    script.steps = [line, stop]
    _, tallies, found = record(script, inbox=inbox, waits=True)
    assert raw(found) == [line, range_line(0.2, 2)]
    assert (tallies["x0"].frames, tallies["x0"].lost) == (2, 0)


def test_chunks_without_room_are_counted_in_place_and_take_none():
    inbox = Inbox(1000)
    first = Chunk(0, bytes(700))
    assert inbox.put("x", first)
    for stream in (1, 2):
        for _ in range(10_000):
            inbox.drop("x", Chunk(0, b"abc", stream))
    inbox.drop("x", Chunk(0, b"", 2))
    items = inbox.take(0.0)
    assert items == [("x", first), ("x", Dropped(1, 10_000)), ("x", Dropped(2, 10_000))]
    for _, content in items:
        inbox.done(content)
    assert inbox.fill == 0.0
    inbox.drop("x", Chunk(0, b"abc"))
    assert inbox.put("x", Chunk(1, b"later"))
    inbox.drop("x", Chunk(2, b"abc"))
    kinds_taken = [type(content) for _, content in inbox.take(0.0)]
    assert kinds_taken == [Dropped, Chunk, Dropped]


def test_a_drop_is_booked_on_the_stream_that_lost(record):
    """The line that the first client has begun is not torn by what the second one lost."""
    line = range_line(0.0)
    script = Script(
        Joined(Script(), 1), Joined(Script(), 2), Chunk(1, line[:20], 1), Chunk(2, b"x" * 9000, 2),
        Chunk(3, line[20:], 1),
    )  # fmt: skip
    inbox = Inbox(5000)
    _, tallies, found = record(script, inbox=inbox, listens=True)
    tally = tallies["x0"]
    assert (tally.frames, tally.lost, tally.skipped_bytes) == (1, 1, 0)
    assert [data[16:] for topic, _, data in found if topic == "/raw/x0/2"] == [b""]
    assert raw(found) == [line[:20], line[20:]]


def test_clients_are_started_when_they_come_and_polled_each(record, monkeypatch):
    links = [Script(), Script()]
    gone = Chunk(1, b"", 1)
    steps = [Joined(links[0], 1), *[None] * 3, Joined(links[1], 2), *[None] * 3, gone]
    script = Script(*[None] * 3, *steps, *[None] * 2, links[0].written.clear, *[None] * 3)

    class Asking:
        def __init__(self, decoder, stream):
            self.decoder, self.stream = decoder, stream

        def __getattr__(self, name):
            return getattr(self.decoder, name)

        def start(self):
            return b"start %d" % self.stream

        def poll(self, _now):
            return b"poll %d" % self.stream

    ask = Intake.decoder
    monkeypatch.setattr(
        Intake, "decoder", lambda intake, name, stream=1: Asking(ask(intake, name, stream), stream)
    )
    record(script, listens=True)
    assert script.written == []
    assert links[1].written[0] == b"start 2"
    assert set(links[1].written[1:]) == {b"poll 2"}
    assert links[0].written == []
