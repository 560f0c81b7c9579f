from __future__ import annotations

import pytest

from clt.devices.decoders.table import make_decoder

MR = "mr 0f 000005a4 000004c8 00000436 000003f9 0958 c0 40424042 a0:0"
MA = "ma 07 00000000 0000085c 00000659 000006b7 095b 26 00024bed a0:0"
MC = "mc 0f 00000663 000005a3 00000512 000004cb 095f c1 00024c24 a0:0"
NONE = "03e7fc18"


def fed(*lines, **options):
    decoder = make_decoder("trek1000", options, "uwb")
    found = list(decoder.feed("".join(f"{line}\r\n" for line in lines).encode()))
    return [*found, *decoder.finish()], decoder.counts


def corrected(sequence, ms, *mm, mask="0f", tag=0, kind="mc"):
    values = " ".join(f"{one & 0xFFFFFFFF:08x}" for one in (*mm, 0, 0, 0, 0)[:4])
    return f"{kind} {mask} {values} 0001 {sequence:02x} {ms:08x} a{tag}:0"


def test_the_lines_of_the_manual():
    found, counts = fed(MR, MA, MC, latency="0")
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (3, 0, 0)
    assert [(one.source, one.target, one.distance) for one in found] == [
        ("a0", "a1", 2.14),
        ("a0", "a2", 1.625),
        ("a1", "a2", 1.719),
        ("t0", "a0", 1.635),
        ("t0", "a1", 1.443),
        ("t0", "a2", 1.298),
        ("t0", "a3", 1.227),
    ]
    assert {one.device_ns for one in found} == {0x24BED * 10**6, 0x24C24 * 10**6}
    assert found[3].raw_distance == 1.635  # mr is of another exchange


@pytest.mark.parametrize(
    "lines",
    [
        [corrected(5, 100, 1000), corrected(5, 0, 1200, kind="mr")],
        [corrected(5, 0, 1200, kind="mr"), corrected(5, 100, 1000)],
    ],
)
def test_the_uncorrected_range_of_the_same_exchange_is_the_raw_one(lines):
    later = [line.replace(" 05 ", " 06 ") for line in lines]
    found, _ = fed(*lines, *later, latency="0")
    assert [(one.distance, one.raw_distance) for one in found[::4]] == [(1.0, 1.2), (1.0, 1.2)]
    assert [one.sequence for one in found[::4]] == [5, 6]


def test_ranges_do_not_wait_for_uncorrected_ones_that_never_come():
    decoder = make_decoder("trek1000", {"latency": "0"}, "uwb")
    lines = [f"{corrected(n, 100 * n, 1000, mask='01')}\r\n".encode() for n in range(4)]
    assert [len(decoder.feed(line)) for line in lines] == [0, 2, 1, 1]


def test_uncorrected_ranges_that_are_switched_on_again():
    def exchange(n, *, both):
        lines = [corrected(n, 100 * n, 1000, mask="01")]
        return [*lines, corrected(n, 0, 1200, mask="01", kind="mr")] if both else lines

    lines = [line for n in range(6) for line in exchange(n, both=n not in {1, 2})]
    found, _ = fed(*lines, latency="0")
    # Of exchange 3 the uncorrected range was not expected any more.
    assert [one.raw_distance for one in found] == [1.2, 1.0, 1.0, 1.0, 1.2, 1.2]


def test_a_range_is_one_period_older_than_its_line():
    lines = [corrected(n & 0xFF, 100 * n + n % 2, n, mask="01") for n in range(253, 259)]
    found, _ = fed(*lines)
    times = [one.device_ns // 10**6 for one in found]
    assert times[1:] == [100 * n + n % 2 for n in range(253, 258)]
    assert times[0] == 100 * 253 + 1 - 99
    assert [one.sequence for one in found] == list(range(253, 259))
    lost, _ = fed(*lines[:2], *lines[4:])
    assert [one.device_ns // 10**6 for one in lost] == [*times[:2], 25701 - 99, times[5]]
    alone, _ = fed(lines[0])
    assert alone[0].device_ns // 10**6 == 100 * 253 + 1 - 100
    given, _ = fed(lines[0], latency="0.28")
    assert given[0].device_ns // 10**6 == 100 * 253 + 1 - 280


def test_milliseconds_wrap_after_seven_weeks():
    found, _ = fed(*(corrected(n, (2**32 - 100 + 100 * n) % 2**32, n) for n in range(3)))
    times = [one.device_ns // 10**6 for one in found[::4]]
    assert times == [2**32 - 200, 2**32 - 100, 2**32]


def test_variants_of_clones():
    found, counts = fed(
        "mc 0f 00000663 000005a3 00000512 000004cb 095f c1 0 a0:0",
        "mc 01 00000663 000005a3 00000512 000004cb 0 0 0 0 095f c1 00000001 a0:0".replace(
            " 0 0 0 0", " 00000000" * 4
        ),
        "mc 01 ffffff9c 000005a3 00000512 000004cb 095f c1 00000001 t1:0 1f40 ",
        "$KT0,1.69,2.93,NULL,NULL",
        "me 0000 0000 0000 0000 0000 0000 0000 0000 0000 0000",
        latency="0",
    )
    assert [(one.source, one.target, one.distance) for one in found[3:]] == [
        ("t0", "a3", 1.227),
        ("t0", "a0", 1.635),
        ("t1", "a0", -0.1),
    ]
    assert [one.device_ns for one in found] == [None] * 4 + [10**6] * 2
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (4, 0, 26)


@pytest.mark.parametrize(
    ("line", "bad"),
    [
        (MC[:40], 1),
        (MC + MC, 1),
        (MC.replace("000005a3", NONE), 1),
        (MC.replace("000005a3", "7fffffff"), 1),
        ("T0000 0000 time", 0),
        ("mcx", 0),
    ],
)
def test_damaged_lines(line, bad):
    found, counts = fed(line)
    assert found == []
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (0, bad, len(line) + 2)


def test_a_mask_without_ranges():
    found, counts = fed(f"mc 00 {NONE} {NONE} {NONE} {NONE} 0001 01 00000001 a0:0")
    assert (found, counts.frames) == ([], 1)
