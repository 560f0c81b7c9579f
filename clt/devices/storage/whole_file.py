"""A file that takes all it is given or says why not."""

from __future__ import annotations

import os
from pathlib import Path


class WholeFile:
    """Written without a buffer of its own, so that what failed can be taken back."""

    def __init__(self, path: Path, *, force: bool) -> None:
        """Create `path`. Raises FileExistsError unless `force`, and other OSError."""
        flags = os.O_WRONLY | os.O_CREAT | (os.O_TRUNC if force else os.O_EXCL)
        self._file = os.open(path, flags | getattr(os, "O_BINARY", 0), 0o666)

    def write(self, data: bytes) -> int:
        """Write all of it. Raises OSError, part of it perhaps written."""
        view = memoryview(data)
        while len(view) > 0:
            view = view[os.write(self._file, view) :]
        return len(data)

    def seek(self, position: int) -> int:
        """Go on at a byte."""
        return os.lseek(self._file, position, os.SEEK_SET)

    def truncate(self) -> None:
        """Cut the file off where it is."""
        os.ftruncate(self._file, os.lseek(self._file, 0, os.SEEK_CUR))

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Bring it to the disk and let go of it; again: nothing."""
        file, self._file = self._file, -1
        if file >= 0:
            try:
                os.fsync(file)
            finally:
                os.close(file)
