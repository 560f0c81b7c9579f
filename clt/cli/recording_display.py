"""What a terminal shows while devices are recorded; elsewhere a line every ten seconds."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Protocol

from clt.cli.console import Console
from clt.cli.reports.record_report import size_text
from clt.core.arrays import NS_PER_SECOND
from clt.devices.recorder.status import SourceStatus, Status

if TYPE_CHECKING:
    from rich.table import Table

LINE_PERIOD_S = 10.0
UNITS = {"range": "m", "odometry": "m/s", "packet": "", "pose": "m", "steering": "rad"}


class Display(Protocol):
    """Shows the state of a recording."""

    def show(self, status: Status) -> None:
        """Show the newest state."""

    def clear(self) -> None:
        """Make room for a line of text."""


@contextmanager
def open_display(console: Console) -> Iterator[Display]:
    """A display on standard error that suits it."""
    if console.quiet:
        yield LineDisplay(console)
        return
    if not sys.stderr.isatty():
        yield LineDisplay(console)
        return
    from rich.console import Console as Terminal
    from rich.live import Live

    terminal = Terminal(stderr=True)
    with Live(console=terminal, transient=True, auto_refresh=False, redirect_stderr=True) as live:

        class LiveDisplay:
            """A table that is drawn again in place."""

            def __init__(self) -> None:
                self._rates = Rates()

            def show(self, status: Status) -> None:
                live.update(status_table(status, self._rates.take(status)), refresh=True)

            def clear(self) -> None:
                """Rich moves the table below what is printed."""

        yield LiveDisplay()


class LineDisplay:
    """One line every ten seconds, silent with -q."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._next_s = LINE_PERIOD_S
        self._rates = Rates()

    def show(self, status: Status) -> None:
        if status.elapsed_s < self._next_s:
            return
        self._next_s = status.elapsed_s + LINE_PERIOD_S
        rates = self._rates.take(status)
        parts = [source_text(one, rates[one.name], status.now_ns) for one in status.sources]
        size = size_text(status.log_bytes)
        self._console.say(f"{status.elapsed_s:.0f} s, {size}; " + "; ".join(parts))

    def clear(self) -> None:
        """Lines need no room."""


class Rates:
    """Frames per second of every source, between two looks."""

    def __init__(self) -> None:
        self._before: dict[str, tuple[float, int]] = {}

    def take(self, status: Status) -> dict[str, float]:
        """The rates since the last look at least a second ago."""
        rates = {}
        for name, tally, _ in status.sources:
            time, frames = self._before.get(name, (0.0, 0))
            elapsed = status.elapsed_s - time
            rates[name] = (tally.frames - frames) / elapsed if elapsed > 0.0 else 0.0
            if elapsed >= 2.0:
                middle = (status.elapsed_s - 1.0, tally.frames - round(rates[name]))
                self._before[name] = middle
        return rates


def age_text(source: SourceStatus, now_ns: int) -> str:
    """How long nothing has come."""
    arrived = source.tally.arrived_ns
    if not source.connected and arrived is not None:
        return f"gone {(now_ns - arrived) / NS_PER_SECOND:.1f} s"
    return "nothing yet" if arrived is None else f"{(now_ns - arrived) / NS_PER_SECOND:.1f} s ago"


def value_text(source: SourceStatus) -> str:
    """What came last."""
    value = source.tally.last_value
    if value is None:
        return "-"
    kind, whose, number = value
    return f"{kind} {whose} {number:.3f} {UNITS[kind]}".rstrip()


def source_text(source: SourceStatus, rate: float, now_ns: int) -> str:
    """One source in a few words."""
    tally = source.tally
    return (
        f"{source.name} {rate:.0f} frames/s, {value_text(source)}, {tally.bad_frames} bad, "
        f"{tally.skipped_bytes} bytes skipped, {tally.lost} lost, {age_text(source, now_ns)}"
    )


def status_table(status: Status, rates: dict[str, float]) -> Table:
    """A line for each source, and one for the log."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("source", "frames/s", "last value", "bad", "skipped", "lost", "last bytes"):
        table.add_column(title, justify="left" if title in {"source", "last value"} else "right")
    for one in status.sources:
        tally = one.tally
        table.add_row(
            one.name,
            f"{rates[one.name]:.0f}",
            value_text(one),
            str(tally.bad_frames),
            size_text(tally.skipped_bytes),
            str(tally.lost),
            age_text(one, status.now_ns),
        )
    table.caption = (
        f"{status.elapsed_s:.0f} s, log {size_text(status.log_bytes)}, queue "
        f"{100 * status.inbox_fill:.0f} %; Ctrl-C ends the recording"
    )
    return table
