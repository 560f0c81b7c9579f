"""What a command says on stderr, and the exit code it ends with."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from clt.core.printable import printable

if TYPE_CHECKING:
    from clt.core.recording import Fault  # importing it for real would load numpy for `clt --help`

EXIT_DONE, EXIT_FAILED, EXIT_USAGE, EXIT_PARTIAL, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


@dataclass
class Console:
    """Diagnostics of one command run; `code` is 3 once something was only partly done."""

    quiet: bool = False
    verbose: bool = False
    code: int = EXIT_DONE
    warnings: list[str] = field(default_factory=list)
    compile_s: float = 0.0
    """Seconds that compiling took so far."""
    shown: bool = field(default=False, init=False)
    """Whether a line of `progress` stands on the terminal."""

    def say(self, text: str) -> None:
        """A line of progress or result for people, silent with -q."""
        if not self.quiet:
            print(printable(text), file=sys.stderr)

    def detail(self, text: str) -> None:
        """A line only with -v."""
        if self.verbose:
            print(printable(text), file=sys.stderr)

    def progress(self, text: str) -> None:
        """Replace the line that a terminal shows of what is going on; none where text is empty."""
        if self.shown or (text != "" and not self.quiet and sys.stderr.isatty()):
            print(f"\r\x1b[K{printable(text)}", end="", file=sys.stderr, flush=True)
            self.shown = text != ""

    def warn(self, text: str, partial: bool = False) -> None:
        """A warning; `partial` when data was unusable or an estimate is missing (exit code 3).

        A partial one is said even with -q, for an exit code must not stand unexplained.
        """
        self.warnings.append(text)
        if partial:
            self.code = EXIT_PARTIAL
        if not self.quiet or partial:
            print(f"clt: warning: {printable(text)}", file=sys.stderr)

    def report(self, faults: tuple[Fault, ...]) -> None:
        """Say what is wrong with a log that was read."""
        for fault in faults:
            self.warn(fault.text, partial=fault.data_lost)
