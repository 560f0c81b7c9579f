from __future__ import annotations

import gzip
import math
import struct
from collections import Counter
from pathlib import Path

import pytest

from clt.devices.decoders.table import make_decoder
from clt.devices.samples import ImuSample, OdometrySample, RangeSample

CAPTURE = Path(__file__).parents[4] / "shared/data/thu_rcl_20190418/static_20190614_test.txt.gz"
WHEELS = bytes.fromhex("a55a13026aad3800013297 90af3b000000003b574c3cdd")
RANGE = bytes.fromhex("a55a0f03c6ee3b00000170ef5ff5fdbdc5bfdd")


def fed(data, step=None):
    decoder = make_decoder("rcl", {}, "uwb")
    found = []
    for at in range(0, len(data), step or max(len(data), 1)):
        found += decoder.feed(data[at : at + (step or len(data))])
    return decoder, found


def range_frame(ms, one, other, distance):
    return b"\xa5\x5a\x0f\x03" + struct.pack("<IBBd", ms, one, other, distance) + b"\xdd"


def test_vectors():
    decoder, (wheels, distance) = fed(WHEELS + RANGE)
    assert wheels[:4] == (0, 3_714_410_000_000, "", "1")
    assert wheels[4:] == pytest.approx((0.1071563, 0.2494394), abs=1e-7)
    assert distance[:5] == (1, 3_927_750_000_000, "", "0", "1")
    assert distance.distance == distance.raw_distance == pytest.approx(-0.16986, abs=1e-5)
    assert (decoder.counts.frames, decoder.counts.frame_bytes) == (2, 42)


def test_inertial_readings_are_in_g_and_degrees():
    payload = struct.pack("<IB6h", 5, 4, 8192, 0, -8192, 131, 0, 0)
    _, (sample,) = fed(b"\xa5\x5a\x12\x01" + payload + b"\xdd")
    assert isinstance(sample, ImuSample)
    assert sample.node == "4"
    assert sample.acceleration == pytest.approx((9.80665, 0.0, -9.80665))
    assert sample.rate[0] == pytest.approx(math.radians(131 / 131.072))


@pytest.mark.parametrize(
    "frame",
    [
        range_frame(1, 0, 1, 2.5e9),
        range_frame(1, 0, 1, float("nan")),
        range_frame(1, 0, 6, 1.0),
        range_frame(1, 2, 2, 1.0),
        WHEELS.replace(b"\x01\x32", b"\x01\x00"),
    ],
)
def test_a_value_without_sense_is_refused(frame):
    decoder, found = fed(frame + RANGE)
    assert [sample.source for sample in found] == ["0"]
    counts = decoder.counts
    assert (counts.frames, counts.bad_frames, counts.skipped_bytes) == (1, 1, len(frame))


def test_a_torn_frame_hides_no_other():
    decoder, found = fed(RANGE[:7] + WHEELS + b"\xa5" + RANGE + RANGE[:6])
    assert len(found) == 2
    assert (decoder.counts.skipped_bytes, decoder.tail_bytes) == (8, 6)
    assert decoder.finish() == []
    assert decoder.tail_bytes == 6
    assert len(decoder.feed(RANGE)) == 1
    assert (decoder.counts.skipped_bytes, decoder.tail_bytes) == (14, 0)


def test_an_end_mark_that_arrives_twice_or_never():
    decoder, found = fed(RANGE + b"\xdd" + WHEELS + RANGE[:-1] + WHEELS)
    assert len(found) == 3
    assert (decoder.counts.skipped_bytes, decoder.tail_bytes) == (1 + len(RANGE) - 1, 0)


def test_milliseconds_wrap():
    _, found = fed(range_frame(2**32 - 1, 0, 1, 1.0) + range_frame(4, 0, 1, 1.0))
    assert found[1].device_ns - found[0].device_ns == 5_000_000


@pytest.mark.skipif(not CAPTURE.exists(), reason="the capture is not here")
def test_the_real_capture():
    data, decoder = gzip.decompress(CAPTURE.read_bytes()), make_decoder("rcl", {}, "uwb")
    kinds, times = Counter(), []
    for at in range(0, len(data), 4096):
        samples = decoder.feed(data[at : at + 4096])
        kinds.update(map(type, samples))
        times += [sample.device_ns for sample in samples]
    assert decoder.finish() == []
    assert decoder.counts.frames == 169_689
    assert kinds == {
        RangeSample: 97_897,
        ImuSample: 65_265,
        OdometrySample: 6_527,
    }
    assert (decoder.counts.skipped_bytes, decoder.tail_bytes) == (34, 15)
    # The first two frames are stale.
    assert times[-1] - times[2] == pytest.approx(163.15e9, abs=0.02e9)
