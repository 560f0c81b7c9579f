"""Ranging a log of raw packets, and what is said and kept of it."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

from clt.cli.compiling import announce_compilation
from clt.cli.console import Console
from clt.core.recording import Recording
from clt.ranging.recover import COMMON_CLOCK, RangedRecording, range_packets

RANGING_METHOD_TITLES = {"clock": "clock filters", "double-sided": "double-sided ranging"}


def ranging_document(found: RangedRecording) -> dict[str, object]:
    """What was learnt, for `clt.run` and --json."""
    return {
        "method": found.method,
        "why": found.why,
        "rate": found.rate,
        "correlation_time": found.correlation_time,
        "common_clock": COMMON_CLOCK,
        "pairs": [{"ends": list(ends), **asdict(clocks)} for ends, clocks in found.clocks.items()],
    }


def print_ranging_summary(console: Console, found: RangedRecording) -> None:
    """A few lines for people."""
    count = found.recording.ranges.stamp.size
    console.say(
        f"UWB packets: {count} ranges of {len(found.clocks)} pairs by "
        f"{RANGING_METHOD_TITLES[found.method]} "
        f"({found.why})"
    )
    for (a, b), one in found.clocks.items():
        console.detail(
            f"  {a} - {b}: {one.ranges} ranges, sigma {100 * one.sigma:.1f} cm, "
            f"{one.rejected} packets rejected, skew {1e6 * one.skew:+.4f} ppm"
        )


def recover_ranges(recording: Recording, console: Console) -> Recording:
    """The recording with ranges and odometry out of its packets, by the method that suits them."""
    with announce_compilation(console):
        found = range_packets(recording)
    print_ranging_summary(console, found)
    run = {**recording.run, "ranging": json.dumps(ranging_document(found))}
    return replace(found.recording, run=run)
