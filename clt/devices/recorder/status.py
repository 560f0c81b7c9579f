"""How a recording goes, and what a display shows of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from clt.devices.intake.tally import Tally

BUSY_FILL = 0.5
"""From this fill of the inbox on, what cannot wait is kept raw only."""


@dataclass(frozen=True)
class RecorderOptions:
    """How a recording goes and when it ends."""

    duration_s: float | None = None
    count: int | None = None
    """Messages other than raw."""
    stall_s: float = 5.0
    reconnect: bool = True
    min_free_bytes: int = 0
    busy_fill: float = BUSY_FILL
    splits: bool = False
    """Into several files, each of which holds whole reads."""


class SourceStatus(NamedTuple):
    """What a display shows of one source."""

    name: str
    tally: Tally
    connected: bool


class Status(NamedTuple):
    """What a display shows."""

    elapsed_s: float
    log_bytes: int
    inbox_fill: float
    now_ns: int
    sources: tuple[SourceStatus, ...]
