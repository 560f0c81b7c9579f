"""From a log of raw packets to one of ranges and odometry, and what was learnt on the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.errors import CltError
from clt.core.recording import Ranges, Recording, Team, UwbPackets, no_uwb_packets
from clt.core.ticks import RADIO_SPEED
from clt.ranging import clock, double_sided
from clt.ranging.measured import MeasuredRanges
from clt.ranging.noise import equivalent_correlation_time, packet_period, stamp_variance
from clt.ranging.odometry import odometry_from_packets
from clt.ranging.smooth import smooth_ranges
from clt.ranging.states import MOTION_SHARE, SKEW_WALK
from clt.ranging.timebase import departure_times, listener_times
from clt.ranging.unwrap import LinkedPackets, unwrap_packets

RangingMethod = Literal["auto", "clock", "double-sided"]
RANGING_METHODS: tuple[RangingMethod, ...] = ("auto", "clock", "double-sided")
MAX_CLOCK_SIGMA_SHARE = 0.9
"""Clock filters are chosen where their sigma is below this share of double-sided ranging's."""
RANGE_RESOLUTION_M = 2.0**-17
"""8 um; a tick is 5 mm."""
TRIAL_PACKETS = 20_000
"""Packets on which both methods are tried."""
MAX_CORRELATION_TIME_S = 3600.0
"""No error of a clock filter lives longer, s."""
PERCENTILE_VALUES = 2000
"""Values from which percentiles are taken."""
COMMON_CLOCK = "the listener's clock, each robot's by regression"


@dataclass(frozen=True)
class PairClock:
    """What is known of the clocks of one pair a < b."""

    ranges: int
    rejected: int
    """Packets that the pair's filters, or jumps of a clock, rejected."""
    offset: float
    """C_a - C_b of the unwrapped 40-bit counters at the last range, s."""
    skew: float
    """Rate of a's clock over b's minus 1: median over the log."""
    skew_range: tuple[float, float]
    """The 5th and 95th percentile of it."""
    stamp_sigma: float
    """Noise of a receive stamp, mean of both ways, s."""
    sigma: float
    """Of a range, median, m."""


@dataclass(frozen=True)
class RangedRecording:
    """A recording with ranges and odometry in place of packets."""

    recording: Recording
    method: Literal["clock", "double-sided"]
    why: str
    """Of the method, for people."""
    rate: float
    """Frames per second."""
    correlation_time: float
    """Of the errors of one pair's ranges, s."""
    clocks: Mapping[tuple[str, str], PairClock]


def range_packets(
    recording: Recording,
    method: RangingMethod = "auto",
    length: int = 1,
    sigma: float | None = None,
) -> RangedRecording:
    """Range a recording of packets.

    `length` > 1 smooths as Shi does; `sigma` is the noise of a receive stamp (s) where it is
    known, by default it is measured. Odometry that the recording has on topics stays.
    Raises CltError for a recording without packets, or whose packets give no range.
    """
    frames, team = recording.frames, recording.team
    if frames.stamp.size == 0:
        raise CltError("no UWB packets found on /ROBOT/uwb/frame; nothing to range")
    if len(team.robots) < 2:
        raise CltError(f"UWB packets of {team.names[0]} alone: nobody to range with")
    network = unwrap_packets(frames)
    R = stamp_variance(network, sigma)
    dt = packet_period(network, frames.stamp)
    chosen, measured, rejected, why = _choose(network, R, _wander(team), method, dt)
    if measured.row.size == 0:
        raise CltError(
            f"{frames.stamp.size} UWB packets give no range: no two robots heard each other's "
            "packets in turn"
        )
    times = departure_times(frames.source, network.sent, frames.stamp)
    ranges = _ranges(frames, network, measured, times)
    tau = _correlation_time(R, measured, dt) if chosen == "clock" else 0.0
    if length > 1:
        ranges, tau = smooth_ranges(ranges, len(team.robots), length, tau)
    carried = {
        robot.name: odometry_from_packets(frames, network, times, index)
        for index, robot in enumerate(team.robots)
    }
    known = {name: stream for name, stream in carried.items() if stream is not None}
    return RangedRecording(
        replace(
            recording,
            team=replace(team, range_correlation=min(tau, MAX_CORRELATION_TIME_S)),
            odometry={**known, **recording.odometry},
            ranges=ranges,
            frames=no_uwb_packets(),
        ),
        chosen,
        why,
        1.0 / dt,
        tau,
        _clocks(team.names, measured, rejected, R),
    )


def _choose(
    network: LinkedPackets, R: Floats, wander: Floats, method: RangingMethod, dt: float
) -> tuple[Literal["clock", "double-sided"], MeasuredRanges, Indices, str]:
    """Range by the method asked for, else by the one whose ranges are surer."""
    if method == "clock":
        return "clock", *clock.range_by_clock_filters(network, R), "as asked"
    if method == "double-sided":
        return "double-sided", *double_sided.range_double_sided(network, R, wander), "as asked"
    head = LinkedPackets(*(column[:TRIAL_PACKETS] for column in network))
    filters, both = (
        clock.range_by_clock_filters(head, R)[0],
        double_sided.range_double_sided(head, R, wander)[0],
    )
    one, two = _typical(filters.sigma), _typical(both.sigma)
    reason = (
        f"at {1.0 / dt:.3g} frames/s clock filters promise {100 * one:.2g} cm, "
        f"double-sided ranging {100 * two:.2g} cm"
    )
    if one < MAX_CLOCK_SIGMA_SHARE * two:
        return "clock", *clock.range_by_clock_filters(network, R), reason
    if one < two:
        reason += ", whose errors do not correlate in time"
    return "double-sided", *double_sided.range_double_sided(network, R, wander), reason


def _wander(team: Team) -> Floats:
    """Random walk of the rate of each pair's time of flight, 1/s; robots that stand have none."""
    static = np.array([robot.static for robot in team.robots])
    return np.where(static[:, None] & static, 0.0, MOTION_SHARE * SKEW_WALK)


def _typical(sigma: Floats) -> float:
    return float(np.median(sigma)) if sigma.size > 0 else np.inf


def _ranges(
    frames: UwbPackets, network: LinkedPackets, found: MeasuredRanges, times: Stamps
) -> Ranges:
    """Columns sorted by stamp; a robot counts its packets times its partners."""
    stamp = listener_times(times[found.packet], network.sent[found.packet], found.instant)
    partners = network.row.shape[1] - 1 - found.source
    sequence = frames.sequence[found.packet] * partners + (found.target - found.source - 1)
    order = np.argsort(stamp, kind="stable")
    value, sigma = _rounded(found.range[order]), _rounded(found.sigma[order])
    return Ranges(
        stamp[order],
        frames.log_time[found.row[order]],
        found.source[order],
        found.target[order],
        value,
        value,
        sigma,
        sequence[order],
    )


def _rounded(length: Floats) -> Floats:
    """To RANGE_RESOLUTION_M: digits that mean nothing are zeros, which take no room in a log."""
    return np.asarray(np.rint(length / RANGE_RESOLUTION_M) * RANGE_RESOLUTION_M)


def _correlation_time(R: Floats, found: MeasuredRanges, dt: float) -> float:
    """Of the errors that filters leave, median over the ranges, s."""
    a, b = found.source, found.target
    white = RADIO_SPEED**2 * 0.25 * (R[a, b] + R[b, a])
    return equivalent_correlation_time(1.0, float(np.median(found.sigma**2 / white)), dt)


def _clocks(
    names: tuple[str, ...], found: MeasuredRanges, rejected: Indices, R: Floats
) -> dict[tuple[str, str], PairClock]:
    """Clock parameters of every pair that has ranges."""
    clocks = {}
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            own = np.flatnonzero((found.source == a) & (found.target == b))
            if own.size == 0:
                continue
            skew = found.skew[own[:: 1 + own.size // PERCENTILE_VALUES]]
            low, middle, high = (float(value) for value in np.percentile(skew, [5, 50, 95]))
            clocks[names[a], names[b]] = PairClock(
                int(own.size),
                int(rejected[a, b] + rejected[b, a]),
                float(found.offset[own[-1]]),
                middle,
                (low, high),
                float(np.sqrt((R[a, b] + R[b, a]) / 2.0)),
                float(np.median(found.sigma[own])),
            )
    return clocks
