"""What is done of a study: a file that only grows, a line per task, so that a kill costs little."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import TracebackType
from typing import Self

from clt.core.errors import CltError
from clt.studies.task import RunOutcome


class Journal:
    """Outcomes of tasks by their digest, on disk; memory holds only where each stands."""

    def __init__(self, path: Path) -> None:
        """Open, or begin; drop an unfinished last line. Raises CltError while another has it."""
        self.path = path
        try:
            self._file = path.open("a+b")
        except OSError as error:
            raise CltError(f"{path}: {error.strerror}") from None
        try:
            _lock(self._file.fileno(), path)
            self._places = self._scan()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def __contains__(self, digest: str) -> bool:
        return digest in self._places

    def _scan(self) -> dict[str, int]:
        places: dict[str, int] = {}
        self._file.seek(0)
        end = 0
        for line in self._file:
            if not line.endswith(b"\n"):
                break
            with suppress(ValueError, KeyError, TypeError):  # A damaged line is done again.
                places[json.loads(line)["task"]] = end
            end += len(line)
        self._file.truncate(end)
        return places

    def add(self, digest: str, outcomes: Sequence[RunOutcome]) -> None:
        """Note what came of a task. Raises CltError where the disk is full."""
        line = {"task": digest, "runs": [asdict(one) for one in outcomes]}
        try:
            self._file.seek(0, os.SEEK_END)
            place = self._file.tell()
            self._file.write(json.dumps(line, allow_nan=False).encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise CltError(f"{self.path}: {error.strerror}") from None
        self._places[digest] = place

    def outcomes(self, digest: str) -> list[RunOutcome] | None:
        """What came of a task; None where it is not done."""
        place = self._places.get(digest)
        if place is None:
            return None
        self._file.seek(place)
        runs: Sequence[Mapping[str, object]] = json.loads(self._file.readline())["runs"]
        return [RunOutcome(**run) for run in runs]  # type: ignore[arg-type]


def _lock(descriptor: int, path: Path) -> None:
    """Keep other sweeps off while this process lives. Raises CltError where one is at it."""
    try:
        import fcntl  # noqa: PLC0415 - not on every system
    except ImportError:
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise CltError(f"{path.parent}: another sweep is at work there; wait for it") from None
