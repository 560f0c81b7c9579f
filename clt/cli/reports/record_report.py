"""What `clt record` prints at its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TextIO

from clt.core.printable import printable
from clt.devices.intake.tally import Tally


def size_text(size: float) -> str:
    """Bytes as people say them."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000 or unit == "GB":
            break
        size /= 1000
    return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"


def print_record_summary(
    logs: Sequence[str],
    duration_s: float,
    tallies: Mapping[str, Tally],
    log_bytes: int,
    out: TextIO,
) -> None:
    """One line for the log, one for each source."""
    more = "" if len(logs) == 1 else f" to {logs[-1]}"
    print(printable(f"{logs[0]}{more}: {duration_s:.1f} s, {size_text(log_bytes)}"), file=out)
    width = max(len(name) for name in tallies)
    for name, tally in tallies.items():
        counts = (
            f"{size_text(tally.bytes)}, {tally.frames} frames, {tally.samples} samples, "
            f"{tally.skipped_bytes} bytes skipped, tail {tally.tail_bytes}, "
            f"{tally.bad_frames} bad frames, {tally.lost} lost, {tally.reconnects} reconnects"
        )
        print(printable(f"  {name:{width}}  {counts}"), file=out)
