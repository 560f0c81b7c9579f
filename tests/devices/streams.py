"""Bytes of devices for tests, and `clt record` in a process of its own."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import time

from typer.testing import CliRunner

from clt.cli.app import app

PATIENCE = 180.0


def range_line(t, k=0, one="R1", other="R2", distance=None):
    """A line of ndjson; every range is different."""
    value = 1.0 + 0.001 * k if distance is None else distance
    said = {"type": "range", "from": one, "to": other, "range": value, "t": t, "seq": k}
    return json.dumps(said).encode() + b"\n"


def odometry_line(t, v=0.5, w=0.1, node="R1"):
    said = {"type": "odom", "node": node, "v": v, "w": w, "t": t}
    return json.dumps(said).encode() + b"\n"


def rcl_range(ms, one, other, distance):
    payload = struct.pack("<IBBd", ms, one, other, distance)
    return b"\xa5\x5a\x0f\x03" + payload + b"\xdd"


def rcl_wheels(ms, node, interval, dx, dphi):
    payload = struct.pack("<IBBfff", ms, node, interval, dx, 0.0, dphi)
    return b"\xa5\x5a\x13\x02" + payload + b"\xdd"


def rcl_inertial(ms, node, *values):
    return b"\xa5\x5a\x12\x01" + struct.pack("<IB6h", ms, node, *values) + b"\xdd"


def start(folder, *words, limit_blocks=None, stdin=subprocess.DEVNULL):
    """`clt record` with these words; it answers Ctrl-C whatever the parent does."""
    command = [sys.executable, "-m", "clt", "record", *words]
    if limit_blocks is not None:
        command = ["sh", "-c", f'ulimit -f {limit_blocks}; exec "$@"', "sh", *command]
    return subprocess.Popen(
        command,
        cwd=folder,
        env={name: text for name, text in os.environ.items() if not name.startswith("CLT_")},
        stdin=stdin,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=heed_signals,  # noqa: PLW1509 - nothing but signals
    )


def heed_signals():
    """Signals end this process, even if the parent was started to ignore them."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def until(condition, process=None):
    """Wait until something is so."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)


def ended(process, code=0):
    """Standard output and error of a process that ends with this code."""
    out, error = process.communicate(timeout=PATIENCE)
    assert process.returncode == code, (process.returncode, out, error)
    return out.decode(), error.decode()


def simulated(path, scenario, seconds, *settings):
    """A simulated log at this path."""
    words = [word for one in settings for word in ("--set", one)]
    command = ["simulate", scenario, "--duration", str(seconds), "--seed", "3", *words]
    done = CliRunner().invoke(app, [*command, "-o", str(path)])
    assert done.exit_code == 0, done.output
