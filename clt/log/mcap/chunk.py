"""Inflate one chunk within bounds and hold it against its checksum."""

from __future__ import annotations

import zlib

import lz4.frame
import zstandard

from clt.log.mcap.records import Chunk, DamagedError

MAX_CHUNK_BYTES = 256 << 20
"""Largest chunk that is read, bytes, packed or not."""
FREE_INFLATED_BYTES = 256 << 20
MAX_INFLATION_RATIO = 100
"""A log's chunks inflate to at most FREE_INFLATED_BYTES + MAX_INFLATION_RATIO times its bytes."""


def inflate_chunk(chunk: Chunk, allowed: int = MAX_CHUNK_BYTES) -> bytes | memoryview:
    """The records inside a chunk, at most `allowed` bytes of them.

    Raises DamagedError; allocates at most the claimed size.
    """
    if chunk.size > MAX_CHUNK_BYTES:
        raise DamagedError(
            f"{chunk.size} bytes are beyond the limit of {MAX_CHUNK_BYTES >> 20} MiB"
        )
    if chunk.size > allowed:
        raise DamagedError(
            f"the log inflates to more than {MAX_INFLATION_RATIO} times its size: a zip bomb?"
        )
    match chunk.compression:
        case "":
            data: bytes | memoryview = chunk.data
        case "zstd":
            data = _zstd(chunk)
        case "lz4":
            data = _lz4(chunk)
        case other:
            raise DamagedError(f"unknown compression {other[:20]!r}")
    if len(data) != chunk.size:
        raise DamagedError(f"it holds {len(data)} bytes and claims {chunk.size}")
    if chunk.crc not in {0, zlib.crc32(data)}:
        raise DamagedError("its checksum does not match")
    return data


def _zstd(chunk: Chunk) -> bytes:
    """A frame that knows its size must agree first; one that does not is cut at the claim."""
    try:
        size = zstandard.frame_content_size(chunk.data)
        if size not in {-1, chunk.size}:
            raise DamagedError(f"it inflates to {size} bytes and claims {chunk.size}")
        if chunk.size == 0:
            return b""
        return zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=chunk.size)
    except zstandard.ZstdError as error:
        raise DamagedError(f"zstd: {error}") from None


def _lz4(chunk: Chunk) -> bytes:
    """One byte more than the claim is asked for, so that a longer chunk shows."""
    frame = lz4.frame.LZ4FrameDecompressor()
    try:
        data: bytes = frame.decompress(chunk.data, max_length=chunk.size + 1)
    except (RuntimeError, EOFError) as error:
        raise DamagedError(f"lz4: {error}") from None
    if not frame.eof and len(data) <= chunk.size:
        raise DamagedError("lz4: the frame is cut off")
    return data
