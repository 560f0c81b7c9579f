"""Motion over given intervals as odometry without gaps.

clt takes an odometry sample as the mean twist over the interval that ends at its stamp, and a
sample that is much longer than its neighbours as one behind a gap. A data set that says what
happened over a long interval is not such a gap: the interval is cut into samples of the usual
length, which together make the same motion with the same variance.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.geometry import wrap_angle
from clt.core.recording import Odometry

MAX_WHOLE_PERIODS = 1.4
"""A longer interval, in median ones, is cut; `clt.model.odometry_gaps` takes 1.5 as a gap."""
MAX_PARTS = 10_000
"""Samples that one interval becomes at most."""
NEGLIGIBLE_SIDEWAYS = 0.1
"""A step sideways below this share of its standard deviation is left out."""
MAX_NEGLIGIBLE_SIDEWAYS = 1e-3
"""The same where no standard deviation is known, m."""


class TwistIntervals(NamedTuple):
    """Constant twists, one after another, shape (n,)."""

    begin: Stamps
    end: Stamps
    """Later than `begin`, ns."""
    v: Floats
    """m/s."""
    omega: Floats
    """rad/s."""
    variance_distance: Floats
    """Of the way over the whole interval, m^2; NaN unknown."""
    variance_turn: Floats
    """Of the turn over the whole interval, rad^2; NaN unknown."""


class RelativePoses(NamedTuple):
    """Poses of a body at `end` in its frame at `begin`, shape (n,)."""

    begin: Stamps
    end: Stamps
    x: Floats
    y: Floats
    turn: Floats
    """rad, any whole number of turns off."""
    variance_x: Floats
    """Forward, m^2; NaN unknown."""
    variance_y: Floats
    variance_turn: Floats
    """rad^2."""


def intervals_to_odometry(given: TwistIntervals) -> tuple[Odometry, int]:
    """Samples at the ends of the intervals, long ones cut; how many were cut.

    `given` is sorted and does not overlap. An interval that would need more than MAX_PARTS samples
    stays whole: a gap.
    """
    length = given.end - given.begin
    period = float(np.median(length))
    cut = (length > MAX_WHOLE_PERIODS * period) & (length <= MAX_PARTS * period)
    parts = np.where(cut, np.ceil(length / period), 1).astype(np.int64)
    row = np.repeat(np.arange(len(length)), parts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    stamp = given.begin[row] + length[row] * place // parts[row]
    # The variances of equal parts add up to that of the whole.
    scale = np.sqrt(parts) / (length * 1e-9)
    sigma_v = np.sqrt(given.variance_distance) * scale
    sigma_omega = np.sqrt(given.variance_turn) * scale
    columns = (given.v[row], given.omega[row], sigma_v[row], sigma_omega[row])
    return Odometry(stamp, stamp, *columns), int(np.count_nonzero(cut))


def relative_poses_to_intervals(given: RelativePoses) -> tuple[TwistIntervals, int]:
    """Steps as arcs; how many needed more than an arc.

    An arc of turn `t` ends in the direction `t / 2`. A step that ends elsewhere, by more than a
    negligible way sideways, is a turn on the spot, an arc and a turn back: the same relative pose.
    """
    turn = wrap_angle(given.turn)
    way = np.hypot(given.x, given.y)
    aside = np.where(way > 0.0, wrap_angle(np.arctan2(given.y, given.x) - turn / 2), 0.0)
    back = np.abs(aside) > np.pi / 2
    aside = np.where(back, wrap_angle(aside + np.pi), aside)
    chord = np.where(back, -way, way)
    limit = NEGLIGIBLE_SIDEWAYS * np.sqrt(given.variance_y)
    limit = np.where(np.isfinite(limit) & (limit > 0.0), limit, MAX_NEGLIGIBLE_SIDEWAYS)
    bent = np.abs(chord * np.sin(aside)) > limit
    chord = np.where(bent, chord, chord * np.cos(aside))
    pieces = np.where(bent, 3, 1)
    row = np.repeat(np.arange(len(turn)), pieces)
    place = np.arange(len(row)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    begin, end = _piece_times(given, bent[row], row, place)
    seconds = (end - begin) * 1e-9
    spot = bent[row] & (place != 1)
    sign = np.where(place == 0, 1.0, -1.0)
    turned = np.where(spot, sign * aside[row], turn[row])
    driven = np.where(spot, 0.0, (chord / np.sinc(turn / (2.0 * np.pi)))[row])
    share = 1.0 / pieces[row]
    return TwistIntervals(
        begin,
        end,
        driven / seconds,
        turned / seconds,
        given.variance_x[row] * share,
        given.variance_turn[row] * share,
    ), int(np.count_nonzero(bent))


def _piece_times(
    given: RelativePoses, bent: NDArray[np.bool_], row: Indices, place: Indices
) -> tuple[Stamps, Stamps]:
    """Begin and end of every piece, ns: of three, the turns take one period, a fifth at most."""
    length = given.end - given.begin
    spot = np.minimum(length // 5, int(np.median(length)))[row]
    begin, end = given.begin[row], given.end[row]
    first = np.where(bent & (place > 0), np.where(place == 1, begin + spot, end - spot), begin)
    last = np.where(bent & (place < 2), np.where(place == 0, begin + spot, end - spot), end)
    return first, last
