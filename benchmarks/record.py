"""Recording the 100 Hz stream of four nodes (1,040 frames/s): speed, and memory over an hour.

    python benchmarks/record.py [--seconds 600] [--hour-at 60] [--out FILE]

The stream is made here: six ranges and four inertial readings every 10 ms, two robots' wheels every
50 ms, in the frames of `rcl`. First so many seconds of it are recorded from a file as fast as
possible, three times; the least processor time of the whole process counts, from bytes to the
finished log. Then an hour comes by a pipe at so many times its pace, while the memory of the
process is looked at once a second.
"""

from __future__ import annotations

import argparse
import json
import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from itertools import combinations
from math import sin
from pathlib import Path

from processes import CLT, spent
from report import publish

NODES = (0, 1, 2, 4)
MOVING = (1, 4)
HOUR_S = 3600
FRAMES_PER_SECOND = 1040
RUNS = 3


def one_second(second: int) -> bytes:
    """The frames of one second."""
    return b"".join(frame for step in range(100) for frame in one_step(1000 * second + 10 * step))


def one_step(ms: int) -> Iterator[bytes]:
    """The frames of 10 ms."""
    for node in NODES:
        yield b"\xa5\x5a\x12\x01" + struct.pack("<IB6hB", ms, node, 1, 2, 3, 4, 5, ms % 997, 0xDD)
    if ms % 50 == 0:
        for node in MOVING:
            wheels = struct.pack("<IBBfffB", ms, node, 50, 0.01, 0.0, 0.002 * sin(ms * 1e-3), 0xDD)
            yield b"\xa5\x5a\x13\x02" + wheels
    for one, other in combinations(NODES, 2):
        distance = 3.0 + one + 0.01 * sin(0.1 * ms + other)
        yield b"\xa5\x5a\x0f\x03" + struct.pack("<IBBdB", ms, one, other, distance, 0xDD)


def resident_mb(process: int) -> float:
    """Memory of a process, MB."""
    for line in Path(f"/proc/{process}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


def fast(folder: str, seconds: int) -> tuple[float, float]:
    """Least processor time (s) of recording so many seconds, and that of recording one."""
    times = {}
    for length in (1, seconds):
        path = f"{folder}/stream.bin"
        with Path(path).open("wb") as file:
            file.writelines(map(one_second, range(length)))
        words = ("record", "--force", "-q", "-o", f"{folder}/o.mcap")
        command = (*CLT, *words, "--source", f"uwb=file:{path},proto=rcl")
        times[length] = min(spent(*command) for _ in range(RUNS))
    return times[seconds], times[1]


def hour(folder: str, pace: float) -> tuple[float, list[float], dict[str, int]]:
    """An hour at so many times its pace: wall time, memory (MB) once a second, the figures."""
    words = ("record", "--json", "-o", f"{folder}/hour.mcap", "--source", "uwb=-,proto=rcl")
    process = subprocess.Popen((*CLT, *words), stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None
    assert process.stdout is not None
    begin, looked, memory = time.monotonic(), 0.0, []
    for second in range(HOUR_S):
        process.stdin.write(one_second(second))
        wait = begin + (second + 1) / pace - time.monotonic()
        if wait > 0.0:
            time.sleep(wait)
        if time.monotonic() - looked >= 1.0:
            looked = time.monotonic()
            memory.append(resident_mb(process.pid))
    process.stdin.close()
    figures = json.loads(process.stdout.read())["sources"]["uwb"]
    if process.wait() != 0:
        raise SystemExit(f"clt record ended with {process.returncode}")
    return time.monotonic() - begin, memory, figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--hour-at", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole, start = fast(folder, options.seconds)
        wall, memory, figures = hour(folder, options.hour_at)
        size = Path(f"{folder}/hour.mcap").stat().st_size
    frames = options.seconds * FRAMES_PER_SECOND
    rate, bare = options.seconds / whole, (options.seconds - 1) / (whole - start)
    tenth, half = memory[len(memory) // 10], memory[len(memory) // 2]
    rows = {
        f"processor time of {options.seconds} s, whole process": (
            f"{whole:.1f} s, {rate:.0f} x real time, {frames / whole:.0f} frames/s"
        ),
        f"the same without start-up ({start:.2f} s)": f"{bare:.0f} x real time",
        f"an hour by a pipe at {options.hour_at:g} x": (
            f"{wall:.0f} s, {figures['frames']} frames, {figures['lost']} lost, "
            f"log {size / 1e6:.0f} MB"
        ),
        "memory after 10 %, 50 %, 100 % of it": (
            f"{tenth:.0f}, {half:.0f}, {memory[-1]:.0f} MB, at most {max(memory):.0f} MB"
        ),
    }
    about = "100 Hz stream of four nodes, 1,040 frames/s, bytes to finished log"
    head = [f"{about} (`python benchmarks/record.py`):", "", "| what | measured |", "|---|---|"]
    lines = [*head, *(f"| {what} | {measured} |" for what, measured in rows.items())]
    publish(lines, options.out)


if __name__ == "__main__":
    main()
