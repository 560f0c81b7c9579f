"""Text files of lines and words, plain or gzip, read line by line into compact columns."""

from __future__ import annotations

import gzip
import re
import zlib
from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal, InvalidOperation
from io import TextIOWrapper
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.log.faults import Faults
from clt.log.recording import cleaning

MAX_LINE_CHARACTERS = 1 << 16
"""No line of a table is longer; a file without line ends is no table."""
SECONDS_PATTERN = re.compile(r"(\d{1,10})(?:\.(\d*))?", re.ASCII)
"""Read digit by digit: a float has no room for nanoseconds."""
ROS_TIME_END_S = 1 << 31
"""The first second that is not ROS 2 time."""


class StampedRows(NamedTuple):
    """Rows of a table in the order of their stamps."""

    stamp: Stamps
    """ns, shape (n,)."""
    values: Floats
    """The columns behind the time, shape (n, width)."""


@contextmanager
def open_text(path: Path) -> Iterator[TextIO]:
    """A UTF-8 text file, plain or gzip. Raises LogError for what reading it meets."""
    try:
        with path.open("rb") as file:
            packed = file.read(2) == b"\x1f\x8b"
            file.seek(0)
            with TextIOWrapper(gzip.open(file) if packed else file, "utf-8", newline="") as text:
                yield text
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path}: a damaged gzip file: {error}") from None
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: not a text file: {error}") from None
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None


def read_words(path: Path, separator: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """Number and words of every line that is neither empty nor a comment (`#`).

    Raises LogError for a file that cannot be read or is no text.
    """
    with open_text(path) as file:
        number = 0
        while (line := file.readline(MAX_LINE_CHARACTERS)) != "":
            number += 1
            if len(line) == MAX_LINE_CHARACTERS:
                raise LogError(f"{path}: line {number}: longer than a line of a table can be")
            line = line.strip()
            if line != "" and not line.startswith("#"):
                yield number, line.split(separator)


def read_rows(path: Path, width: int, what: str, faults: Faults) -> StampedRows:
    """Rows of a time (s) and `width` numbers, sorted by stamp; further words are left.

    Unusable rows are faults that name the first of them, and dropped. Raises LogError for a file
    that cannot be read or has no usable row; `what` says what a row should be.
    """
    stamps, values, wrong = array("q"), array("d"), array("q")
    for number, words in read_words(path):
        stamp = parse_stamp(words[0])
        numbers = parse_floats(words[1 : width + 1])
        if stamp is None or numbers is None or len(numbers) < width:
            wrong.append(number)
        else:
            stamps.append(stamp)
            values.extend(numbers)
    report_lines(faults, path, wrong, f"not {what}")
    rows = StampedRows(
        np.frombuffer(stamps, np.int64) if len(stamps) > 0 else np.empty(0, np.int64),
        (np.frombuffer(values) if len(values) > 0 else np.empty(0)).reshape(-1, width),
    )
    kept = cleaning.usable_rows(faults, path.name, np.ones(len(rows.stamp), np.bool_), rows.values)
    kept = kept[cleaning.sorted_rows(faults, path.name, rows.stamp[kept])]
    if len(kept) == 0:
        raise LogError(f"{path}: no line holds {what}")
    return StampedRows(rows.stamp[kept], rows.values[kept])


def report_lines(faults: Faults, path: Path, lines: array[int], text: str) -> None:
    """Note lines that were dropped, if any: lost data, with the number of the first."""
    if len(lines) > 0:
        said = f"{len(lines)} line{'s' if len(lines) > 1 else ''} {text}; dropped"
        faults.add("row", f"{path.name} line {lines[0]}", said, count=len(lines), lost=True)


def parse_stamp(word: str) -> int | None:
    """Seconds as nanoseconds, digits beyond the ninth cut off; None for no time of ROS 2."""
    match = SECONDS_PATTERN.fullmatch(word)
    if match is not None:
        second, rest = int(match[1]), match[2] or ""
        if second >= ROS_TIME_END_S:
            return None
        return second * 1_000_000_000 + int(rest[:9].ljust(9, "0"))
    try:
        stamp = Decimal(word) * 1_000_000_000
    except InvalidOperation:
        return None
    if not stamp.is_finite() or not 0 <= stamp < ROS_TIME_END_S * 1_000_000_000:
        return None
    return int(stamp)


def parse_floats(words: list[str]) -> list[float] | None:
    """Numbers; None where one word is none."""
    try:
        return [float(word) for word in words]
    except ValueError:
        return None
