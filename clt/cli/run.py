"""The `clt.run` record: how the log at hand came to be."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path

from clt import __version__


def run_record(inputs: Mapping[str, str], **documents: object) -> dict[str, str]:
    """Command line, version, `inputs` (name -> SHA-256) and further documents, all as strings.

    A document that is not a string already is written as JSON; NaN and infinity are refused.
    """
    record = {
        "command": shlex.join(["clt", *sys.argv[1:]]),
        "version": __version__,
        "inputs": json.dumps(dict(inputs)),
    }
    for name, value in documents.items():
        record[name] = value if isinstance(value, str) else json.dumps(value, allow_nan=False)
    return record


def digests(paths: Iterable[Path]) -> dict[str, str]:
    """SHA-256 of files, by name."""
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}
