"""A cluster of Dask distributed (extra `clt[dask]`), which schedules, retries and moves results."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from clt.core.errors import CltError, UsageError
from clt.studies.executors import Item, Value, WorkerLost

CONNECT_TIMEOUT_S = 10
ITEMS_PER_THREAD = 3
"""So many items wait at the scheduler for each thread: workers never idle, memory stays flat."""
TURN = threading.Lock()
"""Of a worker process."""


def run_on_cluster(
    function: Callable[[Item], Value], items: Iterable[Item], address: str
) -> Iterator[tuple[Item, Value | WorkerLost]]:
    """On the workers of the scheduler at an address such as tcp://10.0.0.1:8786.

    Raises UsageError without Dask or for an address that makes no sense, CltError where nobody
    answers or the scheduler is lost; what it has done by then has been yielded.
    """
    try:
        import distributed  # noqa: PLC0415 - optional
    except ImportError:
        raise UsageError("--cluster needs Dask: pip install 'clt[dask]'") from None
    try:
        client: Any = distributed.Client(  # type: ignore[no-untyped-call]
            address, timeout=CONNECT_TIMEOUT_S, set_as_default=False
        )
    except (OSError, TimeoutError) as error:
        raise CltError(f"--cluster {address}: nobody answers ({error or 'timeout'})") from None
    except ValueError as error:
        raise UsageError(f"--cluster {address}: {error}") from None
    with client:
        yield from _submitted(distributed, client, function, items, address)


def _submitted(
    distributed: Any,
    client: Any,
    function: Callable[[Item], Value],
    items: Iterable[Item],
    address: str,
) -> Iterator[tuple[Item, Value | WorkerLost]]:
    threads = sum(client.nthreads().values())
    if threads == 0:
        raise CltError(f"--cluster {address}: it has no workers; start some with `dask worker`")
    waiting = iter(items)
    of: dict[Any, Item] = {}
    done = distributed.as_completed(loop=client.loop)

    def submit() -> None:
        item = next(waiting, None)
        if item is not None:
            future = client.submit(in_turn, function, item, pure=False)
            of[future.key] = item
            done.add(future)

    for _ in range(ITEMS_PER_THREAD * threads):
        submit()
    while len(of) > 0:
        try:
            future = next(done)
            value = future.result(timeout=CONNECT_TIMEOUT_S)
        except distributed.KilledWorker:
            value = WorkerLost("workers died of it; memory may have run out")
        except (OSError, TimeoutError, distributed.CancelledError, StopIteration) as error:
            raise CltError(
                f"--cluster {address}: the scheduler is lost ({type(error).__name__}); the same "
                "command goes on from here"
            ) from None
        yield of.pop(future.key), value
        submit()


def in_turn(function: Callable[[Item], Value], item: Item) -> Value:
    """Work on an item; a worker with several threads does one at a time, and without helpers.

    Compiled kernels are linked once a process and not meant for several threads.
    """
    from threadpoolctl import threadpool_limits  # noqa: PLC0415 - on the worker

    with TURN, threadpool_limits(1):
        return function(item)
