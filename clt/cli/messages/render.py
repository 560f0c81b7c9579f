"""From a diagnostic to its line for people and its object for `--json`."""

from __future__ import annotations

from clt.cli.messages.commands import COMMAND_TEXTS
from clt.cli.messages.emission import EMISSION_TEXTS
from clt.cli.messages.estimation import ESTIMATION_TEXTS
from clt.cli.messages.export import EXPORT_TEXTS
from clt.cli.messages.initialization import INITIALIZATION_TEXTS
from clt.cli.messages.metrics import METRICS_TEXTS
from clt.cli.messages.observability import OBSERVABILITY_TEXTS
from clt.cli.messages.recording import RECORDING_TEXTS
from clt.cli.messages.words import Texts, fill_template
from clt.cli.numbers import without_nan
from clt.core.diagnostics import Diagnostic

TEXTS: Texts = {
    **COMMAND_TEXTS,
    **EMISSION_TEXTS,
    **ESTIMATION_TEXTS,
    **EXPORT_TEXTS,
    **INITIALIZATION_TEXTS,
    **METRICS_TEXTS,
    **OBSERVABILITY_TEXTS,
    **RECORDING_TEXTS,
}
"""The words for every kind."""


def diagnostic_text(found: Diagnostic) -> str:
    """One line for people: what, where, remedy."""
    text = TEXTS[found.kind]
    return fill_template(text, found) if isinstance(text, str) else text(found)


def diagnostic_document(found: Diagnostic, text: str) -> dict[str, object]:
    """The object that stands in the list `diagnostics` of `--json`."""
    return {
        "kind": found.kind,
        "subject": found.subject,
        "severity": found.severity,
        "values": without_nan(found.values),
        "text": text,
    }
