"""Whole processes, timed: clt, and the official reader that does nothing but iterate a log."""

from __future__ import annotations

import os
import resource
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


def spent(*command: str) -> float:
    """Processor time of one whole process, s, which must succeed. Byte code is kept, as usual."""
    usual = {key: value for key, value in os.environ.items() if key != "PYTHONDONTWRITEBYTECODE"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, env=usual, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
