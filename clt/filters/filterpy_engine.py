"""The same filter through filterpy's ExtendedKalmanFilter: the cross-check, and the bar for speed.

An error-state filter with a vector-valued error is an EKF; both linearize all ranges of one
instant at the predicted state. Everything is written as a filterpy user would: full matrices,
one predict and one update per instant.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from clt.filters.eskf import REJECTED, USED, Run
from clt.filters.inputs import Outputs, RangeTable, Segments
from clt.filters.reacquisition import LOST, fresh_memory, remember
from clt.filters.reacquisition import reacquire as reacquire_robots
from clt.filters.unicycle import arc, process_noise
from clt.geometry import rotation, wrap
from clt.streams import Floats, Indices


class Motion:
    """Which twist segment each robot is in, and how far through it."""

    def __init__(self, segments: Segments, start: int, robots: int) -> None:
        self.segments = segments
        self.time = np.full(robots, start)
        self.cursor = segments.first[:-1].copy()
        self.shift = np.zeros((robots, 2))

    def step(
        self, x: Floats, i: int, until: int, form: int
    ) -> tuple[Floats, Floats, Floats] | None:
        """Next step of robot i towards `until`: mean change (3,), F (3, 3), Q (3, 3); or None."""
        s, k = self.segments, self.cursor[i]
        if self.time[i] >= until or k >= s.first[i + 1]:
            self.time[i] = max(self.time[i], until)
            return None
        stop = min(until, int(s.end[k]))
        dt = (stop - int(self.time[i])) * 1e-9
        dx, dy, c, sn = arc(x[3 * i + 2], s.v[k], s.omega[k], dt)
        xx, xy, yy, xt, yt, tt = process_noise(
            s.v[k], dt, c, sn, s.interval[k], s.var_v[k], s.var_omega[k], form
        )
        self.time[i] = stop
        if stop == s.end[k]:
            self.cursor[i] += 1
        fx, fy = dx + self.shift[i, 0], dy + self.shift[i, 1]
        self.shift[i] = 0.0
        F = np.array([[1.0, 0.0, -fy], [0.0, 1.0, fx], [0.0, 0.0, 1.0]])
        Q = np.array([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
        return np.array([dx, dy, s.omega[k] * dt]), F, Q


class TeamFilter(ExtendedKalmanFilter):  # type: ignore[misc]
    """filterpy's EKF with the team's motion as its prediction of the mean."""

    def __init__(self, mean: Floats, covariance: Floats) -> None:
        super().__init__(dim_x=mean.size, dim_z=1)
        self.x, self.P = mean.astype(np.float64).copy(), covariance.astype(np.float64).copy()
        self.change = np.zeros(mean.size)

    def predict_x(self, u: float = 0.0) -> None:  # noqa: ARG002 - filterpy's signature
        """Move the mean by the change that the odometry gives."""
        self.x = self.x + self.change

    def advance(self, motion: Motion, robots: Indices, until: int, form: int) -> None:
        """Predict until the given robots are at the time `until` (ns)."""
        while True:
            self.F, self.Q = np.eye(self.dim_x), np.zeros((self.dim_x, self.dim_x))
            self.change = np.zeros(self.dim_x)
            moved = False
            for i in robots:
                step = motion.step(self.x, i, until, form)
                if step is not None:
                    own = slice(3 * i, 3 * i + 3)
                    self.change[own], self.F[own, own], self.Q[own, own] = step
                    moved = True
            if not moved:
                return
            self.predict()


def end_points(x: Floats, lever: Floats, index: Indices, anchor: Floats) -> tuple[Floats, Floats]:
    """Antennas (m, 2) of one end of m ranges, and their derivative by heading (m, 2)."""
    pose = x.reshape(-1, 3)[np.maximum(index, 0)]
    arm = np.einsum("mij,mj->mi", rotation(pose[:, 2]), lever[np.maximum(index, 0)])
    free = (index >= 0)[:, None]
    turn = np.stack([-arm[:, 1], arm[:, 0]], axis=-1)
    return np.where(free, pose[:, :2] + arm, anchor), np.where(free, turn, 0.0)


def measurement(x: Floats, lever: Floats, ranges: RangeTable, rows: slice) -> tuple[Floats, Floats]:
    """H (m,) and H (m, N) of the ranges `rows` at the state x."""
    a, b = ranges.a[rows], ranges.b[rows]
    p, p_turn = end_points(x, lever, a, ranges.anchor[rows])
    q, q_turn = end_points(x, lever, b, ranges.anchor[rows])
    h = np.sqrt(np.sum((p - q) ** 2, axis=1))
    e = (p - q) / h[:, None]
    H = np.zeros((h.size, x.size))
    for index, turn, sign in ((a, p_turn, 1.0), (b, q_turn, -1.0)):
        m = np.flatnonzero(index >= 0)
        for k in range(2):
            H[m, 3 * index[m] + k] = sign * e[m, k]
        H[m, 3 * index[m] + 2] = sign * np.sum(e[m] * turn[m], axis=1)
    return h, H


def run(
    mean: Floats,
    covariance: Floats,
    start: int,
    lever: Floats,
    segments: Segments,
    ranges: RangeTable,
    outputs: Outputs,
    *,
    gate: float,
    reacquire: float,
    form: int,
    first: bool = False,
) -> Run:
    """The signature and the numbers of `clt.filters.eskf.run`."""
    ekf = TeamFilter(mean, covariance)
    n = mean.size // 3
    motion = Motion(segments, start, n)
    memory = fresh_memory(n, start)
    patience = int(reacquire * 1e9)
    out_mean, out_covariance = (
        np.empty((outputs.stamp.size, 3)),
        np.empty((outputs.stamp.size, 3, 3)),
    )
    residual, spread = np.empty(ranges.stamp.size), np.empty(ranges.stamp.size)
    verdict = np.zeros(ranges.stamp.size, np.int64)
    now = start
    for now in np.unique(np.append(ranges.stamp, outputs.stamp)):
        rows = slice(*np.searchsorted(ranges.stamp, [now, now + 1]))
        if rows.stop > rows.start:
            ends = np.append(ranges.a[rows], ranges.b[rows])
            ekf.advance(motion, np.unique(ends[ends >= 0]), int(now), form)
            before = ekf.x
            residual[rows], spread[rows], verdict[rows] = _update(
                ekf, lever, ranges, rows, memory, gate, patience
            )
            if first:
                motion.shift += (ekf.x - before).reshape(-1, 3)[:, :2]
        for o in range(*np.searchsorted(outputs.stamp, [now, now + 1])):
            own = slice(3 * outputs.robot[o], 3 * outputs.robot[o] + 3)
            ekf.advance(motion, outputs.robot[o : o + 1], int(now), form)
            out_mean[o], out_covariance[o] = ekf.x[own], ekf.P[own, own]
    ekf.advance(motion, np.arange(n), int(now), form)
    out_mean[:, 2] = wrap(out_mean[:, 2])
    return Run(out_mean, out_covariance, residual, spread, verdict, ekf.x, ekf.P, memory[:, LOST])


def _update(
    ekf: TeamFilter,
    lever: Floats,
    ranges: RangeTable,
    rows: slice,
    memory: Indices,
    gate: float,
    patience: int,
) -> tuple[Floats, Floats, Indices]:
    """Gate and fuse the ranges of one instant: residual, its variance and verdict per range."""
    h, H = measurement(ekf.x, lever, ranges, rows)
    r = ranges.range[rows] - h
    whole = np.zeros(ranges.stamp.size)
    whole[rows] = r
    S = np.einsum("mi,ij,mj->m", H, ekf.P, H) + ranges.variance[rows]
    now = ranges.stamp[rows.start]
    if reacquire_robots(
        ekf.P, ranges.a, ranges.b, whole, rows.start, rows.stop, now, memory, patience
    ):
        S = np.einsum("mi,ij,mj->m", H, ekf.P, H) + ranges.variance[rows]
    inside = (r * r <= gate * S) | (gate <= 0.0)
    for a, b, used in zip(ranges.a[rows], ranges.b[rows], inside, strict=True):
        remember(a, b, used, memory)
        remember(b, a, used, memory)
    use = np.flatnonzero(inside)
    if use.size > 0:
        ekf.dim_z = use.size
        R = np.diag(ranges.weight_variance[rows][use])
        ekf.update(ranges.range[rows][use], lambda _: H[use], lambda _: h[use], R=R)
    return r, S, np.where(inside, USED, REJECTED)
