"""What diagnostics say, for tests that hold the words."""

from __future__ import annotations

from collections.abc import Iterable

from clt.cli.messages.initialization import reason_text
from clt.cli.messages.render import diagnostic_text
from clt.core.diagnostics import Diagnostic, Severity
from clt.estimation.posterior import Posterior
from clt.initialization.start_time import StartTime
from clt.initialization.status import Initialization, RobotStatus


def texts(found: Iterable[Diagnostic], severity: Severity | None = None) -> tuple[str, ...]:
    """The texts of diagnostics, of one severity where one is given."""
    return tuple(
        diagnostic_text(one) for one in found if severity is None or one.severity == severity
    )


def kinds(found: Iterable[Diagnostic]) -> list[str]:
    """The kinds of diagnostics."""
    return [one.kind for one in found]


def remarks(posterior: Posterior) -> tuple[str, ...]:
    """The texts of information on a run."""
    return texts(posterior.diagnostics, "information")


def warnings_of(posterior: Posterior) -> tuple[str, ...]:
    """The texts of warnings of a run."""
    return texts(posterior.diagnostics, "warning")


def failings(posterior: Posterior) -> tuple[str, ...]:
    """The texts of what a run could not do or use."""
    return texts(posterior.diagnostics, "partial")


def note_texts(found: StartTime | Initialization) -> tuple[str, ...]:
    """The texts of what was noted about a start."""
    return texts(found.notes)


def reason(robot: RobotStatus) -> str:
    """Why the pose of a robot is not certain, in words."""
    return reason_text(robot.why)
