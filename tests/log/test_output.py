"""Results appear whole or not at all."""

from __future__ import annotations

import errno
import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from clt.core.errors import CltError, UsageError
from clt.log.output import check_output, open_output, temporary_output

FULL = Path("/dev/full")


def names(directory):
    return sorted(path.name for path in directory.iterdir())


def test_the_file_appears_at_the_end(tmp_path):
    with open_output(tmp_path / "a.mcap") as file:
        file.write(b"abc")
        assert "a.mcap" not in names(tmp_path)
    assert (tmp_path / "a.mcap").read_bytes() == b"abc"
    assert names(tmp_path) == ["a.mcap"]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, BrokenPipeError])
def test_nothing_is_left_of_a_failure(tmp_path, error):
    with pytest.raises(error), open_output(tmp_path / "a.mcap") as file:  # noqa: PT012
        file.write(b"abc")
        raise error
    assert names(tmp_path) == []


def test_a_failure_keeps_the_old_file(tmp_path):
    target = tmp_path / "a.mcap"
    target.write_bytes(b"old")
    with pytest.raises(ValueError, match="no"), open_output(target, force=True) as file:  # noqa: PT012
        file.write(b"new")
        raise ValueError("no")
    assert target.read_bytes() == b"old"
    assert names(tmp_path) == ["a.mcap"]


def test_overwriting_needs_force(tmp_path):
    target = tmp_path / "a.mcap"
    target.write_bytes(b"old")
    with pytest.raises(CltError, match="exists; use --force"), open_output(target):
        pass
    assert target.read_bytes() == b"old"
    with open_output(target, force=True) as file:
        file.write(b"new")
    assert target.read_bytes() == b"new"


def test_force_writes_through_a_link(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "link").symlink_to(tmp_path / "a")
    with open_output(tmp_path / "link", force=True) as file:
        file.write(b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "a").read_bytes() == b"new"


def test_a_missing_directory(tmp_path):
    with pytest.raises(CltError, match="no directory"), open_output(tmp_path / "b" / "a.mcap"):
        pass


def test_a_directory_as_target(tmp_path):
    with pytest.raises(CltError, match="is a directory"), open_output(tmp_path, force=True):
        pass


@pytest.mark.parametrize("force", [False, True])
def test_an_input_is_never_overwritten(tmp_path, force):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").hardlink_to(tmp_path / "a")
    with pytest.raises(CltError, match="also an input"):
        check_output(tmp_path / "b", force, inputs=[Path("-"), tmp_path / "a"])


def full_disk(*args):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("step", ["write", "fsync", "rename"])
def test_a_full_disk_leaves_no_file(tmp_path, monkeypatch, step):
    target = tmp_path / "a.mcap"
    if step == "fsync":
        monkeypatch.setattr(os, "fsync", full_disk)
    if step == "rename":
        monkeypatch.setattr(os, "link", full_disk)
        monkeypatch.setattr(Path, "replace", full_disk)
    with pytest.raises(CltError) as caught, open_output(target) as file:  # noqa: PT012
        file.write(b"abc")
        if step == "write":
            full_disk()
    assert str(caught.value) == f"{target}: No space left on device"
    assert names(tmp_path) == []


def test_an_unwritable_directory(tmp_path, monkeypatch):
    def refuse(self, *args, **kwargs):
        raise PermissionError(errno.EACCES, "Permission denied", str(self))

    monkeypatch.setattr(Path, "open", refuse)
    target = tmp_path / "a.mcap"
    with pytest.raises(CltError, match="Permission denied") as caught, open_output(target):
        pass
    assert str(caught.value).startswith(f"{target}: ")


def test_an_error_about_another_file_keeps_its_name(tmp_path):
    with pytest.raises(FileNotFoundError, match="missing"), open_output(tmp_path / "a.mcap"):
        (tmp_path / "missing").read_bytes()


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here")
def test_a_full_device_is_written_in_place():
    with pytest.raises(CltError, match="No space left"), open_output(FULL) as file:
        file.write(b"abc")
    assert FULL.is_char_device()


def test_a_named_path_for_writers_that_want_one(tmp_path):
    with temporary_output(tmp_path / "a.png") as path:
        assert path.suffix == ".png"
        path.write_bytes(b"abc")
    assert (tmp_path / "a.png").read_bytes() == b"abc"
    assert names(tmp_path) == ["a.png"]


class Terminal(io.TextIOWrapper):
    def isatty(self):
        return True


def test_a_terminal_is_refused(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Terminal(io.BytesIO()))
    with pytest.raises(UsageError, match="terminal"), open_output(Path("-")):
        pass


PROGRAM = """
from pathlib import Path
from clt.core.errors import CltError
from clt.log.output import open_output
import sys
try:
    with open_output(Path("-")) as file:
        file.write(b"abc" * {times})
except CltError as error:
    print(error, file=sys.stderr)
    sys.exit(error.code)
"""


def run(times, stdout):
    program = [sys.executable, "-c", PROGRAM.format(times=times)]
    return subprocess.run(program, stdout=stdout, stderr=subprocess.PIPE, check=False)


def test_standard_output_takes_bytes():
    done = run(1, subprocess.PIPE)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"abc", b"")


@pytest.mark.skipif(not FULL.exists(), reason="no /dev/full here")
@pytest.mark.parametrize("times", [1, 100_000])
def test_a_full_standard_output_is_one_line(times):
    with FULL.open("wb") as full:
        done = run(times, full)
    assert (done.returncode, done.stderr) == (1, b"standard output: No space left on device\n")
