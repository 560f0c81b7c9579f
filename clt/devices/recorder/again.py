"""The raw bytes of a log that was recorded, decoded again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from clt.core.arrays import NS_PER_SECOND
from clt.core.diagnostics import Diagnostic
from clt.core.errors import LogError
from clt.core.recording import Team
from clt.devices.intake.carried import join_team, read_carried, take_over_losses
from clt.devices.intake.intake import Intake
from clt.devices.intake.team import GrowingTeam
from clt.devices.recorder.status import RecorderOptions
from clt.devices.storage.log_parts import LogParts, free_bytes
from clt.devices.storage.messages import LOG_TYPE
from clt.devices.storage.raw_log import OldEvent, RawLog
from clt.log.mcap.live_writer import DiskFullError

CHECK_EVENTS = 256
"""Between looks at the disk."""


def intake_again(
    raw: RawLog, parts: LogParts, start_ns: int, known: Team | None, count: int | None
) -> Intake:
    """An intake that goes on where the part before the log ended, if there was one.

    Raises LogError for a record of that which makes no sense.
    """
    team, carried = GrowingTeam(known), None
    if raw.carried is not None:
        carried = read_carried(raw.carried, str(raw.path))
        join_team(team, raw.team)
    try:
        return Intake(parts, raw.sources, team, start_ns, count, carried=carried)
    except LogError as error:
        raise LogError(f"{raw.path}: {error}") from None


def decode_again(
    raw: RawLog,
    intake: Intake,
    parts: LogParts,
    options: RecorderOptions,
    on_event: Callable[[Diagnostic], None],
) -> float:
    """Decode all of a log, or as long as the options say; returns how long it was recorded, s."""
    begin: int | None = None
    last = 0
    try:
        for number, event in enumerate(raw.events()):
            at = event.log_time if isinstance(event, OldEvent) else event.chunk.host_ns
            begin = at if begin is None else begin
            duration = options.duration_s
            if duration is not None and at - begin >= duration * NS_PER_SECOND:
                break
            last = at
            if isinstance(event, OldEvent):
                log_time = intake.log_time(last)
                parts.write(parts.channel("/clt/log", LOG_TYPE), log_time, log_time, event.payload)
            else:
                intake.take(event.source, event.chunk)
            low = number % CHECK_EVENTS == 0 and _is_low(parts.paths[-1], options, on_event)
            if intake.full or low:
                break
        take_over_losses(raw.losses, intake.tallies)
        intake.finish()
        parts.finish()
    except DiskFullError:
        parts.close_full()
        on_event(Diagnostic("disk_full", str(parts.paths[-1]), "partial"))
    return (last - (last if begin is None else begin)) / NS_PER_SECOND


def _is_low(path: Path, options: RecorderOptions, on_event: Callable[[Diagnostic], None]) -> bool:
    free = free_bytes(path)
    if free is None or free >= options.min_free_bytes:
        return False
    on_event(Diagnostic("disk_low", str(path), "partial", {"free_bytes": free}))
    return True
