from __future__ import annotations

import json
from math import isnan

import pytest

from clt.core.errors import UsageError
from clt.devices.decoders.table import make_decoder
from clt.devices.samples import (
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    ReceivedPacket,
    SteeringSample,
)


def said(*lines, **options):
    decoder = make_decoder("ndjson", options, "own")
    text = b"".join(
        (line if isinstance(line, bytes) else json.dumps(line).encode()) + b"\n" for line in lines
    )
    return decoder.feed(text), decoder


def test_the_line_with_a_checksum():
    line = b'{"type":"range","from":"r1","to":"r2","range":1.635,"t":150.564}*5C'
    (sample,), decoder = said(line)
    assert sample[:7] == (0, 150_564_000_000, "", "r1", "r2", 1.635, 1.635)
    assert sample.sequence is None
    assert isnan(sample.sigma)
    found, decoder = said(line.replace(b"1.635", b"1.634"), b"*00", b"{}*00")
    assert found == []
    assert (decoder.counts.frames, decoder.counts.bad_frames) == (0, 2)
    assert decoder.counts.skipped_bytes == len(line) + 1 + 4 + 6


def test_every_type():
    found, decoder = said(
        b"booting...\r",
        {"type": "hello", "node": "r1", "proto": "clt-ndjson", "v": 1},
        {"type": "range", "from": 1, "to": "b", "range": 2, "raw": 2.5, "std": 0.1, "rssi": -80}
        | {"seq": 7, "t_us": 12, "los": True},
        {"type": "odom", "node": "a", "v": 1.0, "w": -0.5, "t": 0.1, "steer": 0.2},
        {"type": "odom", "node": "a", "dx": 0.1, "dy": 0, "dyaw": 0.05, "dt": 0.1},
        {"type": "steer", "node": "a", "angle": -0.1, "t": 3},
        {"type": "pose", "node": "a", "x": 1, "y": 2, "yaw": 3},
        {"type": "uwb", "node": "a", "tx": {"seq": 4, "ts": 512}, "t": 1}
        | {"rx": [{"id": "b", "seq": 3, "ts": (1 << 40) - 5}], "odom": {"ts": 9, "v": 1, "w": 2}},
        {"type": "ticks", "node": "a", "left": 1, "right": 2, "t": 1},
        {"type": "clock", "node": "a", "ref": "b", "offset": 0.1, "skew": 1e-6},
    )
    assert (decoder.counts.frames, decoder.counts.bad_frames) == (9, 0)
    assert decoder.counts.skipped_bytes == 12
    assert found == [
        RangeSample(1, 12_000, "", "1", "b", 2.0, 2.5, 7, 0.1, -80.0),
        SteeringSample(2, 100_000_000, "", "a", 0.2),
        OdometrySample(2, 100_000_000, "", "a", 1.0, -0.5),
        OdometrySample(3, None, "", "a", 1.0, 0.5),
        SteeringSample(4, 3_000_000_000, "", "a", -0.1),
        PoseSample(5, None, "", "a", 1.0, 2.0, 3.0),
        PacketSample(6, 10**9, "", "a", 4, 512, (ReceivedPacket("b", 3, 2**40 - 5),), 9, 1.0, 2.0),
    ]


@pytest.mark.parametrize(
    "line",
    [
        b'{"type":"range","from":"a","to":"b","range":NaN}',
        b'{"type":"range","from":"a","to":"b","range":1e999}',
        b'{"type":"range","from":"a","to":"b","range":true}',
        b'{"type":"range","from":"a","to":"b","range":2.5e9}',
        b'{"type":"range","from":"a","to":"a","range":1}',
        b'{"type":"range","from":"","to":"a","range":1}',
        b'{"type":"range","from":"a","to":"b"}',
        b'{"type":"odom","node":"a","dx":1,"dyaw":1,"dt":0}',
        b'{"type":"uwb","node":"a","tx":{"seq":1,"ts":1099511627776},"rx":[]}',
        b'{"type":"uwb","node":"a","tx":{"seq":1,"ts":1},"rx":[1]}',
        b'{"type":"uwb","node":"a","tx":{"seq":1,"ts":1},"rx":[],"hz":1e9}',
        b'{"type":["range"]}',
        b'{"a":' + b"[" * 60_000,
        b'{"t":' + b"9" * 10_000 + b',"type":"odom","node":"a","v":0,"w":0}',
        b'{"type":"ra',
        b'{"type":"\xff"}',
    ],
)
def test_a_line_without_sense_is_refused(line):
    found, decoder = said(line)
    assert found == []
    assert (decoder.counts.bad_frames, decoder.counts.skipped_bytes) == (1, len(line) + 1)


def test_counts_of_wheels_and_revolutions():
    ticks = {"type": "ticks", "node": "a", "left": 1000, "right": 1000, "t": 1}
    later = ticks | {"left": 1050, "right": 1150, "t": 1.5}
    backwards = ticks | {"t": 0.5}
    given = {"ticks_per_metre": "100", "track": "0.5"}
    found, decoder = said(ticks, later, backwards, backwards, **given)
    assert found == [OdometrySample(1, 1_500_000_000, "", "a", 2.0, 4.0)]
    assert (decoder.counts.frames, decoder.counts.bad_frames) == (4, 0)
    found, _ = said(ticks, later, ticks_per_metre="100")
    assert found[0].v == 2.0
    assert isnan(found[0].omega)
    assert said(ticks, later)[0] == []
    assert said(ticks, later | {"left": 1e15}, **given)[1].counts.bad_frames == 1
    erpm = {"type": "erpm", "node": "a", "erpm": 2307, "t": 1}
    found, _ = said(erpm, erpm | {"erpm": 1e9}, erpm_offset="-2307")
    assert [one.v for one in found] == [1.0]


def test_clocks_of_nodes():
    a = {"type": "steer", "node": "a", "angle": 0, "t": 1}
    assert [one.clock for one in said(a)[0]] == [""]
    assert [one.clock for one in said(a, clock="node")[0]] == ["a"]
    boot = {"type": "hello", "node": "a", "clock": "boot", "wrap": 10}
    late, early = a | {"t": 9.5}, a | {"t": 0.5}
    assert [(one.clock, one.device_ns) for one in said(boot, late, early)[0]] == [
        ("a", 9_500_000_000),
        ("a", 10_500_000_000),
    ]


def test_narrow_counters_are_continued():
    line = {"type": "uwb", "node": "a", "bits": 32, "rx": [{"id": "b", "seq": 0, "ts": 2**32 - 8}]}
    found, _ = said(line | {"tx": {"seq": 0, "ts": 2**32 - 4}}, line | {"tx": {"seq": 1, "ts": 6}})
    assert [one.transmit for one in found] == [2**32 - 4, 2**32 + 6]
    assert [one.received[0].ticks for one in found] == [2**32 - 8, 2**32 - 8]


def test_a_line_without_end_is_kept_until_it_ends_or_is_too_long():
    decoder = make_decoder("ndjson", {}, "own")
    for _ in range(16):
        assert decoder.feed(b"{" * 65_536) == []
    assert decoder.tail_bytes <= 65_536
    assert decoder.counts.skipped_bytes + decoder.tail_bytes == 2**20
    assert len(decoder.feed(b'\n{"type":"steer","node":"a","angle":0}\r\n')) == 1
    assert decoder.feed(b'{"type":"steer","node":"a","angle":0}') == []
    assert len(decoder.finish()) == 1
    assert decoder.tail_bytes == 0


def test_options():
    with pytest.raises(UsageError, match="source own: unknown key `clok`, did you mean `clock`"):
        said(clok="node")
    with pytest.raises(UsageError, match="source own: clock=x: give stream or node"):
        said(clock="x")
    with pytest.raises(UsageError, match="source own: unknown protocol `ndjsn`, did you mean"):
        make_decoder("ndjsn", {}, "own")
