"""The offset between the clock of a reference and that of the estimates, from how both move.

Speeds and turn rates need no common frame. Their normalized cross-correlation over all robots and
all offsets at which the two overlap gives the offset to a fraction of a grid step; the offset that
leaves the smallest distance between both after the best rigid motion gives the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import NS_PER_SECOND, Floats, Stamps
from clt.core.errors import CltError
from clt.core.recording import Poses
from clt.metrics.align import rms_residual
from clt.metrics.associate import associate
from clt.metrics.reference import shift_poses
from clt.metrics.tracks import select_poses

GRID_S = 0.05
"""Step of the first search, s."""
MAX_GRID_POINTS = 1 << 18
"""Longer tracks are searched in larger steps."""
MIN_WINDOW_S, WINDOW_PERIODS = 0.5, 2.0
"""Motion is measured over so many seconds, and so many periods of the track."""
MIN_OVERLAP = 0.5
"""Share of the shorter track that both have to cover."""
MIN_CORRELATION = 0.5
"""Below it the motions are not alike."""
MAX_RIVAL_SHARE = 0.9
"""Another offset whose correlation has this share of the highest is as good."""
REFINED_STEPS = 20
"""Of the golden section that ends the search."""
MAX_REFINED_POSES = 4000
"""Poses of one reference that it compares."""
GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0


class TimeOffset(NamedTuple):
    """What is added to the stamps of a reference."""

    nanoseconds: int
    correlation: float
    """Of speeds and turn rates there, at most 1."""


class MotionSignal(NamedTuple):
    """Speed (m/s) or turn rate (rad/s) on a grid, zero mean; 0 where it is not known."""

    value: Floats
    known: Floats
    """1 where it is known, else 0."""


def estimate_time_offset(
    truth: Mapping[str, Poses],
    tracks: Mapping[str, Poses],
    motion: Mapping[str, Poses],
) -> TimeOffset:
    """The offset at which the truth moves as the tracks (estimates in one frame) do.

    `motion` holds smoother tracks of the same clock, dead reckoning, by which the first search goes
    where they have a robot. Raises CltError where no robot moves in both, where nothing
    is alike, or where several offsets fit as well.
    """
    names = [name for name in tracks if name in truth and len(tracks[name].stamp) > 2]
    names = [name for name in names if len(truth[name].stamp) > 2]
    if len(names) == 0:
        raise CltError("no robot has both truth and estimates, so no time offset can be found")
    smooth = {name: motion.get(name, tracks[name]) for name in names}
    first = [min(int(held[name].stamp[0]) for name in names) for held in (truth, smooth)]
    last = [max(int(held[name].stamp[-1]) for name in names) for held in (truth, smooth)]
    longest = max(last[0] - first[0], last[1] - first[1])
    step = max(round(GRID_S * NS_PER_SECOND), -(-longest // MAX_GRID_POINTS))
    pairs = [
        signals
        for name in names
        for signals in zip(
            _signals(truth[name], first[0], last[0], step),
            _signals(smooth[name], first[1], last[1], step),
            strict=True,
        )
    ]
    lag, correlation = _best_lag(pairs, step)
    coarse = first[1] - first[0] + round(lag * step)
    refined = _refine({name: truth[name] for name in names}, tracks, coarse, step)
    return TimeOffset(refined, correlation)


def _signals(poses: Poses, first: int, last: int, step: int) -> tuple[MotionSignal, MotionSignal]:
    """Speed and turn rate on the grid from `first` to `last` (ns)."""
    grid = np.arange(first, last + step, step)
    period = float(np.median(np.diff(poses.stamp)))
    half = round(max(MIN_WINDOW_S * NS_PER_SECOND, WINDOW_PERIODS * period) / 2)
    known = _covered(poses.stamp, grid - half, grid + half, 2 * half)
    before, after = (grid - half - first) * 1e-9, (grid + half - first) * 1e-9
    t = (poses.stamp - first) * 1e-9
    x, y = (np.interp(after, t, c) - np.interp(before, t, c) for c in (poses.x, poses.y))
    speed = np.hypot(x, y) / (2e-9 * half)
    has_heading = bool(np.all(np.isfinite(poses.heading)))
    heading = np.unwrap(poses.heading) if has_heading else np.zeros(len(t))
    turn = (np.interp(after, t, heading) - np.interp(before, t, heading)) / (2e-9 * half)
    return _centred(speed, known), _centred(turn, known & has_heading)


def _covered(stamp: Stamps, begin: Stamps, end: Stamps, longest: int) -> NDArray[np.bool_]:
    """Whether no gap beyond `longest` (ns) touches [begin, end], and samples lie on both sides."""
    inside = (begin >= stamp[0]) & (end <= stamp[-1])
    gaps = np.append(0, np.cumsum(np.diff(stamp) > longest))
    low = np.searchsorted(stamp, begin, side="right") - 1
    high = np.searchsorted(stamp, end, side="left")
    limit = len(stamp) - 1
    covered: NDArray[np.bool_] = inside & (
        gaps[np.clip(low, 0, limit)] == gaps[np.clip(high, 0, limit)]
    )
    return covered


def _centred(value: Floats, known: NDArray[np.bool_]) -> MotionSignal:
    weight = known.astype(np.float64)
    mean = float(np.sum(value * weight) / max(np.sum(weight), 1.0))
    centred = (value - mean) * weight
    scale = float(np.sqrt(np.sum(centred**2) / max(np.sum(weight), 1.0)))
    return MotionSignal(centred / scale if scale > 1e-6 else 0.0 * centred, weight)


def _best_lag(pairs: Sequence[tuple[MotionSignal, MotionSignal]], step: int) -> tuple[float, float]:
    """The lag of the tracks' grid behind the truth's, in steps, and its correlation."""
    size = len(pairs[0][0].value) + len(pairs[0][1].value)
    product, a_square, b_square, both = (np.zeros(size) for _ in range(4))
    for a, b in pairs:
        if not (a.value.any() and b.value.any()):
            continue  # what stands still, or a heading that is not known, shows nothing
        product += _correlate(b.value, a.value, size)
        a_square += _correlate(b.known, a.value**2, size)
        b_square += _correlate(b.value**2, a.known, size)
        both += _correlate(b.known, a.known, size)
    if not both.any():
        raise CltError("no robot moves in both truth and estimates: no time offset can be found")
    enough = both > MIN_OVERLAP * float(both.max())
    scale = np.sqrt(np.maximum(a_square, 0.0) * np.maximum(b_square, 0.0))
    correlation = np.where(enough & (scale > 1e-9), product / np.maximum(scale, 1e-9), -1.0)
    lags = np.arange(size)
    lags = np.where(lags < len(pairs[0][1].value), lags, lags - size)
    order = np.argsort(lags)
    lags, correlation = lags[order], correlation[order]
    best = int(np.argmax(correlation))
    highest = float(correlation[best])
    if highest < MIN_CORRELATION:
        raise CltError(
            "truth and estimates do not move alike at any time offset (highest correlation "
            f"{highest:.2f}): give --truth-offset in seconds"
        )
    rival = _rival(correlation, best)
    if rival is not None:
        other = (lags[rival] - lags[best]) * step * 1e-9
        raise CltError(
            f"another time offset, {other:+.2f} s from the best, fits as well (correlations "
            f"{correlation[rival]:.2f} and {highest:.2f}): give --truth-offset in seconds"
        )
    return float(lags[best]) + _vertex(correlation, best), highest


def _correlate(b: Floats, a: Floats, size: int) -> Floats:
    """Sum over k of b[k + lag] a[k], for lags from 0 on, negative ones at the end, (size,)."""
    spectrum = np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size))
    return np.fft.irfft(spectrum, size)


def _rival(correlation: Floats, best: int) -> int | None:
    """The highest correlation outside the lobe of the best, where it is about as high."""
    low = high = best
    floor = 0.5 * correlation[best]
    while low > 0 and correlation[low] > floor:
        low -= 1
    while high < len(correlation) - 1 and correlation[high] > floor:
        high += 1
    outside = correlation.copy()
    outside[low : high + 1] = -1.0
    rival = int(np.argmax(outside))
    return rival if outside[rival] > MAX_RIVAL_SHARE * correlation[best] else None


def _vertex(correlation: Floats, best: int) -> float:
    """Where the parabola through the best and its neighbours is highest, in steps from the best."""
    if not 0 < best < len(correlation) - 1:
        return 0.0
    left, middle, right = correlation[best - 1 : best + 2].tolist()
    bend = left - 2.0 * middle + right
    return 0.0 if bend >= 0.0 or min(left, right) < 0.0 else 0.5 * (left - right) / bend


def _refine(
    truth: Mapping[str, Poses],
    tracks: Mapping[str, Poses],
    coarse: int,
    step: int,
) -> int:
    """The offset (ns) near `coarse` that leaves the smallest distance after a rigid motion."""
    few = {name: _thinned(poses) for name, poses in truth.items()}

    def left(offset: float) -> float:
        matched = [
            associate(shift_poses(poses, round(offset)), tracks[name])
            for name, poses in few.items()
        ]
        source = np.concatenate([one.estimate[:, :2] for one in matched])
        target = np.concatenate([one.truth[:, :2] for one in matched])
        return rms_residual(source, target)

    low, high = coarse - 4.0 * step, coarse + 4.0 * step
    inner = [high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    try:
        value = [left(offset) for offset in inner]
        for _ in range(REFINED_STEPS):
            if value[0] <= value[1]:
                high, inner[1], value[1] = inner[1], inner[0], value[0]
                inner[0] = high - GOLDEN * (high - low)
                value[0] = left(inner[0])
            else:
                low, inner[0], value[0] = inner[0], inner[1], value[1]
                inner[1] = low + GOLDEN * (high - low)
                value[1] = left(inner[1])
    except CltError:  # nothing matches, or one place only: the correlation has to do
        return coarse
    return round(0.5 * (low + high))


def _thinned(poses: Poses) -> Poses:
    """Evenly chosen poses, not more than are compared."""
    every = -(-len(poses.stamp) // MAX_REFINED_POSES)
    keep = np.arange(len(poses.stamp)) % every == 0
    return select_poses(replace(poses, covariance=None), keep)
