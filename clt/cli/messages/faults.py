"""The faults of a log, which has their words, as diagnostics."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from clt.cli.messages.render import diagnostic_document
from clt.core.diagnostics import Diagnostic, Severity

if TYPE_CHECKING:
    from clt.core.recording import Fault


def fault_diagnostic(fault: Fault) -> Diagnostic:
    """A fault as data; lost data is partial."""
    severity: Severity = "partial" if fault.data_lost else "warning"
    return Diagnostic(fault.kind, fault.subject, severity, {"count": fault.count, **fault.values})


def fault_documents(faults: Iterable[Fault]) -> list[dict[str, object]]:
    """The list `diagnostics` of a command that finds nothing but faults."""
    return [diagnostic_document(fault_diagnostic(fault), fault.text) for fault in faults]
