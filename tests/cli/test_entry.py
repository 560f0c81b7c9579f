"""The program's own entry point: endings of the thread in which a command runs."""

from __future__ import annotations

import signal
import subprocess
import sys
from functools import partial


def clt(*words, ignored=False):
    """Run the program; SIGTERM ignored by whoever starts it, or not."""
    handler = signal.SIG_IGN if ignored else signal.SIG_DFL
    return subprocess.Popen(
        [sys.executable, "-m", "clt", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=partial(signal.signal, signal.SIGTERM, handler),  # noqa: PLW1509
    )


def test_exit_codes_and_texts_are_those_of_the_command(tmp_path):
    version = clt("--version")
    out, err = version.communicate()
    assert (version.returncode, err) == (0, b"")
    assert out.startswith(b"clt ")
    wrong = clt("info", str(tmp_path / "none.mcap"))
    out, err = wrong.communicate()
    assert (wrong.returncode, out) == (1, b"")
    assert err.endswith(b"No such file or directory\n")


def test_a_signal_that_the_program_was_started_to_ignore_stays_ignored(tmp_path):
    """As `nohup` and shells do; the command reads on until its input ends."""
    process = clt("info", "-", ignored=True)
    process.stdin.write(b"x")
    process.stdin.flush()
    for _ in range(5):
        process.send_signal(signal.SIGTERM)
    out, err = process.communicate()
    assert process.returncode == 1
    assert (out, err.count(b"\n")) == (b"", 1)
    assert err.startswith(b"clt: error: ")
