"""Recordings that are killed or terminated at random moments while 2,000 messages a second arrive.

Run: python -m tests.fuzz.crashes --count 50 [--terminations 20] [--seed S]. After each kill -9 what
`clt recover` saves must lack at most the last flush period (1 s) and DELIVERY_S, in which the last
messages were on their way; after each SIGTERM the log must be whole and the exit code 0. Every
finding is printed with its number. Exit code 1 when there is one.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import chdir
from pathlib import Path

from mcap.reader import make_reader
from typer.testing import CliRunner

from clt.cli.app import app
from tests.devices.streams import range_line, start, until

RATE = 2000
"""Messages a second."""
FLUSH_S = 1.0
DELIVERY_S = 0.3
"""From sending a message to its being written, at most, on a busy computer."""
LONGEST_S = 4.0


class Device:
    """Sends numbered ranges to a port, in datagrams of up to ten lines."""

    def __init__(self, port: int) -> None:
        self.history: list[tuple[float, int]] = []
        """When, and how many messages had been sent by then."""
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.port = port
        self.closed = False
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self) -> None:
        begin, sent = time.monotonic(), 0
        while not self.closed:
            due = int((time.monotonic() - begin) * RATE)
            while sent < due:
                lines = [range_line(k / RATE, k) for k in range(sent, min(sent + 10, due))]
                self.socket.sendto(b"".join(lines), ("127.0.0.1", self.port))
                sent += len(lines)
            self.history.append((time.monotonic(), sent))
            time.sleep(0.002)

    def close(self) -> None:
        self.closed = True
        self.thread.join()
        self.socket.close()

    def sent_before(self, moment: float) -> int:
        """Messages that had been sent by then."""
        return max((count for at, count in self.history if at < moment), default=0)


def recorded(folder: Path, delay: float, sent: signal.Signals) -> tuple[Device, float, object]:
    """Record, and send a signal after so many seconds; device, moment and process."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    source = f"net=udp:127.0.0.1:{port}?buffer=4000000,proto=ndjson"
    process = start(folder, "-o", "o.mcap", "--source", source, "--json")
    until((folder / "o.mcap").exists, process)
    device = Device(port)
    time.sleep(delay)
    moment = time.monotonic()
    process.send_signal(sent)
    try:
        process.communicate(timeout=30)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
    device.close()
    return device, moment, process


def kept(path: Path) -> int:
    """Ranges of a log, by the official reader."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return sum(1 for _ in reader.iter_messages(topics=["/R1/uwb/range"]))


def kill(folder: Path, delay: float) -> tuple[list[str], dict[str, float]]:
    """What is wrong after kill -9, and how much is missing, s."""
    device, moment, _ = recorded(folder, delay, signal.SIGKILL)
    with chdir(folder):
        done = CliRunner().invoke(app, ["recover", "o.mcap", "-o", "saved.mcap", "-q"])
    saved = folder / "saved.mcap"
    count = kept(saved) if done.exit_code in {0, 3} and saved.exists() else 0
    missing = (device.sent_before(moment) - count) / RATE
    wanted = device.sent_before(moment - FLUSH_S - DELIVERY_S)
    wrong = [] if count >= wanted else [f"{count} messages saved of {wanted} due, {missing:.2f} s"]
    return wrong, {"missing_s": missing}


def terminate(folder: Path, delay: float) -> list[str]:
    """What is wrong after SIGTERM."""
    device, moment, process = recorded(folder, delay, signal.SIGTERM)
    wrong = []
    code = getattr(process, "returncode", None)
    if code not in {0, 1 if device.sent_before(moment) < RATE // 10 else 0}:
        wrong.append(f"exit code {code}")
    count, wanted = kept(folder / "o.mcap"), device.sent_before(moment - DELIVERY_S)
    if count < wanted:
        wrong.append(f"{count} messages of {wanted}")
    return wrong


def study(count: int, terminations: int, seed: int) -> list[str]:
    """Kill and terminate so often; what was wrong."""
    draw = random.Random(seed)
    found, worst = [], 0.0
    for number in range(count + terminations):
        delay = draw.uniform(0.05, LONGEST_S)
        with tempfile.TemporaryDirectory() as name:
            if number < count:
                wrong, figures = kill(Path(name), delay)
                worst = max(worst, figures["missing_s"])
            else:
                wrong = terminate(Path(name), delay)
        found += [f"{number}: after {delay:.3f} s: {text}" for text in wrong]
        for text in wrong:
            print(f"{number}: after {delay:.3f} s: {text}", file=sys.stderr, flush=True)
    summary = {"kills": count, "terminations": terminations, "most_missing_s": round(worst, 3)}
    print(json.dumps({**summary, "findings": len(found)}))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--terminations", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    sys.exit(len(study(options.count, options.terminations, options.seed)) > 0)


if __name__ == "__main__":
    main()
