"""What a command says on stderr, and the exit code it ends with."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from clt.core.printable import printable

if TYPE_CHECKING:
    from collections.abc import Iterable

    from clt.core.diagnostics import Diagnostic, Severity
    from clt.core.recording import Fault  # importing it for real would load numpy for `clt --help`

EXIT_DONE, EXIT_FAILED, EXIT_USAGE, EXIT_PARTIAL, EXIT_INTERRUPTED = 0, 1, 2, 3, 130


@dataclass
class Console:
    """What one command run says; `code` is 3 once something was only partly done."""

    quiet: bool = False
    verbose: bool = False
    silent: bool = False
    """Lines are kept for the console that adopts this one."""
    code: int = EXIT_DONE
    warnings: list[str] = field(default_factory=list)
    """The texts of all that is more than information."""
    diagnostics: list[dict[str, object]] = field(default_factory=list)
    """What `--json` carries of everything found."""
    compile_s: float = 0.0
    """Seconds that compiling took so far."""
    lines: list[str] = field(default_factory=list)
    """What a silent console has to say."""
    shown: bool = field(default=False, init=False)
    """Whether a line of `progress` stands on the terminal."""

    def say(self, text: str) -> None:
        """A line of progress or result for people, silent with -q."""
        if not self.quiet:
            self._line(printable(text))

    def adopt(self, other: Console) -> None:
        """Say and take over all that a silent console found."""
        self.progress("")
        for line in other.lines:
            self._line(line)
        self.warnings += other.warnings
        self.diagnostics += other.diagnostics
        self.code = max(self.code, other.code)

    def _line(self, text: str) -> None:
        if self.silent:
            self.lines.append(text)
        else:
            print(text, file=sys.stderr)

    def detail(self, text: str) -> None:
        """A line only with -v."""
        if self.verbose:
            self._line(printable(text))

    def progress(self, text: str) -> None:
        """Replace the line that a terminal shows of what is going on; none where text is empty."""
        wanted = text != "" and not self.quiet and not self.silent
        if self.shown or (wanted and sys.stderr.isatty()):
            print(f"\r\x1b[K{printable(text)}", end="", file=sys.stderr, flush=True)
            self.shown = text != ""

    def step(self, text: str) -> None:
        """What is going on, as `progress` shows it; without a terminal a line of its own."""
        if sys.stderr.isatty():
            self.progress(text)
        elif text != "":
            self.say(text.strip())

    def report(self, found: Iterable[Diagnostic], about: str = "") -> None:
        """Say what was found; `about` names what a text does not begin with, such as a log."""
        from clt.cli.messages.render import diagnostic_text

        for one in found:
            text = diagnostic_text(one)
            self._note(one, text)
            begun = about == "" or text.startswith(about)
            self._print(one.severity, text if begun else f"{about}: {text}")

    def report_faults(self, faults: Iterable[Fault]) -> None:
        """Say what is wrong with a log that was read."""
        from clt.core.faults import fault_diagnostic

        for fault in faults:
            found = fault_diagnostic(fault)
            self._note(found, fault.text)
            self._print(found.severity, fault.text)

    def _note(self, found: Diagnostic, text: str) -> None:
        from clt.cli.messages.render import diagnostic_document

        self.diagnostics.append(diagnostic_document(found, text))

    def _print(self, severity: Severity, text: str) -> None:
        """A partial one is said even with -q, for an exit code must not stand unexplained."""
        if severity == "information":
            self.say(text)
            return
        self.warnings.append(text)
        if severity == "partial":
            self.code = EXIT_PARTIAL
        if not self.quiet or severity == "partial":
            self._line(f"clt: warning: {printable(text)}")
