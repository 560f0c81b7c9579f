"""Whose a file is: `NAME=PATH` on the command line, or the name of the file."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from clt.core.errors import LogError
from clt.log.recording.metadata import ROBOT_NAME_PATTERN

NAMED_PATH_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9_]*)=(.+)", re.ASCII)
POSE_STREAMS = ("ground_truth", "estimate", "dead_reckoning")
"""What `ROBOT.STREAM.tum` may hold, as `clt export` names its files."""
GZIP_END = ".gz"


class NamedFile(NamedTuple):
    """A file of one robot."""

    path: Path
    robot: str | None
    """None where its name is no name of a robot."""
    stream: str | None
    """One of POSE_STREAMS; None where its name does not say."""


def named_files(paths: Iterable[Path], ends: Sequence[str]) -> tuple[NamedFile, ...]:
    """The files that paths stand for: of a folder those with one of `ends`, gzip or not.

    Raises LogError for a folder without any.
    """
    found: list[NamedFile] = []
    for path in paths:
        plain = plain_path(path)
        if plain != path:
            found.append(_named(plain)._replace(robot=str(path).partition("=")[0]))
        elif path.is_dir():
            inside = [
                file
                for file in sorted(path.iterdir())
                if file.name.removesuffix(GZIP_END).endswith(tuple(ends))
            ]
            if len(inside) == 0:
                raise LogError(f"{path}: no file in it ends in {' or '.join(ends)}")
            found += [_named(file) for file in inside]
        else:
            found.append(_named(path))
    return tuple(found)


def plain_path(path: Path) -> Path:
    """The path without `NAME=`."""
    match = NAMED_PATH_PATTERN.fullmatch(str(path))
    return path if match is None or path.exists() else Path(match[2])


def _named(path: Path) -> NamedFile:
    stem = path.name.removesuffix(GZIP_END)
    first, *rest = stem.split(".")
    stream = rest[0] if len(rest) > 0 and rest[0] in POSE_STREAMS else None
    good = ROBOT_NAME_PATTERN.fullmatch(first) is not None
    return NamedFile(path, first if good else None, stream)


def require_robot(file: NamedFile) -> str:
    """Whose the file is. Raises LogError, naming the remedy, where nothing says so."""
    if file.robot is None:
        raise LogError(f"{file.path}: its name is no name of a robot; give it as NAME={file.path}")
    return file.robot
