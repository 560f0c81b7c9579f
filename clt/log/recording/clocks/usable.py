"""The part of a recording that an estimate may use: one whose clocks hold together."""

from __future__ import annotations

from dataclasses import dataclass

from clt.core.recording import Recording
from clt.log.recording.clocks.excerpt import extract_part
from clt.log.recording.clocks.parts import LogPart
from clt.log.recording.clocks.timeline import Timeline, find_timeline


@dataclass(frozen=True)
class UsablePart:
    """One part of a recording."""

    recording: Recording
    timeline: Timeline | None = None
    """What is wrong with the whole in time; None where nothing is, and the part is the whole."""
    part: LogPart | None = None
    lost: tuple[str, ...] = ()
    """odometry, ranges: what the whole has and the part does not, so that it is of no use."""

    @property
    def cut(self) -> bool:
        """Something of the whole is left out."""
        timeline, part = self.timeline, self.part
        if timeline is None or part is None:
            return False
        return len(timeline.parts) > 1 or len(timeline.left_out(part)) > 0


def find_usable_part(recording: Recording) -> UsablePart:
    """Of several parts (see `timeline`) the one with the most messages."""
    timeline = find_timeline(recording, results=True)
    if timeline is None:
        return UsablePart(recording)
    part = timeline.parts[0]
    chosen = extract_part(recording, timeline, part)
    counts = (
        ("odometry", len(recording.odometry), len(chosen.odometry)),
        ("ranges", recording.ranges.stamp.size, chosen.ranges.stamp.size),
    )
    lost = tuple(what for what, before, after in counts if before > 0 and after == 0)
    return UsablePart(chosen, timeline, part, lost)
