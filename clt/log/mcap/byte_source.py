"""Bytes of a stream in order, with their position and SHA-256; never seeks."""

from __future__ import annotations

import hashlib
from typing import BinaryIO

from clt.core.errors import LogError

READ_BLOCK_BYTES = 1 << 20


class ByteSource:
    """A regular file or a pipe behind a window of unread bytes.

    A claimed length costs no memory: the window grows only by what really arrives. Raises
    LogError where the stream cannot be read.
    """

    def __init__(self, stream: BinaryIO, name: str) -> None:
        self.name = name
        self.window = b""
        """Bytes that were read from the stream and not yet taken, from index `start` on."""
        self.start = 0
        self._stream = stream
        self._digest = hashlib.sha256()
        self._read = 0

    @property
    def position(self) -> int:
        """Offset of the next byte in the input."""
        return self._read - len(self.window) + self.start

    def fill(self, count: int) -> bool:
        """Bring `count` unread bytes into the window; False where the stream ends before."""
        if len(self.window) - self.start >= count:
            return True
        parts = [self.window[self.start :]]
        have = len(parts[0])
        while have < count:
            block = self._block()
            if len(block) == 0:
                break
            parts.append(block)
            have += len(block)
        self.window, self.start = b"".join(parts), 0
        return have >= count

    def peek(self, count: int) -> bytes:
        """The next bytes without taking them; fewer at the end."""
        self.fill(count)
        return self.window[self.start : self.start + count]

    def take(self, count: int) -> bytes:
        """The next bytes; fewer at the end."""
        data = self.peek(count)
        self.start += len(data)
        return data

    def skip(self, count: int) -> bool:
        """Pass over bytes without holding them; False where the stream ends before."""
        have = len(self.window) - self.start
        while count > have:
            count -= have
            self.window, self.start = self._block(), 0
            have = len(self.window)
            if have == 0:
                return False
        self.start += count
        return True

    def sha256(self) -> str:
        """Digest of the whole input; reads what is left of it."""
        while self.skip(READ_BLOCK_BYTES):
            pass
        return self._digest.hexdigest()

    def _block(self) -> bytes:
        try:
            block = self._stream.read(READ_BLOCK_BYTES)
        except OSError as error:
            raise LogError(f"{self.name}: {error.strerror or error}") from None
        self._digest.update(block)
        self._read += len(block)
        return block
