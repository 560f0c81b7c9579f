"""Files that are being written: known by their names, locked while their process lives.

What a process that was killed left behind is removed by the next one that writes the same target.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clt.core.errors import CltError

if sys.platform != "win32":
    import fcntl

_own: set[Path] = set()


@contextmanager
def unfinished_file(target: Path) -> Iterator[Path]:
    """An empty file beside `target`, with its suffix; gone at the end unless it was renamed.

    Raises CltError naming `target` where there can be no such file.
    """
    try:
        beside = target.resolve()
        remove_abandoned(beside)
        path, file = _create(beside)
    except OSError as error:
        raise CltError(f"{target}: {error.strerror or error}") from error
    except RuntimeError:
        raise CltError(f"{target}: its symbolic links go round in a circle") from None
    try:
        yield path
    finally:
        path.unlink(missing_ok=True)
        _own.discard(path)
        os.close(file)


def discard() -> None:
    """Remove all unfinished files of this process, which is about to end."""
    for path in tuple(_own):
        with suppress(OSError):
            path.unlink(missing_ok=True)


def remove_abandoned(target: Path) -> None:
    """Remove the unfinished files of `target` whose processes are dead."""
    head, tail = re.escape(_head(target)), re.escape(target.suffix)
    pattern = re.compile(rf"{head}[0-9a-f]{{8}}{tail}", re.DOTALL)
    with suppress(OSError):
        for path in target.parent.iterdir():
            if pattern.fullmatch(path.name) is not None:
                _remove_if_dead(path)


def _head(target: Path) -> str:
    return f".{target.stem[:100]}.clt-"


def _create(target: Path) -> tuple[Path, int]:
    """A new file and its descriptor, which holds the lock."""
    while True:
        path = target.with_name(f"{_head(target)}{os.urandom(4).hex()}{target.suffix}")
        _own.add(path)
        try:
            file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            _own.discard(path)
            continue
        except OSError:
            _own.discard(path)
            raise
        if _locked(file) is not False and path.exists():
            return path, file
        # Another process swept between the two steps.
        os.close(file)
        _own.discard(path)


def _remove_if_dead(path: Path) -> None:
    """Remove a file that nobody has locked."""
    with suppress(OSError):
        file = os.open(path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0))
        try:
            if _locked(file):
                path.unlink(missing_ok=True)
        finally:
            os.close(file)


def _locked(file: int) -> bool | None:
    """Whether the lock was free and is now held; None where files cannot be locked."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True
