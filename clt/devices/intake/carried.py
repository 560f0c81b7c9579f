"""What the next part of a log needs to be decoded by itself: clocks, poses, losses, as metadata.

A part of a recording begins with a record of this; `clt record --from PART` goes on from there.
What a decoder keeps beside unfinished bytes (turns of short counters) is not carried.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from typing import Any

from clt.core.errors import LogError
from clt.devices.decoders.decoder import Decoder
from clt.devices.intake.sample_writer import SampleWriter
from clt.devices.intake.tally import Tally
from clt.devices.intake.team import GrowingTeam
from clt.devices.stamping.stamping import Stamping
from clt.devices.storage.raw_log import CARRIED_RECORD
from clt.log.recording.metadata import decode_team

MAX_TAIL_BYTES = 1 << 17

Carried = Mapping[str, Mapping[str, Any]]
"""State of every stream, by source and number."""


def stream_state(
    decoder: Decoder, stamping: Stamping, writer: SampleWriter, tail: bytes, joining: int
) -> dict[str, Any]:
    """What a stream needs to go on, for JSON; `tail` are the bytes of an unfinished frame."""
    return {
        "stamps": stamping.state(decoder.counts.frames),
        "tail": base64.b64encode(tail[:MAX_TAIL_BYTES]).decode(),
        "joining": joining,
        "counters": {name: counter[0] for name, counter in writer.counters.items()},
        "poses": {
            name: [one.x, one.y, one.heading, one.stamp] for name, one in writer.reckonings.items()
        },
    }


def resume_stream(
    state: Mapping[str, Any], decoder: Decoder, stamping: Stamping, writer: SampleWriter
) -> tuple[bytes, int]:
    """Let a new stream go on from such a state; returns its tail and `joining`.

    Raises LogError for a state that makes no sense.
    """
    try:
        stamping.resume(state["stamps"])
        for name, counter in state["counters"].items():
            writer.counters[str(name)] = [int(counter)]
        for name, (x, y, heading, stamp) in state["poses"].items():
            robot = writer.team.robot(str(name), "")
            if robot is not None:
                one = writer.reckoning(robot)
                one.x, one.y, one.heading = float(x), float(y), float(heading)
                one.stamp = None if stamp is None else int(stamp)
        tail, joining = base64.b64decode(state["tail"])[:MAX_TAIL_BYTES], int(state["joining"])
    except (AttributeError, KeyError, OverflowError, TypeError, ValueError) as error:
        raise LogError(f"its record {CARRIED_RECORD} makes no sense: {error}") from None
    decoder.feed(tail)  # Its samples, if any, are in the part before.
    return tail, joining


def read_carried(record: Mapping[str, str], place: str) -> Carried:
    """The states of a metadata record. Raises LogError."""
    try:
        found = {str(source): dict(json.loads(text)) for source, text in record.items()}
    except (TypeError, ValueError) as error:
        raise LogError(f"{place}: its record {CARRIED_RECORD} makes no sense: {error}") from None
    return found


def losses_record(tallies: Mapping[str, Tally]) -> dict[str, str]:
    """What of the figures no bytes show: losses and reconnections of every source."""
    return {name: json.dumps([tally.lost, tally.reconnects]) for name, tally in tallies.items()}


def read_losses(record: Mapping[str, str]) -> dict[str, tuple[int, int]]:
    """Losses and reconnections by source; empty for a record that makes no sense."""
    try:
        pairs = {name: json.loads(text) for name, text in record.items()}
        return {name: (int(lost), int(again)) for name, (lost, again) in pairs.items()}
    except (TypeError, ValueError):
        return {}


def take_over_losses(records: Sequence[Mapping[str, str]], tallies: Mapping[str, Tally]) -> None:
    """Count what was lost while a log was recorded: from its first such record to its last."""
    if len(records) == 0:
        return
    before, after = read_losses(records[0]), read_losses(records[-1])
    for name, tally in tallies.items():
        (lost, again), (end_lost, end_again) = before.get(name, (0, 0)), after.get(name, (0, 0))
        tally.earlier = {"lost": max(end_lost - lost, 0), "reconnects": max(end_again - again, 0)}
        tally.lost += tally.earlier["lost"]
        tally.reconnects += tally.earlier["reconnects"]


def join_team(team: GrowingTeam, record: Mapping[str, str]) -> None:
    """Take over the robots of the record `clt.team`. Raises LogError."""
    for robot in decode_team(record).robots:
        team.join(robot)
