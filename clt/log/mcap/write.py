"""Write whole channels of messages as an MCAP log, without an object per message.

The same channels give the same bytes. Messages lie in order of log time (stable), payloads are
encoded a few chunks at a time, and nothing is ever sought, so pipes work.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import BinaryIO

import numpy as np

from clt.core.errors import LogError
from clt.core.recording import Attachment
from clt.log.mcap.log_file import Compression, LogFile, MessageIndex
from clt.log.mcap.plan import OutputChannel, WritePlan


def write_log(
    file: BinaryIO,
    channels: Sequence[OutputChannel],
    metadata: Mapping[str, Mapping[str, str]] | None = None,
    attachments: Iterable[Attachment] = (),
    compression: Compression = "zstd",
) -> None:
    """Write a complete log: metadata, attachments, channels, chunks with indexes, summary.

    Raises LogError for a log time before zero, which MCAP cannot hold.
    """
    writer = LogFile(file, compression)
    writer.start()
    writer.define([(channel.topic, channel.schema) for channel in channels])
    for name, record in (metadata or {}).items():
        writer.metadata(name, record)
    begin = min((int(c.log_time.min()) for c in channels if c.log_time.size > 0), default=0)
    if begin < 0:
        raise LogError(f"log time {begin} ns: MCAP holds none before zero")
    for attachment in attachments:
        writer.attachment(attachment, begin)
    plan = WritePlan.of(channels)
    for first, last in plan.batches():
        buffer = plan.fill(channels, first, last)
        base = int(plan.start[plan.cuts[first]])
        for chunk in range(first, last):
            _write_chunk(writer, plan, chunk, buffer, base)
    writer.counts = {
        number: channel.log_time.size
        for number, channel in enumerate(channels, 1)
        if channel.log_time.size > 0
    }
    writer.finish()


def _write_chunk(
    writer: LogFile, plan: WritePlan, number: int, buffer: memoryview, base: int
) -> None:
    """One chunk and its message indexes; `buffer` starts at byte `base` of all chunks."""
    low, high = plan.cuts[number], plan.cuts[number + 1]
    begin, end = int(plan.start[low]), int(plan.start[high])
    indexes = []
    for channel, rank in enumerate(plan.rank, 1):
        a, b = np.searchsorted(rank, [low, high])
        if a < b:
            pairs = np.empty((b - a, 2), "<u8")
            pairs[:, 0] = plan.log_time[rank[a:b]]
            pairs[:, 1] = plan.start[rank[a:b]] - begin
            indexes.append(MessageIndex(channel, int(b - a), pairs.tobytes()))
    writer.chunk(
        buffer[begin - base : end - base],
        int(plan.log_time[low]),
        int(plan.log_time[high - 1]),
        indexes,
    )
