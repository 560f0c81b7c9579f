"""Pieces that several texts share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from clt.core.diagnostics import Diagnostic

Texts = Mapping[str, str | Callable[[Diagnostic], str]]
"""By kind: a template over `subject` and the values, or a function of the diagnostic."""


def fill_template(template: str, found: Diagnostic) -> str:
    """A template of `str.format` over the subject and the values of a diagnostic."""
    return template.format_map({**found.values, "subject": found.subject})


def times_in_words(times: int) -> str:
    """A count as an adverb."""
    return "once" if times == 1 else f"{times} times"


def first_few(names: Sequence[str], most: int) -> str:
    """The first `most` names with commas, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return f"{', '.join(names[:most])}{more}"
