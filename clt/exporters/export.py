"""What an exporter makes: files as values, which the command layer writes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording


@dataclass(frozen=True)
class ExportFile:
    """One file."""

    name: str
    """Without a folder."""
    rows: int
    """Poses, or lines of a graph, or values of all arrays."""
    make: Callable[[], bytes]
    """The content, made when it is written, so that only one file is in memory at a time."""


@dataclass(frozen=True)
class Export:
    """All files of one export, and what had to be left out or assumed."""

    files: tuple[ExportFile, ...]
    frames: Mapping[str, str] = field(default_factory=dict)
    """The frame of the poses in a file, by its name."""
    diagnostics: tuple[Diagnostic, ...] = ()


class ExportFormat(NamedTuple):
    """One exportable format."""

    about: str
    """One line for `clt export --help`."""
    write: Callable[[Recording, str], Export]
    """From a recording and the name of its log, which names single files. Raises CltError for a
    recording that holds nothing of what the format carries."""
