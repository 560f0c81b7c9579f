"""Whole processes, timed: clt, and the official reader that does nothing but iterate a log."""

from __future__ import annotations

import subprocess
import sys
from time import perf_counter

ITERATE = """
import sys
from mcap.reader import make_reader

with open(sys.argv[1], "rb") as file:
    print(sum(1 for _ in make_reader(file).iter_messages()))
"""
CLT = (sys.executable, "-m", "clt")


def iterating(log: str) -> tuple[str, ...]:
    """The command of a process in which the official reader iterates a log's messages."""
    return sys.executable, "-c", ITERATE, log


def wall(*command: str) -> float:
    """Seconds of one whole process, which must succeed."""
    begin = perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return perf_counter() - begin
