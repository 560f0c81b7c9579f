"""Commands that are stopped at random moments: one line, the right code, no file half written.

Run: python -m tests.fuzz.signals --count 100 [--seed S]. So many times each of SIGINT, SIGTERM and
SIGKILL is sent, to four commands by turns; every finding is printed with its number. Exit code 1
when there is one. What comes before Python has read the first module of clt is Python's to answer
(on Linux that can be seen, and such signals wait until then).
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import chdir
from functools import partial
from pathlib import Path

from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.output import open_output

SENT = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated", signal.SIGKILL: None}
COMMANDS = (
    ("simulate shi-sim --duration 20 -o out.mcap", "out.mcap"),
    ("localize log.mcap --init truth -o out.mcap", "out.mcap"),
    ("evaluate result.mcap -o out.json --json", "out.json"),
    ("recover result.mcap -o out.mcap", "out.mcap"),
)
INPUTS = (
    "simulate shi-sim --duration 20 -o log.mcap",
    "localize log.mcap --init truth -o result.mcap",
)
START = 0.7
"""Seconds until a command begins its work, or longer."""
PATIENCE = 5.0
"""Seconds from a signal to the end; a second is promised."""


def start(command: str, folder: Path) -> subprocess.Popen[bytes]:
    """A command in a process of its own, which answers Ctrl-C whatever the parent does."""
    return subprocess.Popen(
        [sys.executable, "-m", "clt", *command.split()],
        cwd=folder,
        env={name: text for name, text in os.environ.items() if not name.startswith("CLT_")},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )


def prepare(folder: Path) -> dict[str, tuple[float, bytes]]:
    """Make the inputs; for every command how long it takes, about, and its result."""
    found = {}
    for command in INPUTS:
        run(command, folder)
    for command, name in COMMANDS:
        begin = time.monotonic()
        run(command, folder)
        found[command] = START + time.monotonic() - begin, (folder / name).read_bytes()
        (folder / name).unlink()
    return found


def run(command: str, folder: Path) -> None:
    """A command that nobody stops, in this process."""
    with chdir(folder):
        done = CliRunner().invoke(app, command.split())
    assert done.exit_code == 0, done.output


def stop(
    command: str, name: str, sent: signal.Signals, delay: float, whole: bytes, folder: Path
) -> list[str]:
    """Send one signal after `delay` seconds; what is wrong with the way the command ended."""
    process = start(command, folder)
    end = time.monotonic() + delay
    while time.monotonic() < end or (sent != signal.SIGKILL and not ready(process)):
        time.sleep(0.001)
    process.send_signal(sent)
    try:
        _, text = process.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
        return [f"runs on {PATIENCE:g} s after the signal"]
    wrong = []
    lines = text.decode().splitlines()
    said = [line for line in lines if line.startswith("clt: ")]
    if any(word in line for line in lines for word in ("Traceback", "Exception", "Error", "File")):
        wrong.append(f"says {' | '.join(lines[-3:])}")
    ended = -9 if sent == signal.SIGKILL else 128 + sent
    if process.returncode not in {0, ended}:
        wrong.append(f"exit code {process.returncode}")
    if said != ([f"clt: {SENT[sent]}"] if process.returncode == 128 + sent else []):
        wrong.append(f"exit code {process.returncode}, says {' | '.join(said)}")
    left = {path.name for path in folder.iterdir()} - {"log.mcap", "result.mcap"}
    hidden = {one for one in left if one.startswith(".out.clt-")}
    if sent == signal.SIGKILL and len(hidden) > 0:
        with open_output(folder / name, force=True) as file:  # as the next run does
            file.write(whole)
        left = {path.name for path in folder.iterdir()} - {"log.mcap", "result.mcap"}
    if not left <= {name}:
        wrong.append(f"leaves {', '.join(left - {name})}")
    if name in left and not complete((folder / name).read_bytes(), whole):
        wrong.append(f"leaves {name} half written")
    if process.returncode == 0 and name not in left:
        wrong.append(f"says it is done, without {name}")
    for one in left:
        (folder / one).unlink()
    return wrong


def ready(process: subprocess.Popen[bytes]) -> bool:
    """The process handles SIGTERM in its own way, or is over."""
    status = Path(f"/proc/{process.pid}/status")
    if process.poll() is not None or not status.exists():
        return True
    fields = dict(line.split(":", 1) for line in status.read_text().splitlines())
    masks = int(fields["SigCgt"], 16) | int(fields["SigIgn"], 16)
    return bool(masks & 1 << (signal.SIGTERM - 1)) or "Z" in fields["State"]


def complete(data: bytes, whole: bytes) -> bool:
    """A file has the beginning, the end and nearly the size of the same one in full.

    Records of runs hold timings, whose digits are not always as many.
    """
    return data[:8] == whole[:8] and data[-8:] == whole[-8:] and len(data) > 0.99 * len(whole)


def study(count: int, seed: int) -> list[str]:
    """Send each signal `count` times; every finding in a line."""
    rng = random.Random(seed)
    findings = []
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        known = prepare(folder)
        for number in range(count * len(SENT)):
            sent = list(SENT)[number % len(SENT)]
            command, name = COMMANDS[number // len(SENT) % len(COMMANDS)]
            seconds, whole = known[command]
            delay = rng.uniform(0.0, seconds)
            findings += [
                f"{number}: {sent.name} after {1e3 * delay:.0f} ms, clt {command}: {text}"
                for text in stop(command, name, sent, delay, whole, folder)
            ]
    return findings


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="times that each signal is sent")
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    findings = study(given.count, given.seed)
    print(*findings, f"{len(findings)} findings in {3 * given.count} signals", sep="\n")
    return int(len(findings) > 0)


if __name__ == "__main__":
    sys.exit(main())
