"""What an analysis of observability found besides its ranks, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts, first_few
from clt.core.diagnostics import Diagnostic

MAX_LISTED = 4
"""Directions and remedies that one line names."""


def unobservable_text(found: Diagnostic) -> str:
    """Directions in which no error ever shrinks, and the remedies as a choice."""
    remedies = remedy_choices(found.values["remedies"])
    remedy = f"; remedy: {remedies}" if len(remedies) > 0 else ""
    directions = first_few(found.values["directions"], MAX_LISTED)
    return f"ranges cannot observe {directions}: such errors never shrink{remedy}"


def remedy_choices(texts: list[str]) -> str:
    """The remedies as a choice."""
    return ", or ".join(texts[:MAX_LISTED])


OBSERVABILITY_TEXTS: Texts = {
    "unobservable": unobservable_text,
    "motion_unknown": "no odometry of {subject}: left out of rank and windows",
    "no_trajectory": "no {stream} of {subject}: left out of windows",
}
