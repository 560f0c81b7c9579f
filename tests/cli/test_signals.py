"""Ctrl-C and SIGTERM end a command cleanly: one line at most, and no half-written file."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from functools import partial

import pytest

from tests.fuzz import signals
from tests.log.logs import small_log

PATIENCE = 60.0


@pytest.fixture
def started(tmp_path):
    """Start `clt` in an empty folder and wait for its temporary file."""
    running = []

    def start(*words):
        process = subprocess.Popen(
            [sys.executable, "-m", "clt", *words],
            cwd=tmp_path,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            # Whoever started the tests may ignore Ctrl-C, and children inherit that.
            preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
        )
        running.append(process)
        return process

    yield start
    for process in running:
        process.kill()
        process.communicate()


def until_it_writes(process, folder):
    """Wait for the temporary file beside the output."""
    end = time.monotonic() + PATIENCE
    while not list(folder.glob(".out.*")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.parametrize(
    ("sent", "code", "said"),
    [(signal.SIGINT, 130, b"clt: interrupted\n"), (signal.SIGTERM, 143, b"clt: terminated\n")],
)
def test_a_stopped_command_leaves_no_file(started, tmp_path, sent, code, said):
    """`recover -` has opened its output and waits for the rest of its input."""
    process = started("recover", "-", "-o", "out.mcap")
    process.stdin.write(small_log()[:2000])
    process.stdin.flush()
    until_it_writes(process, tmp_path)
    process.send_signal(sent)
    assert process.wait(PATIENCE) == code
    assert (process.stdout.read(), process.stderr.read()) == (b"", said)
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_while_a_long_log_is_written(started, tmp_path):
    process = started("simulate", "shi-sim", "--duration", "3000", "-o", "out.mcap")
    until_it_writes(process, tmp_path)
    process.send_signal(signal.SIGINT)
    assert process.wait(PATIENCE) == 130
    assert process.stderr.read() == b"clt: interrupted\n"
    assert list(tmp_path.iterdir()) == []


def test_commands_stopped_at_random_moments():
    assert signals.study(count=3, seed=1) == []


def test_a_command_that_was_killed_leaves_nothing_once_the_next_one_has_run(started, tmp_path):
    process = started("recover", "-", "-o", "out.mcap")
    process.stdin.write(small_log()[:2000])
    process.stdin.flush()
    until_it_writes(process, tmp_path)
    alive = started("recover", "-", "-o", "out.mcap", "--force")
    alive.stdin.write(small_log()[:2000])
    alive.stdin.flush()
    while len(list(tmp_path.iterdir())) < 2:
        assert alive.poll() is None, alive.communicate()
        time.sleep(0.005)
    process.kill()
    process.communicate()
    for name in (".out.mcap", ".out.clt-0000000.mcap", "out.clt-00000000.mcap"):
        (tmp_path / name).write_bytes(b"the user's own")
    (tmp_path / "whole.mcap").write_bytes(small_log())
    third = started("recover", "whole.mcap", "-o", "out.mcap")
    assert third.wait(PATIENCE) == 0, third.communicate()
    hidden = list(tmp_path.glob(".out.clt-????????.mcap"))
    assert len(hidden) == 1  # that of the process that is alive
    assert alive.communicate(small_log()[2000:], PATIENCE)[0] == b""
    assert alive.returncode == 0
    left = {path.name for path in tmp_path.iterdir()} - {"whole.mcap", "out.mcap"}
    assert left == {".out.mcap", ".out.clt-0000000.mcap", "out.clt-00000000.mcap"}
