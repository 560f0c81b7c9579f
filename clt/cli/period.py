"""`--from` and `--to`: which part of a log a command uses."""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from clt.cli.console import Console
    from clt.core.recording import Recording
    from clt.log.recording.clocks.parts import LogPart
    from clt.log.recording.clocks.timeline import Timeline
    from clt.log.recording.load import LoadedLog

FromOption = Annotated[
    str | None,
    typer.Option(
        "--from",
        metavar="T",
        help="Use the log from here on: seconds since its first stamp, or a time such as "
        "2025-01-31T12:00:00 (UTC) or in seconds since 1970.",
    ),
]
ToOption = Annotated[
    str | None, typer.Option("--to", metavar="T", help="Use it up to here; as --from takes it.")
]
MIN_UNIX_SECONDS = 1_000_000_000
"""Numbers from here on count from 1970 (this one is a day in 2001), smaller ones from the log."""
SECONDS_NUMBER_PATTERN = re.compile(r"[+-]?(\d+)(\.\d*)?")
STAMP_LIMITS_NS = (-(1 << 62), 1 << 62)
MAX_OTHER_PARTS = 3
"""So many other parts are listed."""


@dataclass(frozen=True)
class Instant:
    """A time that a user gave."""

    ns: int
    relative: bool
    """Since the first stamp of the log; otherwise since 1970."""

    def of(self, start: int) -> int:
        """The stamp (ns) in a log that begins at `start`."""
        return start + self.ns if self.relative else self.ns


@dataclass(frozen=True)
class Period:
    """From when until when; None: as far as the log goes."""

    since: Instant | None
    until: Instant | None


WHOLE_LOG = Period(None, None)


def parse_period(since: str | None, until: str | None) -> Period:
    """What `--from` and `--to` say. Raises UsageError for what is no time."""
    return Period(
        None if since is None else parse_instant("--from", since),
        None if until is None else parse_instant("--to", until),
    )


def parse_instant(option: str, text: str) -> Instant:
    """A time as a user writes it. Raises UsageError."""
    from clt.core.errors import UsageError

    try:
        if SECONDS_NUMBER_PATTERN.fullmatch(text) is not None:
            whole, _, part = text.partition(".")
            ns = int(whole + (part + "0" * 9)[:9])
            if STAMP_LIMITS_NS[0] < ns < STAMP_LIMITS_NS[1]:
                return Instant(ns, ns < MIN_UNIX_SECONDS * 1_000_000_000)
        time = datetime.fromisoformat(text)
        time = time.replace(tzinfo=UTC) if time.tzinfo is None else time
        since = time - datetime(1970, 1, 1, tzinfo=UTC)
        seconds = since.days * 86_400 + since.seconds
        return Instant(seconds * 1_000_000_000 + since.microseconds * 1000, relative=False)
    except (ValueError, OverflowError):
        raise UsageError(
            f"{option} {text}: give seconds since the log's first stamp, or a time such as "
            "2025-01-31T12:00:00"
        ) from None


def select_usable_part(loaded: LoadedLog, period: Period, console: Console) -> Recording:
    """What a command uses of a log, once its faults are said: one part that holds together.

    That is what the period leaves of it; of several parts in there (see
    `clt.log.recording.clocks.timeline`) the one with the most messages. Raises UsageError for a
    period without data, CltError where no part has both odometry and ranges though the log does.
    """
    from clt.core.diagnostics import Diagnostic
    from clt.core.errors import CltError
    from clt.log.recording.clocks.findings import CLOCK_FAULT_KINDS
    from clt.log.recording.clocks.timeline import timeline_faults
    from clt.log.recording.clocks.usable import find_usable_part

    whole = loaded.recording
    console.report_faults(fault for fault in whole.faults if fault.kind not in CLOCK_FAULT_KINDS)
    recording = cut_to_period(loaded, period)
    chosen = find_usable_part(recording)
    if chosen.timeline is None or chosen.part is None:
        return recording
    console.report_faults(timeline_faults(chosen.timeline, loaded.path))
    text = used_part_text(chosen.timeline, chosen.part)
    if len(text) > 0:
        console.report([Diagnostic("part_used", loaded.path, "partial", {"text": text})])
    if len(chosen.lost) > 0:
        raise CltError(
            f"{loaded.path}: no {' and no '.join(chosen.lost)} in the part with the most messages, "
            "as the clocks of this log disagree (clt info says how); --from and --to choose "
            "another part"
        )
    return chosen.recording


def cut_to_period(loaded: LoadedLog, period: Period) -> Recording:
    """What a period leaves of a log. Raises UsageError where that is nothing."""
    from clt.core.errors import UsageError
    from clt.log.recording.clocks.excerpt import cut_recording
    from clt.log.recording.clocks.findings import stamp_text
    from clt.log.recording.clocks.timeline import first_stamp

    recording = loaded.recording
    start = first_stamp(recording)
    if start is None or (period.since is None and period.until is None):
        return recording
    low = STAMP_LIMITS_NS[0] if period.since is None else period.since.of(start)
    high = STAMP_LIMITS_NS[1] if period.until is None else period.until.of(start)
    found = cut_recording(recording, low, high)
    if high < low or first_stamp(found) is None:
        raise UsageError(
            f"{loaded.path}: no data between --from and --to; the first stamp of the log is "
            f"{stamp_text(start)}"
        )
    return found


def used_part_text(timeline: Timeline, part: LogPart) -> str:
    """Which part is used, what of other clocks is not, and how to get other parts."""
    from clt.log.recording.clocks.findings import stamp_text

    every = sum(one.messages for one in timeline.parts)
    lines = []
    if len(timeline.parts) > 1:
        lines.append(
            f"only the part with the most messages ({part.messages} of {every}) is used, from "
            f"{stamp_text(part.begin)} to {stamp_text(part.end, later=True)}"
        )
    left = timeline.left_out(part)
    if len(left) > 0:
        lines.append(f"left out: {'; '.join(left)}")
    apart = [one for one in timeline.parts if one.end < part.begin or one.begin > part.end]
    others = [
        f"--from {stamp_text(one.begin)} --to {stamp_text(one.end, later=True)} "
        f"(messages: {one.messages})"
        for one in apart[:MAX_OTHER_PARTS]
    ]
    if len(apart) > MAX_OTHER_PARTS:
        others.append(f"{len(apart) - MAX_OTHER_PARTS} more")
    if len(others) > 0:
        lines.append(f"others: {', '.join(others)}")
    return "; ".join(lines)
