"""What was counted of one source."""

from __future__ import annotations

from dataclasses import dataclass, field


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
    restarts: int = 0
    """Times that a device began again."""
    first_stamp_ns: int | None = None
    last_stamp_ns: int | None = None
    reached_ns: int | None = None
    """Latest stamp of a sample, of those that are no message, too (steering)."""
    arrived_ns: int | None = None
    """When bytes came last."""
    first_arrival_ns: int | None = None
    unknown_ids: dict[str, int] = field(default_factory=dict)
    """Samples of ids that the map lacks."""
    named: dict[str, str] = field(default_factory=dict)
    """From ids to names that no map gave."""
    decoder_error: str = ""
    """What its decoder raised last, which no decoder should."""
    unknown_turns: int = 0
    """Odometry samples whose turn rate nobody knows."""
    last_value: tuple[str, str, float] | None = None
    """What came last: kind, whose, value (SI units)."""
