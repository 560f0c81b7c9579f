"""A small text file that is read once: what is parsed, hashed and attached are the same bytes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from clt.core.errors import UsageError


@dataclass(frozen=True)
class Document:
    """A TOML file that a user gave."""

    path: Path
    data: bytes

    @classmethod
    def read(cls, path: Path) -> Document:
        """Read a file or a pipe. Raises UsageError naming it."""
        try:
            return cls(path, path.read_bytes())
        except OSError as error:
            raise UsageError(f"{path}: {error.strerror or error}") from None

    @property
    def sha256(self) -> str:
        """Digest of the bytes."""
        return hashlib.sha256(self.data).hexdigest()

    def __str__(self) -> str:
        return str(self.path)
