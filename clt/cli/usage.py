"""Usage errors that typer found, as one line in clt's own words."""

from __future__ import annotations

import re
from typing import Any

from clt.core.printable import printable

REPLACED_SENTENCES = (
    (r"Missing command\.", "give a command"),
    (r"Missing (?:argument|option|parameter) (.+?)\..*", r"\1 is missing"),
    (r"Got unexpected extra argument\(s\) \((.*)\)", r"unexpected: \1"),
    (r"Option '(.*)' requires .*", r"\1 needs a value"),
    (r"Option '(.*)' does not take a value\.", r"\1 takes no value"),
    (r"No such option: (.*)", r"no such option \1"),
    (r"No such command '(.*?)'\..*", r"no such command `\1`"),
)
"""Sentences of typer, and what is said instead."""


def usage_line(error: Any, command: str | None) -> str:
    """What is wrong with a command line, and where the remedy is written.

    `command` is the one that was called, if it is known.
    """
    from clt.core.settings import did_you_mean
    from clt.core.validation import SINGLE_QUOTE, describe_choice, describe_fault, shorten

    words = ["clt"] if command is None else ["clt", command]
    text = re.sub(r"\s*\(Possible options: .*\)$", "", error.format_message())
    fault = _fault(error)
    choice = re.search(r"Value error, '(.*)' is not one of (.*)\.$", text)
    if choice is not None:
        found = describe_choice(re.findall(r"'([^']*)'", choice[2]), choice[1])
        text = f"{_hint(text)} {found}"
    elif fault is not None:
        text = f"{_hint(text)} {describe_fault(fault)}"
    for form, ours in REPLACED_SENTENCES:
        text = re.sub(rf"^{form}$", ours, text, flags=re.DOTALL)
    option = str(getattr(error, "option_name", ""))
    if text.startswith("no such option"):
        known = [name for one in error.ctx.command.params for name in one.opts]
        hint = did_you_mean(option, known)
        text = f"no such option {shorten(option)}" + ("" if hint.startswith(";") else hint)
    if text.startswith("no such command"):
        hint = did_you_mean(text.split("`")[1], error.ctx.command.commands)
        text += "" if hint.startswith(";") else hint
    place = f"{words[-1]}: " if len(words) > 1 else ""
    text = text.replace("' / '", "/").replace(SINGLE_QUOTE, "")
    return printable(f"{place}{text}; see {' '.join(words)} --help")


def _hint(text: str) -> str:
    """The option or argument that a sentence of typer is about."""
    found = re.match(r"Invalid value for (.*?): ", text)
    return "" if found is None else found[1].replace(" / ", "/")


def _fault(error: Any) -> dict[str, Any] | None:
    """What pydantic found wrong with the value, if it did."""
    errors = getattr(error.__cause__, "errors", None)
    found: dict[str, Any] | None = None if errors is None else errors()[0]
    return found
