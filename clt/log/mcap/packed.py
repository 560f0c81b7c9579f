"""Files that were compressed as a whole (zstd, gzip), read as if they were not."""

from __future__ import annotations

import gzip
import hashlib
import io
import shutil
import zlib
from pathlib import Path
from typing import BinaryIO, Literal, cast

import zstandard

from clt.core.errors import LogError

Packing = Literal["zstd", "gzip"]
PACKING_MAGICS: dict[bytes, Packing] = {b"\x28\xb5\x2f\xfd": "zstd", b"\x1f\x8b": "gzip"}
COPY_BLOCK_BYTES = 1 << 20
MAX_UNPACKED_BYTES, MAX_UNPACKING_RATIO = 256 << 20, 200
"""What a file may unpack to: so many bytes, and beyond that so many times its own size."""


def detect_packing(start: bytes) -> Packing | None:
    """How a file is compressed, from its first bytes; None for one that is not."""
    return next((how for prefix, how in PACKING_MAGICS.items() if start.startswith(prefix)), None)


class UnpackedFile(io.RawIOBase):
    """The unpacked bytes of a file, in order; `sha256` is that of the file itself.

    Reading raises LogError for damage, and for a file that unpacks to far more than any log does.
    """

    def __init__(self, file: BinaryIO, packing: Packing, name: str) -> None:
        self._file = HashedFile(file)
        self._name, self._packing, self._size = name, packing, 0
        raw = cast("BinaryIO", self._file)
        self._stream: BinaryIO = (
            cast("BinaryIO", gzip.GzipFile(fileobj=raw))
            if packing == "gzip"
            else zstandard.ZstdDecompressor().stream_reader(raw, read_across_frames=True)
        )

    def read(self, size: int = -1) -> bytes:
        """At most `size` unpacked bytes; none at the end."""
        try:
            data = self._stream.read(size)
        except (EOFError, zlib.error, gzip.BadGzipFile, zstandard.ZstdError) as error:
            text = " ".join(str(error).split())
            raise LogError(f"{self._name}: a damaged {self._packing} file: {text}") from None
        self._size += len(data)
        if self._size > MAX_UNPACKED_BYTES + MAX_UNPACKING_RATIO * self._file.size:
            raise LogError(
                f"{self._name}: unpacks to {MAX_UNPACKING_RATIO} times its size; unpack it by hand"
            )
        return data

    def again(self, file: BinaryIO) -> UnpackedFile:
        """The same from the beginning of the rewound `file`."""
        return UnpackedFile(file, self._packing, self._name)

    def copy(self, path: Path) -> None:
        """Unpack everything into a file."""
        with path.open("wb") as file:
            shutil.copyfileobj(self, file, COPY_BLOCK_BYTES)

    def sha256(self) -> str:
        """Digest of the packed file; reads what is left of it."""
        while len(self._file.read(COPY_BLOCK_BYTES)) > 0:
            pass
        return self._file.digest.hexdigest()


class HashedFile(io.RawIOBase):
    """A stream that digests what is read from it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.digest = hashlib.sha256()
        self.size = 0

    def read(self, size: int = -1) -> bytes:
        """As the stream below."""
        data = self._file.read(size)
        self.digest.update(data)
        self.size += len(data)
        return data
