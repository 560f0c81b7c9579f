"""The faults of a log, which have their words, as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from clt.cli.messages.render import diagnostic_document
from clt.core.faults import fault_diagnostic

if TYPE_CHECKING:
    from clt.core.recording import Fault


def fault_documents(faults: Iterable[Fault]) -> list[dict[str, object]]:
    """The list `diagnostics` of a command that finds nothing but faults."""
    return [diagnostic_document(fault_diagnostic(fault), fault.text) for fault in faults]
