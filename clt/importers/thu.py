"""The Tsinghua run of 18 April 2019 (range_only_CL): UWB, wheel encoders, laser-SLAM truth.

`data190313.mat` (MATLAB 5) holds two arrays of structs:

- `range_m`: pair (two ids), t (s), range (m) as the radios gave it, 100 Hz for each of 6 pairs;
- `robot`: id; truth t (s), x, y (m), phi (rad) at 2 Hz; odometry t_m (s), v_m (m/s), omega_m
  (rad/s) at 20 Hz, each sample the mean over the interval that ends at its stamp.

`Data1.txt` beside it holds the surveyed positions of the nodes that stand still, in the frame of
the truth: a line ending in `ID<id>`, the next line `x, y` in metres. Its other text is GBK.

Robots are named R<id>. Stamps are the file's own seconds (an arbitrary zero, one time base for all
streams) in nanoseconds; when a sample reached the recorder is not known, so log_time = stamp.
The ranges read about 0.58 m short: give `clt import` or `clt localize` a calibration.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.matfile import read_mat_file

MAT_FILE = "data190313.mat"
SURVEY_FILE = "Data1.txt"
NODE_PATTERN = re.compile(r"ID(\d+)\s*\n\s*([-+.\d]+)\s*,\s*([-+.\d]+)\s*\n")


def thu_files(path: Path) -> tuple[Path, Path]:
    """The .mat file and the survey for the data set's folder or its .mat file."""
    mat = path / MAT_FILE if path.is_dir() else path
    return mat, mat.with_name(SURVEY_FILE)


def read_thu(path: Path) -> Recording:
    """Read the folder of the data set, or its .mat file with `Data1.txt` beside it.

    Raises:
        LogError: naming the file and what is missing or wrong in it.
    """
    mat, survey = thu_files(path)
    ranges, robots = _read_mat(mat)
    moving = {_integers(robot, "id", 1, f"{mat}: robot")[0]: robot for robot in robots}
    pairs = [_integers(entry, "pair", 2, f"{mat}: range_m") for entry in ranges]
    if len(moving) < len(robots):
        raise LogError(f"{mat}: two entries of `robot` share one id")
    if any(a == b for a, b in pairs):
        raise LogError(f"{mat}: a `range_m` measures from a node to itself")
    static = sorted({node for pair in pairs for node in pair} - set(moving))
    team = _team(sorted(moving), static, survey)
    names = {robot.id: robot.name for robot in team.robots}
    truth = {names[i]: _truth(moving[i], f"{mat}: robot {i}") for i in sorted(moving)}
    return Recording(
        team=team,
        odometry={names[i]: _odometry(moving[i], f"{mat}: robot {i}") for i in sorted(moving)},
        ranges=_ranges(ranges, pairs, team, mat),
        truth={**_anchors(team, truth), **truth},
    )


def _anchors(team: Team, truth: Mapping[str, Poses]) -> dict[str, Poses]:
    """The surveyed nodes as a reference, at the stamps of the first truth; no heading."""
    stamp = next(iter(truth.values())).stamp
    one = np.ones(len(stamp))
    return {
        robot.name: Poses(
            WORLD_FRAME,
            stamp,
            stamp,
            robot.position[0] * one,
            robot.position[1] * one,
            np.nan * one,
        )
        for robot in team.static
        if robot.position is not None
    }


def _read_mat(path: Path) -> tuple[list[Any], list[Any]]:
    """The entries of `range_m` and of `robot`."""
    content = read_mat_file(path, MAT_FILE)
    return _structs(content, "range_m", path), _structs(content, "robot", path)


def _structs(content: dict[str, Any], name: str, path: Path) -> list[Any]:
    if name not in content:
        raise LogError(f"{path}: no `{name}` in it")
    value = np.atleast_1d(content[name])
    if value.dtype.names is None or len(value) == 0:
        raise LogError(f"{path}: `{name}` is not an array of structs")
    return list(value.ravel())


def _column(entry: Any, name: str, place: str) -> Floats:
    """A field of a struct as finite numbers, shape (n,)."""
    if name not in entry.dtype.names:
        raise LogError(f"{place}: no field `{name}`")
    try:
        column = np.ravel(np.asarray(entry[name], dtype=np.float64))
    except (TypeError, ValueError):
        raise LogError(f"{place}: `{name}` is not numeric") from None
    if not np.all(np.isfinite(column)):
        raise LogError(f"{place}: `{name}` holds values that are not finite")
    return column


def _columns(entry: Any, names: tuple[str, ...], place: str) -> list[Floats]:
    """Fields of one length, in the order of the first, which is a time."""
    columns = [_column(entry, name, place) for name in names]
    lengths = [len(column) for column in columns]
    if len(set(lengths)) > 1:
        sizes = ", ".join(f"{name} {n}" for name, n in zip(names, lengths, strict=True))
        raise LogError(f"{place}: fields differ in length: {sizes}")
    order = np.argsort(columns[0], kind="stable")
    return [column[order] for column in columns]


def _integers(entry: Any, name: str, count: int, place: str) -> tuple[int, ...]:
    values = _column(entry, name, place)
    whole = (values >= 0) & (values < 2**16) & (values == np.round(values))
    if len(values) != count or not np.all(whole):
        raise LogError(f"{place}: `{name}` should hold {count} id(s), 0 to 65535")
    return tuple(int(value) for value in values)


def _nanoseconds(seconds: Floats) -> Stamps:
    return np.rint(seconds * 1e9).astype(np.int64)


def _team(moving: list[int], static: list[int], survey: Path) -> Team:
    """All nodes in the order of their ids."""
    positions = _survey(survey)
    for node in static:
        if node not in positions:
            raise LogError(f"{survey}: no position of node {node}")
    robots = [Robot(f"R{node}", node) for node in moving]
    robots += [Robot(f"R{node}", node, static=True, position=positions[node]) for node in static]
    return Team(tuple(sorted(robots, key=lambda robot: robot.id)))


def _survey(path: Path) -> dict[int, tuple[float, float]]:
    """Surveyed positions (m) by id."""
    try:
        text = path.read_bytes().decode("ascii", errors="replace").replace("\r\n", "\n")
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    try:
        return {int(node): (float(x), float(y)) for node, x, y in NODE_PATTERN.findall(text)}
    except ValueError as error:
        raise LogError(f"{path}: a position is not two numbers: {error}") from None


def _odometry(robot: Any, place: str) -> Odometry:
    t, v, omega = _columns(robot, ("t_m", "v_m", "omega_m"), place)
    stamp, unknown = _nanoseconds(t), np.full(len(t), np.nan)
    return Odometry(stamp, stamp, v, omega, sigma_v=unknown, sigma_omega=unknown)


def _truth(robot: Any, place: str) -> Poses:
    t, x, y, heading = _columns(robot, ("t", "x", "y", "phi"), place)
    stamp = _nanoseconds(t)
    return Poses(WORLD_FRAME, stamp, stamp, x, y, heading)


def _ranges(entries: list[Any], pairs: list[tuple[int, ...]], team: Team, mat: Path) -> Ranges:
    """All pairs in one table by stamp; uncalibrated, so `range` is `raw`."""
    index = {robot.id: i for i, robot in enumerate(team.robots)}
    columns = [
        _columns(entry, ("t", "range"), f"{mat}: range_m of pair {'-'.join(map(str, pair))}")
        for entry, pair in zip(entries, pairs, strict=True)
    ]
    sizes = [len(t) for t, _ in columns]
    stamp = _nanoseconds(np.concatenate([t for t, _ in columns]))
    order = np.argsort(stamp, kind="stable")
    source, target = (
        np.repeat([index[pair[end]] for pair in pairs], sizes)[order] for end in (0, 1)
    )
    raw = np.concatenate([r for _, r in columns])[order]
    return Ranges(
        stamp=stamp[order],
        log_time=stamp[order],
        source=source,
        target=target,
        range=raw,
        raw=raw,
        sigma=np.full(len(raw), np.nan),
        sequence=np.concatenate([np.arange(n) for n in sizes])[order],
    )
