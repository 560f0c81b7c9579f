"""Collects what a log has wrong, so that a thousand equal faults end as a few lines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from clt.core.printable import printable_name as shown
from clt.core.recording import Fault

MAX_FAULTS_OF_A_KIND = 3
"""As many faults of one kind are listed one by one."""


@dataclass
class Faults:
    """The faults of one log; `name` is the file."""

    name: str
    _found: dict[str, list[Fault]] = field(default_factory=dict)
    _more: dict[str, Fault] = field(default_factory=dict)

    def add(
        self,
        kind: str,
        place: str,
        text: str,
        *,
        count: int = 1,
        lost: bool = False,
        subject: str = "",
        values: Mapping[str, float] | None = None,
    ) -> None:
        """Note a fault at `place`, a topic or `byte N`; `lost` if data was unusable.

        `subject` and `values` as in `Fault`.
        """
        found = self._found.setdefault(kind, [])
        if len(found) < MAX_FAULTS_OF_A_KIND:
            line = f"{self.name}: {shown(place)}: {text}"
            found.append(Fault(kind, count, line, lost, subject, values or {}))
            return
        before = self._more.get(kind)
        if before is not None:
            count, lost = count + before.count, lost or before.data_lost
        text = f"{self.name}: {count} more faults of the kind `{kind}`"
        self._more[kind] = Fault(kind, count, text, lost)

    def absorb(self, other: Faults) -> None:
        """Take over what another file of the same log has wrong, under that file's name."""
        for fault in other.all():
            found = self._found.setdefault(fault.kind, [])
            found.append(fault)

    def all(self) -> tuple[Fault, ...]:
        """Every fault, kinds in the order of their first appearance."""
        several = [[*found, *self._rest(kind)] for kind, found in self._found.items()]
        return tuple(fault for found in several for fault in found)

    def _rest(self, kind: str) -> list[Fault]:
        return [self._more[kind]] if kind in self._more else []
