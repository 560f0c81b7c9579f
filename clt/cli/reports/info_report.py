"""A log's contents as tables for people."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import TextIO

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from clt.cli.reports.topics import MAX_TOPIC_ROWS as MOST
from clt.cli.reports.topics import guesses_by_topic, topic_table, unread_topics
from clt.core.printable import count_text, printable
from clt.core.printable import printable_name as shown
from clt.core.recording import WORLD_FRAME, Recording
from clt.log.recording.load import LoadedLog
from clt.log.recording.summary import LogSummary, StreamTiming

MAX_RATE_PAIRS = 20
"""Pairs in the table; the rest is in the JSON."""
ROLE_TITLES = {
    "odometry": "odometry",
    "frames": "UWB packets",
    "truth": "truth",
    "estimate": "estimate",
    "dead_reckoning": "dead reckoning",
}
PRINTED_RUN_KEYS = ("command", "version", "filter", "frame", "init", "seed")
"""What is said about the run that made a log; the rest is in the JSON."""


def print_info(loaded: LoadedLog, summary: LogSummary, file: TextIO) -> None:
    """Print what is in a log."""
    console = Console(highlight=False, file=file)
    if not console.is_terminal:
        console.width = 100
    recording = loaded.recording
    for line in info_heading(loaded, summary):
        console.print(Text(printable(line)), soft_wrap=True)
    if len(recording.team.robots) > 0:
        console.print(robot_table(recording, summary))
    if len(summary.pairs) > 0:
        console.print(pair_rate_table(summary.pairs))
        if len(summary.pairs) > MAX_RATE_PAIRS:
            more = count_text(len(summary.pairs) - MAX_RATE_PAIRS, "more pair")
            console.print(f"{more}: clt info --json\n")
    rest = unread_topics(loaded)
    if len(rest) > 0:
        about = guesses_by_topic(loaded)
        console.print(topic_table(rest, about))
        if len(about) > 0:
            console.print("clt streams drafts a file for --streams that names these topics\n")
        if len(rest) > MOST:
            console.print(f"{count_text(len(rest) - MOST, 'more topic')}: clt info --json\n")


def info_heading(loaded: LoadedLog, summary: LogSummary) -> list[str]:
    """What the log is and what it holds, line by line."""
    recording = loaded.recording
    team = recording.team
    lines = [
        f"{loaded.path}: {duration_text(summary)}",
        f"written by {loaded.library or 'unknown'}",
    ]
    ranges, pairs = (
        count_text(len(recording.ranges.stamp), "range"),
        count_text(len(summary.pairs), "pair"),
    )
    counts = [f"{ranges} of {pairs}"]
    if summary.innovations > 0:
        number = count_text(summary.innovations, "innovation")
        counts.append(f"{number}, {summary.accepted} accepted")
    lines.append(f"{len(team.moving)} moving and {len(team.static)} static robots")
    lines.append("; ".join(counts))
    lines.append("truth: " + (", ".join(recording.truth) or "none"))
    lines += [f"{key}: {recording.run[key]}" for key in PRINTED_RUN_KEYS if key in recording.run]
    if len(recording.attachments) > 0:
        lines.append("attachments: " + ", ".join(item.name for item in recording.attachments))
    count = sum(fault.count for fault in recording.faults)
    lines.append("no faults" if count == 0 else f"{count_text(count, 'fault')}, see standard error")
    return lines


def duration_text(summary: LogSummary) -> str:
    """Duration, and the date where the stamps are one."""
    if summary.start is None:
        return "no streams that clt knows"
    year = 1970 + summary.start / 31_556_952e9
    when = ""
    if 1990.0 < year < 2100.0:
        when = f" from {datetime.fromtimestamp(summary.start / 1e9, UTC):%Y-%m-%d %H:%M:%S} UTC"
    return f"{summary.duration:.1f} s{when}"


def robot_table(recording: Recording, summary: LogSummary) -> Table:
    """One row per robot, one column per stream that any robot has."""
    table = Table(box=SIMPLE_HEAD)
    present = [role for role in ROLE_TITLES if len(summary.streams[role]) > 0]
    for title in ("robot", "id", "role", *(ROLE_TITLES[role] for role in present)):
        table.add_column(title)
    for robot in recording.team.robots:
        role = "moving"
        if robot.static and robot.position is not None:
            role = "static at ({:g}, {:g}) m".format(*robot.position)
            role += f" in {recording.team.frame}" if recording.team.frame != WORLD_FRAME else ""
        elif robot.static:
            role = "static, position unknown"
        cells = [timing_text(summary.streams[kind].get(robot.name)) for kind in present]
        table.add_row(robot.name, str(robot.id), Text(shown(role)), *cells)
    return table


def pair_rate_table(found: Mapping[tuple[str, str], StreamTiming]) -> Table:
    """One row per pair of robots."""
    table = Table(box=SIMPLE_HEAD)
    table.add_column("pair")
    for title in ("ranges", "rate, Hz", "longest gap, s", "gaps"):
        table.add_column(title, justify="right")
    for (source, target), one in list(found.items())[:MAX_RATE_PAIRS]:
        rate = "-" if one.rate is None else f"{one.rate:.1f}"
        longest = "-" if one.longest_gap is None else f"{one.longest_gap:.3g}"
        table.add_row(f"{source} -> {target}", str(one.count), rate, longest, str(one.gaps))
    return table


def timing_text(one: StreamTiming | None) -> str:
    """Count, rate and gaps in short."""
    if one is None:
        return "-"
    rate = "" if one.rate is None else f" at {one.rate:.1f} Hz"
    gaps = "" if one.gaps == 0 else f", {one.gaps} gaps up to {one.longest_gap:.3g} s"
    return f"{one.count}{rate}{gaps}"
