"""Fisher information of sliding windows about the team's pose at each window's end.

Errors are carried as (e, dtheta) with e = dp - J p dtheta, J the quarter turn: in these the
unicycle's error does not change while a robot drives, so that the transition is the identity, the
information of ranges adds up, and no direction becomes visible through changing linearization
points. Odometry noise takes information away: Y <- Y - Y g (1 / q + g^T Y g)^-1 g^T Y.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clt.filters.compiled import kernel
from clt.observability.reference import Reference
from clt.streams import Floats, Indices

FIXED = 1e8
"""Information (1 / m^2) that stands for a coordinate fixed by choice of the frame."""


def columns_of(reference: Reference) -> tuple[Indices, Indices]:
    """First column of each robot (n + 1,) and the robot of each column (d,)."""
    sizes = [2 if robot.static else 3 for robot in reference.robots]
    return np.cumsum([0, *sizes]), np.repeat(np.arange(len(sizes)), sizes)


def range_rows(reference: Reference, centre: Floats) -> tuple[Indices, Floats]:
    """Columns (ranges, 6), -1 for none, and whitened gradients (ranges, 6) of all ranges."""
    table, (first, _) = reference.ranges, columns_of(reference)
    apart = reference.ends[:, 0] - reference.ends[:, 1]
    distance = np.linalg.norm(apart, axis=1)
    unit = apart / np.where(distance > 1e-9, distance, np.inf)[:, None]
    static = np.array([robot.static for robot in reference.robots], dtype=np.bool_)
    columns = np.full((table.row.size, 6), -1)
    rows = np.zeros((table.row.size, 6))
    for k, (end, sign) in enumerate(((table.a, 1.0), (table.b, -1.0))):
        inside = end >= 0
        robot = np.maximum(end, 0)
        p = reference.ends[:, k] - centre
        for entry in range(3):
            present = inside & ((entry < 2) | ~static[robot])
            columns[present, 3 * k + entry] = first[robot[present]] + entry
        turned = unit[:, 1] * p[:, 0] - unit[:, 0] * p[:, 1]
        rows[:, 3 * k : 3 * k + 3] = sign * np.column_stack([unit, turned])
    return columns, rows / np.sqrt(table.weight_variance)[:, None]


@kernel
def add_information(Y: Floats, w: int, columns: Indices, rows: Floats, m: int) -> None:
    """Y[w] += row^T row in the columns of range m, in place."""
    for r in range(6):
        if columns[m, r] < 0:
            continue
        for c in range(6):
            if columns[m, c] >= 0:
                Y[w, columns[m, r], columns[m, c]] += rows[m, r] * rows[m, c]


@kernel
def lose_information(
    Y: Floats, w: int, X: int, gx: float, gy: float, gt: float, q: float, work: Floats
) -> None:
    """Noise of variance q along g = (gx, gy, gt) of the robot whose columns begin at X."""
    for r in range(work.size):
        work[r] = gx * Y[w, r, X] + gy * Y[w, r, X + 1] + gt * Y[w, r, X + 2]
    seen = gx * work[X] + gy * work[X + 1] + gt * work[X + 2]
    factor = q / (1.0 + q * seen)
    for r in range(work.size):
        share = factor * work[r]
        if share != 0.0:
            for c in range(work.size):
                Y[w, r, c] -= share * work[c]


@kernel
def window_information(
    Y: Floats, work: Floats, start: Indices, length: int, ranges_before: Indices,
    columns: Indices, rows: Floats, first: Indices, path: Floats, noise: Floats,
) -> None:  # fmt: skip
    """Information of windows of `length` steps from steps `start` on, added to Y (w, d, d).

    ranges_before (S + 1,): ranges before each step; path (n, S, 4): x, y, cos, sin at mid-step;
    work (d,) is scratch. The ranges of a step are taken at its end.
    """
    for w in range(start.size):
        for k in range(start[w], start[w] + length):
            for i in range(path.shape[0]):
                q_v, q_omega = noise[i, k, 0], noise[i, k, 1]
                x, y, c, s = path[i, k, 0], path[i, k, 1], path[i, k, 2], path[i, k, 3]
                if q_v > 0.0:
                    lose_information(Y, w, first[i], c, s, 0.0, q_v, work)
                if q_omega > 0.0:
                    lose_information(Y, w, first[i], y, -x, 1.0, q_omega, work)
            for m in range(ranges_before[k], ranges_before[k + 1]):
                add_information(Y, w, columns, rows, m)


def windows(reference: Reference, start: Indices, length: int, *, framed: bool) -> Floats:
    """Information about (dx, dy, dtheta) of the state at the end of each window, (w, d, d).

    framed: the first two static robots span the world, so that their coordinates are no question.
    """
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    columns, rows = range_rows(reference, centre)
    first, _ = columns_of(reference)
    edges = reference.begin + np.arange(reference.noise.shape[1] + 1) * (reference.dt * 1e9)
    before = np.searchsorted(reference.ranges.stamp, edges, side="right")
    middle = 0.5 * (reference.pose[:, 1:] + reference.pose[:, :-1])
    path = np.concatenate(
        [
            middle[:, :, :2] - centre,
            np.cos(middle[:, :, 2:]),
            np.sin(middle[:, :, 2:]),
        ],
        axis=2,
    )
    size = int(first[-1])
    Y = np.zeros((start.size, size, size))
    if framed:
        Y += frame_information(reference)
    window_information(
        Y, np.empty(size), start, length, before, columns, rows, first, path, reference.noise
    )
    return at_end(reference, Y, start + length, centre)


def at_end(reference: Reference, Y: Floats, step: Indices, centre: Floats) -> Floats:
    """From (e, dtheta) to (dp, dtheta) at the given steps: A^T Y A with e = dp - J p dtheta."""
    first, _ = columns_of(reference)
    A = np.tile(np.eye(Y.shape[1]), (Y.shape[0], 1, 1))
    for i, robot in enumerate(reference.robots):
        if not robot.static:
            p = reference.pose[i, step, :2] - centre
            A[:, first[i], first[i] + 2] = p[:, 1]
            A[:, first[i] + 1, first[i] + 2] = -p[:, 0]
    return np.asarray(A.transpose(0, 2, 1) @ Y @ A)


def frame_information(reference: Reference) -> Floats:
    """Prior (d, d) that fixes the first static robot and the second across the line of both."""
    first, _ = columns_of(reference)
    prior = np.zeros((int(first[-1]),) * 2)
    origin, other = [i for i, robot in enumerate(reference.robots) if robot.static][:2]
    axis = reference.pose[other, 0, :2] - reference.pose[origin, 0, :2]
    across = np.array([-axis[1], axis[0]]) / np.linalg.norm(axis)
    for i, direction in ((origin, np.eye(2)), (other, across[None])):
        block = slice(first[i], first[i] + 2)
        prior[block, block] += FIXED * direction.T @ direction
    return prior


def needs_compiling() -> bool:
    """Whether the first analysis in this installation has to compile the kernel (some seconds)."""
    cache = window_information.stats.cache_path  # type: ignore[attr-defined]
    name = window_information.py_func.__qualname__  # type: ignore[attr-defined]
    return cache is None or not any(Path(cache).glob(f"*{name}-*.nbi"))
