"""CAN frames as the bytes that decoders are fed: 16 bytes each, as Linux passes them."""

from __future__ import annotations

import struct

CAN_FRAME = struct.Struct("<IB3x8s")
"""Identifier and flags, number of data bytes, data (padded with zeros)."""
