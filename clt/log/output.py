"""Where results go: a file that appears whole or not at all, or standard output."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from clt.core.errors import CltError, UsageError
from clt.log.unfinished import unfinished_file

STDOUT = Path("-")


@contextmanager
def open_output(path: Path, force: bool = False, inputs: Sequence[Path] = ()) -> Iterator[BinaryIO]:
    """A binary file that takes its final name only when the block ends without an exception.

    `-` is standard output (it need not be seekable). `inputs` are files that must not be
    overwritten even with `force`. Raises UsageError for a terminal, CltError for a target that
    exists without `force`, that is an input, or that cannot be written (e.g. a full disk).
    """
    if path == STDOUT:
        _refuse_terminal()
        with _naming_write_errors(Path("standard output")):
            try:
                yield sys.stdout.buffer
                sys.stdout.buffer.flush()
            except OSError:
                silence_stdout()
                raise
    elif is_device(path):
        with _naming_write_errors(path), path.open("wb") as file:
            yield file
    else:
        with (
            temporary_output(path, force, inputs) as temporary,
            _naming_write_errors(path, temporary),
            temporary.open("wb") as file,
        ):
            yield file
            file.flush()
            os.fsync(file.fileno())


@contextmanager
def temporary_output(
    path: Path, force: bool = False, inputs: Sequence[Path] = ()
) -> Iterator[Path]:
    """A temporary path beside `path`, renamed to it on success and removed on any exception.

    For writers that want a name; the suffix is kept. Raises CltError as `open_output` does.
    """
    check_output(path, force, inputs)
    with unfinished_file(path) as temporary:
        yield temporary
        with _naming_write_errors(path, temporary):
            _take_name(temporary, path, force)


def _take_name(temporary: Path, path: Path, force: bool) -> None:
    """Give the finished file its name. Raises CltError where it is taken, unless `force`.

    A link, unlike a renaming, fails where the name exists; where a file system has no links, the
    name is looked at just before.
    """
    if not force:
        try:
            os.link(temporary, path.resolve())
        except FileExistsError:
            raise CltError(f"{path}: appeared meanwhile; use --force to overwrite it") from None
        except OSError:
            if path.exists():
                raise CltError(f"{path}: appeared meanwhile; use --force to overwrite it") from None
        else:
            return  # the temporary name is removed by the caller
    temporary.replace(path.resolve())


def check_output(path: Path, force: bool = False, inputs: Sequence[Path] = ()) -> None:
    """Raise CltError unless `path` may be written; for commands to call before they work."""
    if path == STDOUT:
        _refuse_terminal()
        return
    if not path.parent.is_dir():
        raise CltError(f"{path}: no directory {path.parent}; create it first")
    if path.is_dir():
        raise CltError(f"{path}: is a directory; name a file in it")
    if any(_same(path, other) for other in inputs):
        raise CltError(f"{path}: is also an input; choose another output")
    if path.exists() and not force and not is_device(path):
        raise CltError(f"{path}: exists; use --force to overwrite it")


def _same(path: Path, other: Path) -> bool:
    return path.exists() and other.exists() and path.samefile(other)


def _refuse_terminal() -> None:
    if sys.stdout.isatty():
        raise UsageError("standard output is a terminal; give a file or a pipe: -o LOG")


def silence_stdout() -> None:
    """Let what Python still holds for a broken standard output vanish when it exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def is_device(path: Path) -> bool:
    """A device or a named pipe: written in place, never replaced."""
    return path.exists() and not path.is_file() and not path.is_dir()


@contextmanager
def _naming_write_errors(path: Path, temporary: Path | None = None) -> Iterator[None]:
    """Name `path` in an error of writing it; errors about other files pass through."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.filename not in {None, str(path), str(temporary)}:
            raise
        raise CltError(f"{path}: {error.strerror or error}") from error
