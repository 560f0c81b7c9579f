"""PyFG text graphs (PyFactorGraph): planar poses, relative poses, ranges, plain or gzip.

- `VERTEX_SE2 t NAME x y theta`: the true pose of a robot; its letters name the robot;
- `VERTEX_XY NAME x y`: a landmark; here a static robot at a known position;
- `EDGE_SE2 t FROM TO dx dy dtheta` and the upper triangle of the covariance: odometry between
  poses that follow each other;
- `EDGE_RANGE t FROM TO range variance`;
- `EDGE_SE2_XY t FROM TO dx dy` and the upper triangle: a landmark in the body frame of a pose, of
  which clt takes the distance.

Relative poses become twists between the stamps of the two poses: turns near a whole one are
wrapped, a step that no arc makes is a turn, an arc and a turn back, and one that is much longer
than the others becomes several samples, since all of its motion is known. A range keeps the stamp
of its edge, which is when it was measured and not when its pose is, unless the two are further
apart than MAX_EDGE_OFFSET_S. Stated covariances are taken as stated. The ranges of published
files were fitted to the truth, without their outliers. Nothing says when a sample reached the
recorder, so log_time = stamp.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from clt.core.arrays import Indices
from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.columns import RawRanges, run_notes, sorted_ranges, truth_of_static
from clt.importers.pyfg_graph import PyfgGraph, read_pyfg_graph
from clt.importers.steps import (
    RelativePoses,
    intervals_to_odometry,
    relative_poses_to_intervals,
)
from clt.log.faults import Faults

MAX_EDGE_OFFSET_S = 0.5
"""The stamp of a range is as far from that of its pose at most, s."""


def pyfg_files(path: Path) -> tuple[Path]:
    """The file itself."""
    return (path,)


def read_pyfg(path: Path) -> Recording:
    """Read one graph.

    Raises:
        LogError: naming the file, the line and what is missing or wrong in it.
    """
    graph = read_pyfg_graph(path)
    faults, notes = Faults(str(path)), list[str]()
    for kind, count in graph.left_out.items():
        notes.append(f"{count} lines {kind} were left out")
    team = _team(graph)
    row_of = {name: row for row, name in enumerate(team.names)}
    order = {name: _order_of_poses(graph, name, path) for name in graph.robots}
    truth = {
        name: Poses(
            WORLD_FRAME,
            graph.stamp[rows],
            graph.stamp[rows],
            graph.x[rows],
            graph.y[rows],
            wrap_angle(graph.theta[rows]),
        )
        for name, rows in order.items()
    }
    odometry = {
        name: found
        for name, rows in order.items()
        if (found := _odometry(graph, name, rows, notes)) is not None
    }
    return Recording(
        team=team,
        odometry=odometry,
        ranges=_ranges(graph, row_of, faults, notes),
        truth={**truth, **truth_of_static(team.robots, truth)},
        run=run_notes(notes),
        faults=faults.all(),
    )


def _team(graph: PyfgGraph) -> Team:
    """Robots by letter, then landmarks, numbered from 1."""
    names = [*graph.robots, *graph.landmarks]
    return Team(
        tuple(
            Robot(name, number, static=name in graph.landmarks, position=graph.landmarks.get(name))
            for number, name in enumerate(names, 1)
        )
    )


def _order_of_poses(graph: PyfgGraph, name: str, path: Path) -> Indices:
    """Rows of a robot's poses by stamp. Raises LogError for two poses at one time."""
    rows = np.flatnonzero(graph.robot == graph.robots.index(name))
    rows = rows[np.argsort(graph.stamp[rows], kind="stable")]
    same = np.flatnonzero(np.diff(graph.stamp[rows]) == 0)
    if len(same) > 0:
        at = graph.stamp[rows[same[0]]] * 1e-9
        raise LogError(f"{path}: robot {name} has two poses at {at:.3f} s")
    return rows


def _odometry(graph: PyfgGraph, name: str, rows: Indices, notes: list[str]) -> Odometry | None:
    """Relative poses between poses that follow each other; None without any."""
    place = np.full(len(graph.stamp), -1, np.int64)
    place[rows] = np.arange(len(rows))
    steps = graph.steps
    own = graph.robot[steps.begin] == graph.robots.index(name)
    follows = own & (place[steps.end] == place[steps.begin] + 1)
    other = int(np.count_nonzero(own & ~follows))
    if other > 0:
        notes.append(f"{name}: {other} relative poses are loops or lead to other robots: left out")
    chosen = np.flatnonzero(follows)
    chosen = chosen[np.argsort(graph.stamp[steps.begin[chosen]], kind="stable")]
    chosen = chosen[np.append(True, np.diff(steps.begin[chosen]) != 0)[: len(chosen)]]
    if len(chosen) == 0:
        return None
    x, y, turn, var_x, var_y, var_turn = steps.values[chosen].T
    begin, end = graph.stamp[steps.begin[chosen]], graph.stamp[steps.end[chosen]]
    unknown = [np.where(one > 0.0, one, np.nan) for one in (var_x, var_y, var_turn)]
    intervals, bent = relative_poses_to_intervals(RelativePoses(begin, end, x, y, turn, *unknown))
    odometry, cut = intervals_to_odometry(intervals)
    said = {
        "turns beyond pi were wrapped": int(np.count_nonzero(np.abs(turn) > np.pi)),
        "steps are a turn, an arc and a turn": bent,
        "intervals much longer than the others became several samples": cut,
        "steps have no edge": len(rows) - 1 - len(chosen),
    }
    notes += [f"{name}: {count} of {len(chosen)} {what}" for what, count in said.items() if count]
    return odometry


def _ranges(
    graph: PyfgGraph, row_of: Mapping[str, int], faults: Faults, notes: list[str]
) -> Ranges:
    """Ranges at the stamps of their edges, where these are near those of their poses."""
    edges = graph.ranges
    source = np.array([row_of[graph.owner(name)] for name in edges.source], np.int64)
    target = np.array([row_of[graph.owner(name)] for name in edges.target], np.int64)
    stamp, pose = edges.stamp.copy(), graph.stamps_of(edges.source)
    off = np.abs(stamp - pose)
    far = (pose >= 0) & (off > round(MAX_EDGE_OFFSET_S * 1e9))
    stamp[far] = pose[far]
    near = (pose >= 0) & ~far & (off > 0)
    if near.any():
        notes.append(
            f"{np.count_nonzero(near)} ranges keep the stamp of their edge, up to "
            f"{off[near].max() * 1e-9:.3f} s off that of their pose"
        )
    if far.any():
        notes.append(
            f"{np.count_nonzero(far)} ranges took the stamp of their pose: that of their edge is "
            f"up to {off[far].max() * 1e-9:.1f} s off"
        )
    if graph.relative_positions > 0:
        notes.append(
            f"{graph.relative_positions} relative positions (EDGE_SE2_XY) became their distances"
        )
    return sorted_ranges(
        RawRanges(stamp, source, target, edges.value, edges.sigma), len(row_of), faults
    )
