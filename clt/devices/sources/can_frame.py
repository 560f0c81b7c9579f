"""CAN frames as the bytes that decoders are fed: 16 bytes each, as Linux passes them."""

from __future__ import annotations

import struct

CAN_FRAME = struct.Struct("<IB3x8s")
"""Identifier and flags, number of data bytes, data (padded with zeros)."""
EXTENDED_FLAG = 0x8000_0000
REMOTE_FLAG = 0x4000_0000
MAX_CAN_DATA = 8


def can_frame_bytes(identifier: int, data: bytes) -> bytes:
    """The bytes of one frame; `identifier` with its flags."""
    return CAN_FRAME.pack(identifier, len(data), data)
