"""The files that a command reads: protected, hashed and attached to its result from one place."""

from __future__ import annotations

import io
import sys
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TextIO

from clt.core.document import Document
from clt.log import output as target

if TYPE_CHECKING:
    from clt.core.recording import Recording  # numpy, slow to import

TOML_MEDIA_TYPE = "application/toml"
ONE_COMMAND_ROLES = ("config", "poses")
"""Roles of documents that say nothing about the results of later commands."""


@dataclass(frozen=True)
class Inputs:
    """Logs or data sets, and the TOML files given beside them.

    `Inputs.of(log, config=config, streams=None)` reads every TOML file at once, so that it may
    be a pipe; a command passes `inputs["config"]` on instead of the path.
    """

    data: tuple[Path, ...]
    """Read elsewhere, which also gives their digests."""
    documents: Mapping[str, Document]
    """By role: config, calibration, streams, poses, scenario."""

    @classmethod
    def of(cls, *data: Path, **documents: Path | None) -> Inputs:
        """Read the documents that are given. Raises UsageError for one that cannot be read."""
        given = {role: path for role, path in documents.items() if path is not None}
        return cls(data, {role: Document.read(path) for role, path in given.items()})

    def __getitem__(self, role: str) -> Document | None:
        return self.documents.get(role)

    @property
    def paths(self) -> tuple[Path, ...]:
        """All files, none of which the output may overwrite; of a folder those in it."""
        files = [
            file
            for path in self.data
            for file in (sorted(path.iterdir()) if path.is_dir() else [path])
        ]
        return (*files, *(document.path for document in self.documents.values()))

    def check(self, path: Path | None, force: bool) -> None:
        """Raise CltError unless the output, if any, may be written; to call before any work."""
        if path is not None:
            target.check_output(path, force, self.paths)

    def output(self, path: Path, force: bool) -> AbstractContextManager[BinaryIO]:
        """Open the output, which appears whole or not at all. Raises CltError as `check` does."""
        return target.open_output(path, force, self.paths)

    @contextmanager
    def report(self, path: Path | None, force: bool) -> Iterator[TextIO]:
        """Standard output, or a text file that appears whole or not at all."""
        if path is None or path == target.STDOUT:
            yield sys.stdout
            return
        with self.output(path, force) as file:
            text = io.TextIOWrapper(file, encoding="utf-8", newline="\n")
            try:
                yield text
                text.flush()
            finally:
                text.detach()

    def digests(self, data: Mapping[str, str]) -> dict[str, str]:
        """SHA-256 of every file by its name; `data` holds those of the logs or data sets."""
        found = {str(document): document.sha256 for document in self.documents.values()}
        return {**data, **found}

    def attach(self, recording: Recording) -> Recording:
        """The recording with the documents, each named by its role, e.g. `config.toml`.

        What travelled with the input travels on, but for a document of the same role and for
        the configuration and poses of earlier commands, whose record says what they set.
        """
        from clt.core.recording import Attachment

        gone = {f"{role}.toml" for role in (*ONE_COMMAND_ROLES, *self.documents)}
        kept = [one for one in recording.attachments if one.name not in gone]
        new = [
            Attachment(f"{role}.toml", TOML_MEDIA_TYPE, document.data)
            for role, document in self.documents.items()
        ]
        return replace(recording, attachments=(*kept, *new))
