"""The recorder with sources and clocks of the test's own."""

from __future__ import annotations

import struct

import pytest
from mcap.reader import make_reader

from clt.cli.messages.render import diagnostic_text
from clt.devices import recorder as module
from clt.devices.host_clock import HostClock, SystemTime
from clt.devices.inbox import Inbox, Opened
from clt.devices.intake import Intake
from clt.devices.log_parts import LogParts
from clt.devices.recorder import Recorder, RecorderOptions
from clt.devices.source_spec import parse_source
from clt.devices.sources.source import Chunk, DisconnectedError, SourceKind
from clt.devices.sources.table import SOURCES
from clt.devices.team import GrowingTeam
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

    def run(*scripts, options=None, host=None, inbox=None, waits=False, words="proto=ndjson"):
        specs = []
        for number, script in enumerate(scripts):
            kind = SourceKind(script.open, lambda _: None, reconnects=True, waits=waits)
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
        parts = LogParts(tmp_path / "o.mcap", {"clt.run": {}}, force=True)
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
    assert raw(found).count(b"") == 19


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
