"""Worker processes on this machine."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import connection, get_context, parent_process
from typing import Generic

from clt.core.errors import CltError
from clt.studies.executors import MAX_ATTEMPTS, Item, Value, WorkerLost

MAX_DEATHS_IN_A_ROW = 3
"""Per worker: so many deaths without a single result are no matter of the items."""


@dataclass
class Slot(Generic[Item]):
    """One worker, and what it is doing."""

    pool: ProcessPoolExecutor
    item: Item
    attempts: int = 1


def run_local(
    function: Callable[[Item], Value],
    items: Iterable[Item],
    jobs: int,
    *,
    first_alone: bool = False,
) -> Iterator[tuple[Item, Value | WorkerLost]]:
    """In `jobs` processes, each a pool of its own: one that dies takes no other along.

    `first_alone`: the others wait for the first result, for it leaves compiled kernels to all.
    Raises CltError where workers die whatever they do.
    """
    waiting = iter(items)
    running: dict[Future[Value], Slot[Item]] = {}
    idle: list[ProcessPoolExecutor] = []
    deaths = 0
    try:
        while True:
            most = 1 if first_alone else jobs
            while len(running) < most and (item := next(waiting, None)) is not None:
                pool = idle.pop() if len(idle) > 0 else new_worker()
                _submit(function, Slot(pool, item), running)
            if len(running) == 0:
                return
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                slot = running.pop(future)
                try:
                    value: Value | WorkerLost = future.result()
                except BrokenProcessPool:
                    deaths += 1
                    if deaths >= MAX_DEATHS_IN_A_ROW * jobs:
                        raise CltError(f"workers die at once, {deaths} so far") from None
                    slot.pool.shutdown()
                    slot.pool = new_worker()
                    if slot.attempts < MAX_ATTEMPTS:
                        slot.attempts += 1
                        _submit(function, slot, running)
                        continue
                    value = WorkerLost("the worker died; memory may have run out")
                else:
                    deaths = 0
                idle.append(slot.pool)
                first_alone = False
                yield slot.item, value
    finally:
        for pool in (*idle, *(slot.pool for slot in running.values())):
            pool.shutdown(wait=False, cancel_futures=True)


def _submit(
    function: Callable[[Item], Value], slot: Slot[Item], running: dict[Future[Value], Slot[Item]]
) -> None:
    """Give a worker its item; one that died idle is replaced first."""
    try:
        running[slot.pool.submit(function, slot.item)] = slot
    except BrokenProcessPool:
        slot.pool.shutdown()
        slot.pool = new_worker()
        running[slot.pool.submit(function, slot.item)] = slot


def new_worker() -> ProcessPoolExecutor:
    """A pool of one fresh process, which shares nothing with this one."""
    return ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=start_worker)


def start_worker() -> None:
    """Leave signals of the terminal to the parent, end with it, and use one thread for algebra."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    import scipy.linalg  # noqa: F401, PLC0415 - so that its threads are limited, too
    from threadpoolctl import threadpool_limits  # noqa: PLC0415 - behind the libraries

    threadpool_limits(1)


def _end_with(sentinel: int) -> None:
    """A parent that was killed leaves no worker behind."""
    connection.wait([sentinel])
    os._exit(1)
