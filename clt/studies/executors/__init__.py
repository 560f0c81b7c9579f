"""How tasks are carried out: in this process, in others on this machine, on a Dask cluster.

An executor takes a function and items, which must travel (pickle), and yields each item with what
came of it, in any order. What a worker that dies was doing is done again; where that kills the next
worker, too, the item comes with a `WorkerLost`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

Item = TypeVar("Item")
Value = TypeVar("Value")

MAX_ATTEMPTS = 2
"""So often an item may kill its worker."""


@dataclass(frozen=True)
class WorkerLost:
    """What came of an item that kills workers."""

    text: str
    """Why, as far as it is known."""


Execute = Callable[
    [Callable[[Item], Value], Iterable[Item]], Iterator[tuple[Item, Value | WorkerLost]]
]
