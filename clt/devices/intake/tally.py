"""What was counted of one source."""

from __future__ import annotations

from dataclasses import dataclass, field

MAX_UNKNOWN_IDS = 64
"""Ids that are counted one by one."""


@dataclass
class Tally:
    """Counts of one source so far; times in ns."""

    proto: str
    bytes: int = 0
    frames: int = 0
    """Whole frames or lines that were understood."""
    samples: int = 0
    """Messages that came of them."""
    skipped_bytes: int = 0
    """Bytes in no frame."""
    damaged_bytes: int = 0
    """Of those, the ones behind the first frame of a connection."""
    tail_bytes: int = 0
    """Bytes of an unfinished last frame."""
    bad_frames: int = 0
    """Frames that were recognized and refused, and samples without sense."""
    lost: int = 0
    """Datagrams, CAN frames or reads that are known to be lost."""
    undecoded_bytes: int = 0
    """Kept raw only, because decoding did not keep up."""
    reconnects: int = 0
    earlier: dict[str, int] = field(default_factory=dict)
    """Of these counts, what happened when the bytes were recorded that are now decoded again."""
    restarts: int = 0
    """Times that a device began again."""
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    reached_ns: int | None = None
    """Latest stamp of a sample, of those that are no message, too (steering)."""
    arrived_ns: int | None = None
    """When bytes came last."""
    first_arrival_ns: int | None = None
    live: bool = False
    """Its bytes come from a device, not from a file or a pipe."""
    mapped: bool = False
    """A map names its robots."""
    unknown_ids: dict[str, int] = field(default_factory=dict)
    """Samples of ids without a robot: the map lacks them, or there are too many. The first
    MAX_UNKNOWN_IDS of them."""
    more_unknown: int = 0
    """Samples of all further such ids."""
    named: dict[str, str] = field(default_factory=dict)
    """From ids to names that no map gave."""
    clockless: int = 0
    """Samples whose clock found no room among all that the device named."""
    first_bad_line: tuple[int, str] | None = None
    """Of text: number (from 1) and beginning of the first line that was refused."""
    decoder_error: str = ""
    """What its decoder raised last, which no decoder should."""
    unknown_turns: int = 0
    """Odometry samples whose turn rate nobody knows."""
    last_value: tuple[str, str, float] | None = None
    """What came last: kind, whose, value (SI units)."""

    def note_unknown(self, device_id: str) -> None:
        """Count a sample of an id that has no robot."""
        if device_id in self.unknown_ids or len(self.unknown_ids) < MAX_UNKNOWN_IDS:
            self.unknown_ids[device_id] = self.unknown_ids.get(device_id, 0) + 1
        else:
            self.more_unknown += 1
