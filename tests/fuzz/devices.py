"""Fuzzer of decoders: damaged streams may lose samples, and nothing else may happen.

Run: python -m tests.fuzz.devices --count 1000000 --seed 1 [--first K] [--proto P]. Every case
damages a short stream of one device, and feeds it in two ways of cutting, which must give the same
samples and counts. Every byte must be accounted for, every value finite or said to be unknown, the
memory kept small. Findings are printed as they come, with their numbers; `--first` goes on from a
case.
"""

from __future__ import annotations

import argparse
import random
import resource
import sys
import time
import traceback

from clt.devices.decoders.table import DECODERS, make_decoder
from clt.devices.samples import (
    ImuSample,
    OdometrySample,
    PacketSample,
    PoseSample,
    RangeSample,
    SteeringSample,
)
from tests.devices.device_streams import device_stream

PROTOCOLS = sorted(DECODERS)
SECONDS = 0.5
"""Processor time that one case may take."""
MEGABYTES = 400
"""Memory that the process may ever take."""
STEPS = 2
"""Times of which a stream holds everything."""
TAIL_BYTES = 65_536
LIMIT = 1e6
MAY_BE_UNKNOWN = {"sigma", "received_power", "omega", "heading"}
NUMBERS = {
    RangeSample: ("distance", "raw_distance", "sigma", "received_power"),
    OdometrySample: ("v", "omega"),
    SteeringSample: ("angle",),
    PoseSample: ("x", "y", "heading"),
}
INTERESTING = (0, 1, 2, 3, 0x0A, 0x0D, 0x28, 0x7B, 0x7D, 0xA5, 0x5A, 0xBC, 0xDD, 0xFF)
WORDS = (
    b"NaN", b"Infinity", b"-", b"1e999", b"7fffffff", b"ffffffff", b"03e7fc18", b"9" * 400, b"}",
    b"\r\n", b"[" * 300, b'{"type":"range"}', b"\x00" * 9, b"-0", b"*00", b"DIST,",
)  # fmt: skip


def flip(draw, data, _other):
    for _ in range(draw.choice((1, 1, 2, 8))):
        data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def put(draw, data, _other):
    data[draw.randrange(len(data))] = draw.choice(INTERESTING)


def drop(draw, data, _other):
    at = draw.randrange(len(data))
    del data[at : at + draw.choice((1, 1, 4, 40))]


def double(draw, data, _other):
    at = draw.randrange(len(data))
    size = draw.choice((1, 20, 200))
    data[at:at] = data[at : at + size] * draw.choice((1, 1, 5))


def splice(draw, data, other):
    at, there = draw.randrange(len(data)), draw.randrange(len(other))
    data[at : at + draw.choice((0, 30))] = other[there : there + draw.choice((5, 50, 500))]


def word(draw, data, _other):
    at = draw.randrange(len(data))
    data[at : at + draw.choice((0, 0, 3, 8))] = draw.choice(WORDS)


def noise(draw, data, _other):
    at = draw.randrange(len(data))
    data[at:at] = draw.randbytes(draw.choice((1, 16, 100)))


def digit(draw, data, _other):
    begin = draw.randrange(len(data))
    for at in range(begin, min(begin + 9, len(data))):
        if 0x30 <= data[at] <= 0x39:
            data[at] = draw.choice(b"0123456789-.f")
            return


DAMAGES = (flip, put, drop, double, splice, word, noise, digit)


def case(seed):
    """Protocol, damaged bytes and places of cuts of one number."""
    draw = random.Random(seed)
    proto = PROTOCOLS[seed % len(PROTOCOLS)]
    data = bytearray(device_stream(proto, STEPS).data)
    other = (
        device_stream(draw.choice(PROTOCOLS), STEPS).data if draw.random() < 0.3 else bytes(data)
    )
    for _ in range(draw.choice((1, 1, 2, 3, 6))):
        draw.choice(DAMAGES)(draw, data, other)
        if len(data) == 0:
            break
    if draw.random() < 0.2:
        del data[draw.randrange(len(data) + 1) :]
    cuts = sorted(draw.randrange(len(data) + 1) for _ in range(draw.choice((1, 3, 12))))
    return proto, bytes(data), cuts


def feed(proto, data, cuts):
    """Samples and decoder after all of it."""
    decoder = make_decoder(proto, device_stream(proto).options, "uwb")
    found, last = [], 0
    for cut in (*cuts, len(data)):
        found += decoder.feed(data[last:cut])
        last = cut
    assert decoder.tail_bytes <= TAIL_BYTES, "the tail is not bounded"
    return found + list(decoder.finish()), decoder


def check(seed):
    """Raise for anything that must not happen."""
    proto, data, cuts = case(seed)
    whole, one = feed(proto, data, ())
    pieces, other = feed(proto, data, cuts)
    assert pieces == whole, f"{proto}: cuts change the samples"
    assert other.counts == one.counts, f"{proto}: cuts change the counts"
    counts = one.counts
    total = counts.frame_bytes + counts.skipped_bytes + one.tail_bytes
    assert total == len(data), f"{proto}: {total} of {len(data)} bytes accounted for"
    assert counts.bad_frames <= len(data)
    for sample in whole:
        check_sample(proto, sample, counts.frames)


def check_sample(proto, sample, frames):
    assert 0 <= sample.frame < frames, f"{proto}: frame {sample.frame} of {frames}"
    for name in NUMBERS.get(type(sample), ()):
        value = getattr(sample, name)
        unknown = value != value and name in MAY_BE_UNKNOWN  # noqa: PLR0124 NaN
        assert unknown or abs(value) <= LIMIT, f"{proto}: {name} is {value}"
    if isinstance(sample, ImuSample):
        assert all(abs(value) <= LIMIT for value in (*sample.acceleration, *sample.rate))
    if isinstance(sample, PacketSample):
        ticks = [sample.transmit, *(one.ticks for one in sample.received)]
        assert all(0 <= one < 1 << 40 for one in ticks), f"{proto}: ticks {ticks}"
        assert sample.sequence >= 0
    assert sample.device_ns is None or abs(sample.device_ns) < 1 << 63, f"{proto}: time"


def run(first, count, proto=None):
    """Findings of `count` cases from `first` on, or of those of one protocol: (number, text)."""
    findings = []
    for seed in range(first, first + count):
        if proto not in {None, PROTOCOLS[seed % len(PROTOCOLS)]}:
            continue
        began = time.process_time()
        try:
            check(seed)
        except Exception:  # noqa: BLE001 - findings are collected
            lines = traceback.format_exc().splitlines()
            findings.append((seed, " | ".join(line.strip() for line in lines[-5:])))
        took = time.process_time() - began
        if took > SECONDS:
            findings.append((seed, f"took {took:.1f} s"))
    return findings


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case of all")
    parser.add_argument("--first", type=int, help="number of the case to go on from")
    parser.add_argument("--proto", choices=PROTOCOLS, help="only the cases of one protocol")
    given = parser.parse_args()
    begin, end = given.seed, given.seed + given.count
    begin = max(begin, begin if given.first is None else given.first)
    found = 0
    for first in range(begin, end, 10_000):
        count = min(10_000, end - first)
        for seed, text in run(first, count, given.proto):
            found += 1
            print(f"{seed}: {text}", flush=True)
        print(f"done up to {first + count}, {found} findings", file=sys.stderr, flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if peak > MEGABYTES:
        found += 1
        print(f"{peak:.0f} MB of memory")
    print(f"{max(end - begin, 0)} cases from {begin} on, {found} findings, {peak:.0f} MB")
    return 1 if found > 0 else 0


if __name__ == "__main__":
    raise SystemExit(main())
