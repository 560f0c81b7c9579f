"""In this process."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from clt.studies.executors import Item, Value, WorkerLost


def run_here(
    function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[tuple[Item, Value | WorkerLost]]:
    """One item after another in this process."""
    from threadpoolctl import threadpool_limits  # noqa: PLC0415 - of no use to the parent

    with threadpool_limits(1):
        for item in items:
            yield item, function(item)
