"""The records of a container in which some lengths are wrong: a chunk without a checksum."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from clt.core.arrays import Bytes
from clt.log.mcap.byte_source import ByteSource
from clt.log.mcap.records import CHANNEL, MESSAGE, RECORD_HEAD, SCHEMA
from clt.log.mcap.resync import SearchBudget, skip_to_sound_record
from clt.log.mcap.table import ContainerRecords, walk_records


@dataclass(frozen=True)
class Salvaged:
    """What a damaged container still holds."""

    walk: ContainerRecords
    """All records that were found; `stop` is where the last ones end."""
    passed: int
    """Bytes between them that make no sense."""


def salvage(data: Bytes, walk: ContainerRecords, effort: SearchBudget) -> Salvaged:
    """Go on behind `walk`, which ended before the end of a container.

    Where a walk ends, either the record there has a wrong length or the last one before it had: the
    next sound record is searched from that one on, and if it lies inside it, that one is dropped.
    """
    source = ByteSource(BytesIO(data.data), "chunk")
    starts, others = [walk.starts], [*walk.others]
    passed, doubtful = 0, walk.doubtful
    while walk.stop < len(data):
        found = _next(source, walk.last, effort)
        if found is None:
            break
        if found < walk.stop:
            starts[-1] = starts[-1][starts[-1] != walk.last]
            others = [one for one in others if one[1] != walk.last + RECORD_HEAD.size]
        passed += found - (walk.last if found < walk.stop else walk.stop)
        walk = walk_records(data.data, found, len(data))
        doubtful += walk.doubtful
        starts.append(walk.starts)
        others += walk.others
    whole = ContainerRecords(np.concatenate(starts), others, walk.stop, walk.last, doubtful)
    return Salvaged(whole, passed)


def _next(source: ByteSource, behind: int, effort: SearchBudget) -> int | None:
    """Where the next sound record that a chunk may hold begins, after `behind`."""
    source.skip(behind + 1 - source.position)
    while skip_to_sound_record(source, effort):
        if source.peek(1)[0] in {SCHEMA, CHANNEL, MESSAGE}:
            return source.position
        source.skip(1)
    return None
