"""The table of a study, on standard output and, if wanted, in a file."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def publish(lines: Iterable[str], out: Path | None) -> None:
    """Print lines; write them to `out`, too."""
    text = "\n".join(lines) + "\n"
    print(text)
    if out is not None:
        out.write_text(text)
