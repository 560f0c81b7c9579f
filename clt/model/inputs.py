"""Streams into what the kernels eat: twist segments per robot and one table of ranges.

A segment is a span of time over which a robot's twist is taken as constant, with the variance of
that twist and the interval over which this error stays the same (so that it adds
variance * interval * dt to the integral over dt).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Floats, Indices, Odometry, Ranges, Robot, Stamps, Team
from clt.model.settings import MAX_SETTING, NoiseSettings

MIN_GAP_PERIODS, MAX_GAP_PERIODS = 1.5, 3.0
"""A step of more median periods than this is a gap in odometry of even, of very uneven steps."""
GAP_CORRELATION_S = 1.0
"""Seconds over which an unseen twist keeps its value."""
DEFAULT_SIGMA_V, DEFAULT_SIGMA_OMEGA, DEFAULT_SIGMA_RANGE = 0.1, 0.1, 0.1
"""Assumed, and said, where neither the log nor the user tells. m/s, rad/s, m."""
MIN_SIGMA_V, MIN_SIGMA_OMEGA, MIN_SIGMA_RANGE = 1e-5, 1e-5, 1e-4
"""No sensor is believed beyond this, not even one that claims to be perfect; none is worse than
MAX_SETTING, whose square still leaves digits."""


class TwistSegments(NamedTuple):
    """Twist segments of all robots one after another; robot i owns first[i] .. first[i + 1]."""

    first: Indices
    end: Stamps
    """ns; a segment begins where the one before it ended."""
    v: Floats
    omega: Floats
    interval: Floats
    """s."""
    var_v: Floats
    var_omega: Floats


class Outputs(NamedTuple):
    """When which block is wanted: rows sorted by stamp."""

    stamp: Stamps
    robot: Indices
    """The block."""


class RangeTable(NamedTuple):
    """Ranges to fuse, sorted by stamp; ends are state indices, or -1 - k for the fixed robot k."""

    row: Indices
    """Row of `Ranges` that each came from."""
    stamp: Stamps
    a: Indices
    b: Indices
    anchor: Floats
    """Position of the fixed end, shape (n, 2), m; unused where both ends are in the state."""
    range: Floats
    variance: Floats
    """Of one range, m^2: what the gate tests against."""
    weight_variance: Floats
    """What the update uses: larger where errors are correlated in time."""


def first_known(*choices: Floats | float | None, size: int) -> Floats:
    """Element by element the first choice that is neither None nor NaN; NaN if none is."""
    result = np.full(size, np.nan)
    for choice in choices:
        if choice is not None:
            result = np.where(np.isnan(result), choice, result)
    return result


def interval_twist(odometry: Odometry, robot: Robot) -> tuple[Floats, Floats]:
    """Twist (v, omega) as means over the interval that ends at each stamp.

    Instants are averaged with the one before (midpoint rule of Shi, section "ESKF propagation"),
    but not across a gap.
    """
    v, omega = odometry.v, odometry.omega
    if robot.twist == "instant":
        near = ~odometry_gaps(odometry.stamp)[1:]
        v = np.append(v[:1], np.where(near, 0.5 * (v[1:] + v[:-1]), v[1:]))
        omega = np.append(omega[:1], np.where(near, 0.5 * (omega[1:] + omega[:-1]), omega[1:]))
    return v, omega


def odometry_gaps(stamp: Stamps) -> NDArray[np.bool_]:
    """Whether a gap lies before each sample, shape (n,).

    A step beyond the median by five standard deviations of the steps (from their median
    deviation), within MIN_GAP_PERIODS to MAX_GAP_PERIODS periods: uneven steps are not gaps.
    """
    step = np.diff(stamp)
    limit = gap_limit(step) if step.size > 0 else 0.0
    return np.append(np.zeros(min(stamp.size, 1), np.bool_), step > limit)


def gap_limit(step: Stamps) -> float:
    """Longest of some steps (n,), n > 0, that is no gap, in their unit."""
    period = float(np.median(step))
    spread = 1.4826 * float(np.median(np.abs(step - period)))
    return float(np.clip(period + 5.0 * spread, MIN_GAP_PERIODS * period, MAX_GAP_PERIODS * period))


def odometry_variances(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> tuple[Floats, Floats, tuple[Diagnostic, ...]]:
    """Variances of v and of omega of each sample (n,), and what had to be assumed."""
    sigma_v, sigma_w, notes = odometry_sigmas(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    return *twist_variance(v, omega, sigma_v, sigma_w, noise), notes


def odometry_sigmas(
    odometry: Odometry, robot: Robot, noise: NoiseSettings
) -> tuple[Floats, Floats, tuple[Diagnostic, ...]]:
    """Standard deviations of v and of omega of each sample (n,), and what had to be assumed."""
    size = odometry.stamp.size
    sigma_v = first_known(noise.sigma_v, odometry.sigma_v, robot.sigma_v, size=size)
    sigma_w = first_known(noise.sigma_omega, odometry.sigma_omega, robot.sigma_omega, size=size)
    notes: tuple[Diagnostic, ...] = ()
    if np.isnan(sigma_v).any() or np.isnan(sigma_w).any():
        assumed = {"sigma_v": DEFAULT_SIGMA_V, "sigma_omega": DEFAULT_SIGMA_OMEGA}
        notes = (Diagnostic("odometry_noise_assumed", robot.name, values=assumed),)
        sigma_v = np.where(np.isnan(sigma_v), DEFAULT_SIGMA_V, sigma_v)
        sigma_w = np.where(np.isnan(sigma_w), DEFAULT_SIGMA_OMEGA, sigma_w)
    sigma_v = np.clip(sigma_v, MIN_SIGMA_V, MAX_SETTING)
    return sigma_v, np.clip(sigma_w, MIN_SIGMA_OMEGA, MAX_SETTING), notes


def twist_variance(
    v: Floats, omega: Floats, sigma_v: Floats, sigma_w: Floats, noise: NoiseSettings
) -> tuple[Floats, Floats]:
    """Variances of v and of omega of samples (n,): their own noise and that of moving."""
    var_v = sigma_v**2 + (noise.v_per_v * v) ** 2 + (noise.v_per_omega * omega) ** 2
    var_w = sigma_w**2 + (noise.omega_per_v * v) ** 2 + (noise.omega_per_omega * omega) ** 2
    return var_v, var_w


def gap_twist_variance(values: Floats, variance: Floats, lags: Indices) -> Floats:
    """Variance of a twist that was not measured for `lags` periods, one per gap.

    Half of how much the twist changes over so long; to this comes the noise of the two neighbours'
    mean, which adds to the neighbours' own: of m periods (1 + m / 2)^2 each.
    """
    noise = float(np.mean(variance))
    return 0.5 * structure_function(values, noise, lags) + noise * (0.5 + 2.0 / lags)


def structure_function(values: Floats, noise: float, lags: Indices) -> Floats:
    """Structure function D(l) = E (w(t + l) - w(t))^2 of a twist over `lags` periods, (L,).

    From measured values (n,) with white noise of variance `noise`; beyond n periods twice their
    variance.
    """
    result = np.full(lags.size, 2.0 * float(np.var(values)))
    for lag in np.unique(lags[lags < values.size]):
        measured = float(np.mean((values[lag:] - values[:-lag]) ** 2))
        result[lags == lag] = max(measured - 2.0 * noise, 0.0)
    return result


def robot_segments(
    odometry: Odometry, robot: Robot, noise: NoiseSettings, start: int, end: int
) -> tuple[TwistSegments, tuple[Diagnostic, ...]]:
    """Segments of one robot from `start` to `end` (ns), and what had to be assumed.

    A gap is bridged with the mean of the samples around it and an error as large as the twist
    changes over so long; so is the time after the last sample, with the last twist.
    """
    var_v, var_w, said = odometry_variances(odometry, robot, noise)
    v, omega = interval_twist(odometry, robot)
    stamp, size = odometry.stamp, odometry.stamp.size
    period = max(int(np.median(np.diff(stamp))), 1) if size > 1 else 0
    gap = odometry_gaps(stamp)
    begin = np.append(stamp[0] - period, stamp[:-1])
    begin = np.where(gap, stamp - period, begin)
    holes = np.flatnonzero(gap)
    late = end > int(stamp[-1])
    ends = np.concatenate([stamp, begin[holes], np.array([end] * late, np.int64)])
    before = np.concatenate([begin, stamp[holes - 1], stamp[-1:] if late else stamp[:0]])
    seconds = (ends - before) * 1e-9
    lags = np.maximum(np.rint((ends - before)[size:] / max(period, 1)).astype(np.int64), 1)
    bridge_v = 0.5 * (v[holes - 1] + v[holes])
    bridge_w = 0.5 * (omega[holes - 1] + omega[holes])
    order = np.argsort(ends, kind="stable")
    order = order[ends[order] > start]
    interval = np.append(seconds[:size], np.minimum(seconds[size:], GAP_CORRELATION_S))
    segments = TwistSegments(
        np.array([0, order.size]),
        ends[order],
        np.concatenate([v, bridge_v, v[-1:] if late else []])[order],
        np.concatenate([omega, bridge_w, omega[-1:] if late else []])[order],
        interval[order],
        np.append(var_v, gap_twist_variance(v, var_v, lags))[order],
        np.append(var_w, gap_twist_variance(omega, var_w, lags))[order],
    )
    inside = holes[stamp[holes] > start]
    if inside.size > 0:
        longest = float(np.max(stamp[inside] - stamp[inside - 1])) * 1e-9
        gaps = {"count": int(inside.size), "longest_s": longest}
        return segments, (*said, Diagnostic("odometry_gaps", robot.name, values=gaps))
    return segments, said


def join_segments(parts: Sequence[TwistSegments]) -> TwistSegments:
    """Segments of several robots behind one another."""
    counts = [part.end.size for part in parts]
    return TwistSegments(
        np.cumsum([0, *counts]),
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("end", "v", "omega", "interval", "var_v", "var_omega")
        ),
    )


def no_segments() -> TwistSegments:
    """No segments: a robot whose pose does not change."""
    none = np.empty(0)
    return TwistSegments(np.zeros(2, np.int64), np.empty(0, np.int64), none, none, none, none, none)


def range_correlation_time(noise: NoiseSettings, team: Team) -> float:
    """Of the range error of one pair, s: as the user says, else as the log tells."""
    told = noise.correlation_time
    return min(team.range_correlation, MAX_SETTING) if told is None else told


def inflated_variances(variance: Floats, stamp: Stamps, pair: Indices, tau: float) -> Floats:
    """Variance to give each range so that a white-noise filter does not believe a pair too much.

    An AR(1) error of correlation time tau (s), rho = exp(-dt / tau), carries, over many samples,
    the information of white noise with variance sigma^2 (1 + rho) / (1 - rho).
    """
    if tau <= 0.0 or stamp.size == 0:
        return variance
    order = np.lexsort((stamp, pair))
    dt = np.diff(stamp[order]) * 1e-9
    same = np.diff(pair[order]) == 0
    rho = np.zeros(stamp.size)
    # Equal stamps of one pair: as close as a nanosecond, not infinitely correlated.
    rho[1:] = np.where(same, np.exp(-np.maximum(dt, 1e-9) / tau), 0.0)
    first = np.append(True, ~same)
    following = np.append(rho[1:], 0.0)
    rho = np.where(first, following, rho)
    result = np.empty_like(variance)
    result[order] = variance[order] * (1.0 + rho) / (1.0 - rho)
    return result


def range_table(
    ranges: Ranges,
    team: Team,
    state: dict[int, int],
    anchors: dict[int, Floats],
    noise: NoiseSettings,
    start: int,
    end: int,
) -> tuple[RangeTable, tuple[Diagnostic, ...]]:
    """The ranges between start and end (ns) that touch the state and have both ends placed.

    `state` maps team indices to state indices, `anchors` to fixed positions.
    """
    size = len(team.robots)
    where = -1 - np.arange(size)
    placed = np.zeros(size, np.bool_)
    placed[[*state, *anchors]] = True
    place = np.zeros((size, 2))
    for robot, index in state.items():
        where[robot] = index
    for robot, position in anchors.items():
        place[robot] = position
    source, target = where[ranges.source], where[ranges.target]
    use = placed[ranges.source] & placed[ranges.target] & (np.maximum(source, target) >= 0)
    use &= (ranges.stamp > start) & (ranges.stamp <= end)
    row = np.flatnonzero(use)
    notes: list[Diagnostic] = []
    sigma = first_known(noise.sigma_range, ranges.sigma[row], team.range_sigma, size=row.size)
    if np.isnan(sigma).any():
        notes.append(Diagnostic("range_noise_assumed", values={"sigma_m": DEFAULT_SIGMA_RANGE}))
        sigma = np.where(np.isnan(sigma), DEFAULT_SIGMA_RANGE, sigma)
    variance = np.clip(sigma, MIN_SIGMA_RANGE, MAX_SETTING) ** 2
    low = np.minimum(ranges.source[row], ranges.target[row])
    high = np.maximum(ranges.source[row], ranges.target[row])
    fixed = np.where(source[row] < 0, ranges.source[row], ranges.target[row])
    table = RangeTable(
        row,
        ranges.stamp[row],
        source[row],
        target[row],
        np.ascontiguousarray(place[fixed]),
        ranges.range[row],
        variance,
        inflated_variances(
            variance, ranges.stamp[row], low * size + high, range_correlation_time(noise, team)
        ),
    )
    return table, tuple(notes)
