"""Memory of a process that reads much and keeps little."""

from __future__ import annotations

MALLOPT_MMAP_THRESHOLD = -3
"""glibc's M_MMAP_THRESHOLD."""
MMAP_THRESHOLD_BYTES = 1 << 16


def return_freed_memory() -> None:
    """Let freed arrays go back to the system at once, where the C library can do that.

    glibc otherwise keeps what is below 32 MB, and the holes between arrays of a large log come to
    half of what they hold.
    """
    import ctypes

    try:
        ctypes.CDLL(None).mallopt(MALLOPT_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES)
    except (OSError, AttributeError):  # another C library
        return
