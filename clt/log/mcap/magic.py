"""What a file is that does not begin as MCAP does, from its first bytes."""

from __future__ import annotations

from clt.log.mcap.records import MCAP_MAGIC

OTHER_FORMATS = {
    b"\x28\xb5\x2f\xfd": "is compressed as a whole (zstd); unpack it first: zstd -d",
    b"\x04\x22\x4d\x18": "is compressed as a whole (lz4); unpack it first: lz4 -d",
    b"\x1f\x8b": "is compressed as a whole (gzip); unpack it first: gunzip",
    b"SQLite format 3": "is a rosbag2 database (.db3), not MCAP, and is read only as a file",
    b"#ROSBAG V": "is a ROS 1 bag, not MCAP; convert it: rosbags-convert",
    MCAP_MAGIC[:5] + b"\n": "had its line endings changed on the way; copy it again as binary",
    MCAP_MAGIC[:6] + b"\n": "had its line endings changed on the way; copy it again as binary",
}


def explain_not_mcap(start: bytes) -> str:
    """Why a file cannot be read as MCAP, given its first bytes (at least 16 if it has them)."""
    if len(start) == 0:
        return "is empty"
    for prefix, text in OTHER_FORMATS.items():
        if start.startswith(prefix):
            return text
    if (
        start[:5] == MCAP_MAGIC[:5]
        and start[6:8] == MCAP_MAGIC[6:]
        and start[5:6] != MCAP_MAGIC[5:6]
    ):
        return f"is MCAP of the unknown version {chr(start[5])!r}; clt reads version '0'"
    if MCAP_MAGIC.startswith(start):
        return f"holds only the first {len(start)} bytes of a log"
    return "is not an MCAP log, nor a .db3 file; `clt import --list` names other formats"
