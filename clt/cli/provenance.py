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

OUTPUT_FLAGS = ("-o", "--output")
PRESENTATION_FLAGS = ("--force", "-q", "--quiet", "-v", "--verbose", "--json")
"""Flags that change what is said, not what is written."""

RECORDED_ARGUMENTS: ContextVar[Sequence[str] | None] = ContextVar("words", default=None)
"""What stands for this program's own arguments, if anything does."""


@contextmanager
def record_as_command(words: Sequence[str]) -> Iterator[None]:
    """Let records hold `clt RECORDED_ARGUMENTS...`, the command that does the same alone."""
    token = RECORDED_ARGUMENTS.set(words)
    try:
        yield
    finally:
        RECORDED_ARGUMENTS.reset(token)


def run_record(inputs: Mapping[str, str], **documents: object) -> dict[str, str]:
    """Command line, version, `inputs` (name -> SHA-256) and further documents, all as strings.

    A document that is not a string already is written as JSON; NaN and infinity are refused.
    """
    record = {
        "command": shlex.join(
            ["clt", *arguments_without_output(RECORDED_ARGUMENTS.get() or sys.argv[1:])]
        ),
        "version": __version__,
        "inputs": json.dumps(dict(inputs)),
    }
    for name, value in documents.items():
        record[name] = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return record


def arguments_without_output(words: Sequence[str]) -> list[str]:
    """A command line without its output and manners: the same work leaves the same bytes."""
    kept: list[str] = []
    for before, word in zip(["", *words], words, strict=False):
        attached = word.startswith("--output=") or (word.startswith("-o") and word != "-o")
        if not (
            before in OUTPUT_FLAGS or word in OUTPUT_FLAGS or word in PRESENTATION_FLAGS or attached
        ):
            kept.append(word)
    return kept


def file_digests(paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of files, by name."""
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
