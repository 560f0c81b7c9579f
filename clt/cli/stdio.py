"""Standard streams that any text can go to, and that may be closed."""

from __future__ import annotations

import os
import sys
from typing import TextIO, cast


def prepare_stdio() -> None:
    """Let text that a terminal cannot show become `?`, and stand in for closed streams.

    Writing to a closed standard output then fails like any other write; what is said on a closed
    standard error is lost.
    """
    if sys.stdout is None:
        sys.stdout = _stand_in(os.O_RDONLY)
    if sys.stderr is None:
        sys.stderr = _stand_in(os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="replace")


def _stand_in(mode: int) -> TextIO:
    """A text stream on the null device; opened for reading, it refuses every write."""
    return cast("TextIO", os.fdopen(os.open(os.devnull, mode), "w", encoding="utf-8"))
