"""The errors a user can meet; each is one line that names the place and the remedy."""

from __future__ import annotations


class CltError(Exception):
    """The work failed (exit code 1)."""

    code = 1


class UsageError(CltError):
    """The command, an option or a configuration key is wrong (exit code 2)."""

    code = 2


class LogError(CltError):
    """A log cannot be read or written; the text names the file and, where known, the byte."""
