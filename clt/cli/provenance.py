"""The `clt.run` record: how the log at hand came to be."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from clt import __version__

OUTPUT = ("-o", "--output")
MANNERS = ("--force", "-q", "--quiet", "-v", "--verbose", "--json")
"""Flags that change what is said, not what is written."""

WORDS: ContextVar[Sequence[str] | None] = ContextVar("words", default=None)
"""What stands for this program's own arguments, if anything does."""


@contextmanager
def as_command(words: Sequence[str]) -> Iterator[None]:
    """Let the records written inside hold `clt WORDS...`: the command that does the same alone."""
    token = WORDS.set(words)
    try:
        yield
    finally:
        WORDS.reset(token)


def run_record(inputs: Mapping[str, str], **documents: object) -> dict[str, str]:
    """Command line, version, `inputs` (name -> SHA-256) and further documents, all as strings.

    A document that is not a string already is written as JSON; NaN and infinity are refused.
    """
    record = {
        "command": shlex.join(["clt", *essence(WORDS.get() or sys.argv[1:])]),
        "version": __version__,
        "inputs": json.dumps(dict(inputs)),
    }
    for name, value in documents.items():
        record[name] = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return record


def essence(words: Sequence[str]) -> list[str]:
    """A command line without its output and manners: the same work leaves the same bytes."""
    kept: list[str] = []
    for before, word in zip(["", *words], words, strict=False):
        attached = word.startswith("--output=") or (word.startswith("-o") and word != "-o")
        if not (before in OUTPUT or word in OUTPUT or word in MANNERS or attached):
            kept.append(word)
    return kept


def digests(paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of files, by name."""
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
