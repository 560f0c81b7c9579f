"""Where odometry alone takes the antenna of a robot, and how its errors accumulate.

The model is the filters' (`clt.model.unicycle`): every step of the odometry adds an independent
error along the heading and one of the heading. A heading error turns all of the way that follows,
so the errors at two times are correlated; the whole covariance is kept. What is wrong throughout
(the scale of v, that of omega, the bias of omega) is one number each for the whole track.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.geometry import rotation_matrix
from clt.model.settings import NoiseSettings
from clt.model.state_space import MAX_STANDSTILL_TWIST
from clt.model.twist_segments import TwistSegments

MAX_LINEAR_HEADING_SIGMA = 0.25
"""Standard deviation of a heading (rad) up to which what it does to a track is linear in it."""


class LastingErrors(NamedTuple):
    """Standard deviations of errors that a robot's odometry has throughout."""

    scale_v: float = 0.0
    """Share of v."""
    scale_omega: float = 0.0
    """Share of omega."""
    bias_omega: float = 0.0
    """rad/s, while the wheels turn."""


NO_LASTING_ERRORS = LastingErrors()


def lasting_errors(noise: NoiseSettings) -> LastingErrors:
    """What the settings say of errors of scale and bias."""
    return LastingErrors(*noise.lasting)


@dataclass(frozen=True)
class OdometryTrack:
    """Antenna positions of one robot in its body frame at the start."""

    position: Floats
    """(n, 2), m."""
    covariance: Floats
    """Between the errors at any two of the chosen times, (m, m, 2, 2), m^2."""


def static_track(n: int, m: int) -> OdometryTrack:
    """The track of a robot that does not move, at n stamps of which m are chosen."""
    return OdometryTrack(np.zeros((n, 2)), np.zeros((m, m, 2, 2)))


def linear_until(
    segments: TwistSegments, start: int, wrong: LastingErrors = NO_LASTING_ERRORS
) -> int:
    """Time (ns) to which odometry alone knows the heading to MAX_LINEAR_HEADING_SIGMA."""
    dt = np.diff(segments.end, prepend=start) * 1e-9
    variance = np.cumsum(segments.interval * segments.var_omega * dt)
    variance += (wrong.scale_omega * np.cumsum(segments.omega * dt)) ** 2
    variance += (wrong.bias_omega * np.cumsum(np.where(_rolling(segments), dt, 0.0))) ** 2
    known = int(np.argmax(np.append(variance > MAX_LINEAR_HEADING_SIGMA**2, True)))
    if known == segments.end.size:
        return int(np.iinfo(np.int64).max)
    return int(segments.end[known - 1]) if known > 0 else start


def _rolling(segments: TwistSegments) -> NDArray[np.bool_]:
    """In which segments the wheels turn."""
    return np.asarray(
        (np.abs(segments.v) >= MAX_STANDSTILL_TWIST)
        | (np.abs(segments.omega) >= MAX_STANDSTILL_TWIST)
    )


def odometry_track(
    segments: TwistSegments,
    start: int,
    stamp: Stamps,
    lever: Floats,
    chosen: Indices,
    wrong: LastingErrors = NO_LASTING_ERRORS,
) -> OdometryTrack:
    """Integrate one robot's twist segments from `start` (ns) to stamps (n,), sorted.

    `lever` (2,) is the antenna in the body frame, m; `chosen` (m,) are the stamps, as indices, of
    which the covariance is wanted. The error of the position q_l at time l is
    the sum over the steps m before it of the error along the heading and of J (q_l - p_m) times
    that of the heading, with p_m in the middle of step m and J a quarter turn; sums over m, and
    so the covariance of times k <= l, come from running totals up to k. What is `wrong` throughout
    adds an outer product each: a share s of v moves q_l by s times the way, and heading errors
    e_m that it makes by J sum_m (q_l - p_m) e_m.
    """
    end = np.unique(np.concatenate([segments.end[segments.end > start], stamp]))
    end = end[end <= stamp[-1]]
    of = np.minimum(np.searchsorted(segments.end, end), segments.end.size - 1)
    dt = np.diff(end, prepend=start) * 1e-9
    turn = segments.omega[of] * dt
    heading = np.cumsum(turn) - 0.5 * turn
    along = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    chord = (segments.v[of] * dt * np.sinc(0.5 * turn / np.pi))[:, None] * along
    after = np.cumsum(chord, axis=0)
    middle = after - 0.5 * chord
    scale = segments.interval[of] * dt
    q_v, q_w = segments.var_v[of] * scale, segments.var_omega[of] * scale

    at = np.searchsorted(end, stamp)
    position = after[at] + rotation_matrix(np.cumsum(turn)[at]) @ lever
    at = at[chosen]
    drift = _total(q_v[:, None, None] * along[:, :, None] * along[:, None, :], at)
    weight = _total(q_w, at)
    first = _total(q_w[:, None] * middle, at)
    second = _total(q_w[:, None, None] * middle[:, :, None] * middle[:, None, :], at)
    covariance = drift_covariance(position[chosen], drift, weight, first, second)
    if wrong != NO_LASTING_ERRORS:
        rolled = np.where(_rolling(segments)[of], dt, 0.0)
        effects = [wrong.scale_v * after[at]]
        for sigma, error in ((wrong.scale_omega, turn), (wrong.bias_omega, rolled)):
            moment = _total(error[:, None] * middle, at)
            effects.append(sigma * _turned(position[chosen], _total(error, at), moment))
        for g in effects:
            covariance += g[:, None, :, None] * g[None, :, None, :]
    return OdometryTrack(position, covariance)


def _turned(position: Floats, turn: Floats, moment: Floats) -> Floats:
    """J sum_m (q_l - p_m) e_m (n, 2) of heading errors e_m with totals `turn` (n,), e_m p_m."""
    lever = position * turn[:, None] - moment
    return np.stack([-lever[:, 1], lever[:, 0]], axis=1)


def _total(values: Floats, at: Indices) -> Floats:
    return np.cumsum(values, axis=0)[at]


def drift_covariance(
    position: Floats, drift: Floats, weight: Floats, first: Floats, second: Floats
) -> Floats:
    """Covariance (n, n, 2, 2) of positions (n, 2) whose errors accumulate.

    Totals up to each time: `drift` (n, 2, 2) of the errors along the heading, and of the variance
    of the heading's steps `weight` (n,), times their place `first` (n, 2), times the square of
    that `second` (n, 2, 2).
    """
    n = len(position)
    k = np.minimum(np.arange(n)[:, None], np.arange(n)[None, :])
    row, column = position[:, None, :, None], position[None, :, None, :]
    moment = (
        row * column * weight[k][..., None, None]
        - row * first[k][:, :, None, :]
        - first[k][:, :, :, None] * column
        + second[k]
    )
    turned = np.empty_like(moment)
    turned[..., 0, 0], turned[..., 1, 1] = moment[..., 1, 1], moment[..., 0, 0]
    turned[..., 0, 1], turned[..., 1, 0] = -moment[..., 1, 0], -moment[..., 0, 1]
    return drift[k] + turned
