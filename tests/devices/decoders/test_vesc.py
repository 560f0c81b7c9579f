from __future__ import annotations

import struct
from math import isnan

import pytest

from clt.core.errors import UsageError
from clt.devices.decoders.table import make_decoder
from clt.devices.decoders.vesc import FULL_REQUEST, SELECTIVE_REQUEST, vesc_frame

VALUES = bytes.fromhex(
    "024a040138011c000004d20000014100000000000004ce00b90000240c0074000004d200000000000037ea0000000000"
    "005020000050a000000000000301380136013a0000000000000834 0074e203"
)
SPEED = 9228 / 4614


def fed(proto, data, **options):
    decoder = make_decoder(proto, options, "odo")
    return list(decoder.feed(data)), decoder


def test_requests():
    assert bytes.fromhex("02053200 02e180940603") == SELECTIVE_REQUEST
    assert bytes.fromhex("020104408403") == FULL_REQUEST


def test_all_values():
    found, decoder = fed("vesc", VALUES, node="car1")
    assert [one[:5] for one in found] == [(0, None, "", "car1", SPEED)]
    assert isnan(found[0].omega)
    assert decoder.counts.frame_bytes == len(VALUES) == 79
    found, _ = fed("vesc", VALUES, node="car1", erpm_per_mps="2000", erpm_offset="-772")
    assert found[0].v == 5.0


def test_chosen_values():
    chosen = struct.pack(">BIihiiBB", 50, 0x0002E180, -4614, 116, 20512, 20640, 0, 1)
    other = struct.pack(">BIhi", 50, 0x81, 300, 4614)  # temperature and revolutions
    found, decoder = fed("vesc", vesc_frame(chosen) + vesc_frame(other), node="car1")
    assert [one.v for one in found] == [-1.0, 1.0]
    found, decoder = fed("vesc", vesc_frame(b"\x00\x05\x02VESC6\x00"), node="car1")
    assert (found, decoder.counts.frames) == ([], 1)
    found, decoder = fed("vesc", vesc_frame(bytes([0]) * 300) + vesc_frame(other), node="car1")
    assert (len(found), decoder.counts.frames, decoder.counts.skipped_bytes) == (1, 2, 0)


@pytest.mark.parametrize(
    ("data", "bad"),
    [
        (VALUES[:40] + bytes([VALUES[40] ^ 1]) + VALUES[41:], 1),
        (vesc_frame(b"\x04" + bytes(10)), 1),
        (vesc_frame(struct.pack(">BIi", 50, 0x80, 2**31 - 1)), 1),
        (b"\x02\x00\x00\x00\x03", 0),
        (b"\x03\x00\x10" + bytes(20), 0),
    ],
)
def test_damaged_frames_hide_no_other(data, bad):
    found, decoder = fed("vesc", data + VALUES, node="car1")
    found += decoder.finish()
    assert [one.v for one in found] == [SPEED]
    assert decoder.counts.skipped_bytes == len(data)
    assert decoder.counts.bad_frames >= bad


def test_an_unfinished_frame_hides_none_at_the_end():
    found, decoder = fed("vesc", b"\x02\xff" + VALUES, node="car1")
    assert found == []
    assert decoder.tail_bytes == 81
    assert len(decoder.finish()) == 1
    assert (decoder.counts.skipped_bytes, decoder.tail_bytes) == (2, 0)


def test_polls():
    decoder = make_decoder("vesc", {"node": "car1", "poll": "20"}, "odo")
    assert decoder.start() == b""
    sent = [decoder.poll(100.0 + 0.01 * step) for step in range(100)]
    assert sum(one != b"" for one in sent) == 20
    requests = [one for one in sent if one != b""]
    assert requests == [SELECTIVE_REQUEST] * 10 + [FULL_REQUEST] * 10
    decoder.feed(VALUES)
    later = [decoder.poll(101.0 + 0.01 * step) for step in range(30)]
    assert {one for one in later if one != b""} == {FULL_REQUEST}
    assert decoder.poll(500.0) != b""
    assert decoder.poll(500.01) == b""


def test_status_frames_on_the_bus():
    status = struct.pack("<IB3x8s", 0x80000901, 8, bytes.fromhex("0000240C007B00B9"))
    text = b"(1795332512.214037) can0 00000902#0000240C007B00B9\r\n"
    others = (
        b"(1795332512.3) can0 00001B01#0000502000740000\n"
        b"(1795332512.3) can0 009#0000A03F00002040\n" + struct.pack("<IB3x8s", 9, 8, bytes(8))
    )
    found, decoder = fed("vesc-can", status + text + others + status[:6])
    assert [(one.device_ns, one.node, one.v) for one in found] == [
        (None, "1", SPEED),
        (1_795_332_512_214_037_000, "2", SPEED),
    ]
    assert (decoder.counts.frames, decoder.counts.skipped_bytes, decoder.tail_bytes) == (5, 0, 6)
    found, decoder = fed("vesc-can", b"(17 x\x00" + text[:20] + b"\n" + status + b"\xff" + text)
    assert len(found) == 2
    assert decoder.counts.skipped_bytes == 6 + 21 + 1


def test_the_gain_must_not_be_zero():
    for wrong in ("0", "nan", "1e9", "x"):
        with pytest.raises(UsageError, match=f"source odo: erpm_per_mps={wrong}: give a number"):
            make_decoder("vesc-can", {"erpm_per_mps": wrong}, "odo")
