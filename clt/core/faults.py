"""The faults of a log as diagnostics."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clt.core.diagnostics import Diagnostic, Severity

if TYPE_CHECKING:
    from clt.core.recording import Fault


def fault_diagnostic(fault: Fault) -> Diagnostic:
    """A fault as data; lost data is partial."""
    severity: Severity = "partial" if fault.data_lost else "warning"
    return Diagnostic(fault.kind, fault.subject, severity, {"count": fault.count, **fault.values})
