from __future__ import annotations

import struct

from clt.core.ticks import TICKS_PER_SECOND
from clt.devices.decoders.lps_sniffer import antenna_ticks
from clt.devices.decoders.table import make_decoder

ANTENNA = 32_951


def framed(stamp, sender, payload):
    size = struct.pack("<H", len(payload))
    stamp = (stamp % 2**40).to_bytes(5, "little")
    return b"\xbc" + stamp + bytes([sender, 0xFF]) + size + payload + size


def tdoa2(stamp, sender, sequences, stamps):
    stamps = [one % 2**32 for one in stamps]
    return framed(stamp, sender, struct.pack("<B8B8I8H", 0x22, *sequences, *stamps, *([0] * 8)))


def tdoa3(stamp, sender, sequence, sent, *entries):
    payload = struct.pack("<BBIB", 0x30, sequence, sent % 2**32, len(entries))
    for node, heard, ticks, *distance in entries:
        payload += struct.pack("<BBI", node, heard, ticks % 2**32)
        payload += struct.pack("<H", *distance) if len(distance) > 0 else b""
    return framed(stamp, sender, payload)


def fed(*frames, **options):
    decoder = make_decoder("lps-sniffer", options, "uwb")
    return list(decoder.feed(b"".join(frames))), decoder


def test_the_delay_of_the_antennas_is_that_of_the_firmware():
    assert antenna_ticks(154.6) == ANTENNA


def test_tdoa2():
    sequences, stamps = [9, 5, 7, 0, 0, 0, 0, 0], [1000, 512 * 1000, 3, 0, 0, 0, 0, 0]
    (sample,), decoder = fed(tdoa2(TICKS_PER_SECOND, 1, sequences, stamps), antenna="0")
    assert decoder.start() == b"b"
    assert sample[:4] == (0, 10**9, "", "1")
    assert (sample.sequence, sample.transmit) == (5 + 256, 512_000)
    assert [(one.node, one.sequence, one.ticks) for one in sample.received] == [
        ("0", 9 + 256, 1000),
        ("2", 7 + 256, 3),
    ]
    (sample,), _ = fed(tdoa2(0, 1, sequences, stamps))
    assert sample.received[0].ticks == (1000 - ANTENNA) % 2**40


def test_tdoa3_with_a_stale_neighbour():
    second = 2**32 + 2**30
    found, _ = fed(
        tdoa3(0, 200, 127, 5000, (201, 0x83, 4000, 33_000), (7, 2, 4500)),
        tdoa3(second, 200, 0, 5000 + second, (201, 0x83, 4000, 33_000), (7, 3, 4400 + second)),
        antenna="0",
    )
    assert [one.sequence for one in found] == [127 + 128, 128 + 128]
    assert [one.transmit for one in found] == [5000, 5000 + second]
    assert [one[:2] for one in found[0].received] == [("201", 3 + 128), ("7", 2 + 128)]
    assert found[1].received == (("7", 3 + 128, 4400 + second),)


def test_stamps_are_continued_over_many_wraps():
    """The sender's clock is 20 ppm fast; 5 s pass between packets."""
    step = 5 * TICKS_PER_SECOND
    sent = [2**31 + round(step * k * (1 + 20e-6)) for k in range(40)]
    found, _ = fed(*(tdoa3(step * k, 3, k, sent[k], (4, k, sent[k] - 100)) for k in range(40)))
    assert [one.transmit for one in found] == [one % 2**40 for one in sent]
    assert [one.device_ns for one in found] == [5 * 10**9 * k for k in range(40)]
    heard = {(one.transmit - one.received[0].ticks) % 2**40 for one in found}
    assert heard == {100 + ANTENNA}


def test_damaged_frames_hide_no_other():
    good = tdoa3(0, 1, 0, 5)
    assert fed(framed(0, 1, b"\xf0abc"))[1].counts.frames == 1
    for bad in (
        framed(0, 9, struct.pack("<B8B8I8H", 0x22, *([0] * 24))),
        framed(0, 1, b"\x22" + bytes(55)),
        framed(0, 1, struct.pack("<BBIB", 0x30, 0, 0, 3)),
        good[:-1] + b"\x01",
        b"\xbc" * 7,
    ):
        found, decoder = fed(bad + good + good)
        assert len([*found, *decoder.finish()]) == 2
        assert decoder.counts.skipped_bytes == len(bad)
