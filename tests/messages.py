"""What diagnostics say, for tests that hold the words."""

from __future__ import annotations

from collections.abc import Iterable

from clt.cli.messages.render import diagnostic_text
from clt.core.diagnostics import Diagnostic, Severity
from clt.estimation.posterior import Posterior


def texts(found: Iterable[Diagnostic], severity: Severity | None = None) -> tuple[str, ...]:
    """The texts of diagnostics, of one severity where one is given."""
    return tuple(
        diagnostic_text(one) for one in found if severity is None or one.severity == severity
    )


def remarks(posterior: Posterior) -> tuple[str, ...]:
    """The texts of information on a run."""
    return texts(posterior.diagnostics, "information")


def failings(posterior: Posterior) -> tuple[str, ...]:
    """The texts of what a run could not do or use."""
    return texts(posterior.diagnostics, "partial")
