"""Standard error that may go away: a terminal that is closed, a pipe that nobody reads any more.

What cannot be said is lost; what goes on, a recording, is not ended by it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from typing import Any


class LastingStream:
    """A stream of text whose failures to write are passed over."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        """Write, if it can be."""
        with suppress(OSError, ValueError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, if it can be."""
        with suppress(OSError, ValueError):
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


@contextmanager
def lasting_stderr() -> Iterator[None]:
    """Within it nothing that is said on standard error raises OSError."""
    lasting: Any = LastingStream(sys.stderr)
    with redirect_stderr(lasting):
        yield
