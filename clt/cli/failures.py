"""What is said of a command that failed: one line, and with `--json` an object, too."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from itertools import pairwise

from clt.cli.console import EXIT_FAILED
from clt.core.printable import printable

WRITING = (errno.EBADF, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a stream that takes nothing."""
TO_STDOUT = ("-o-", "--output=-")
"""Words that send the result to standard output, which then takes no object of a failure."""


def report_failure(text: str, code: int, *, as_json: bool) -> int:
    """Say on standard error what went wrong, `as_json` as an object on standard output, too."""
    print(f"clt: error: {printable(text)}", file=sys.stderr)
    if as_json:
        import json

        try:
            print(json.dumps({"error": text, "exit_code": code}), flush=True)
        except OSError as error:
            report_os_error(error, as_json=False)
    return code


def report_os_error(error: OSError, *, as_json: bool) -> int:
    """Say what could not be read or written; a reader of our output that left needs no word.

    Files that are written are named where that fails: what is not named is standard output.
    """
    if not isinstance(error, BrokenPipeError):
        of_stdout = error.filename is None and error.errno in WRITING
        place = "standard output" if of_stdout else error.filename
        where = "" if place is None else f"{place}: "
        text = f"{where}{error.strerror or error}"
        report_failure(text, EXIT_FAILED, as_json=as_json and not of_stdout)
    try:
        sys.stdout.flush()
    except OSError:
        from clt.log.output import silence_stdout

        silence_stdout()
    return EXIT_FAILED


def json_in_words(words: Sequence[str]) -> bool:
    """Whether a command line that typer refuses asks for an object on standard output."""
    options = words[: words.index("--")] if "--" in words else words
    pairs = pairwise(options)
    to_stdout = any(one in {"-o", "--output"} and value == "-" for one, value in pairs)
    return "--json" in options and not to_stdout and not any(one in options for one in TO_STDOUT)
