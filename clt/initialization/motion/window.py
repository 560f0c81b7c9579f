"""The first seconds of a log, laid out so that the filter can run over them many times.

The state holds moving robots, then static ones of uncertain position. While a robot is known to
stand still its odometry is replaced by zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clt.core.arrays import Floats
from clt.core.recording import Recording
from clt.filters.kalman import eskf, eskf_state
from clt.model.filter_inputs import FilterInputs, Outputs, schedule_events
from clt.model.noise import MIN_SIGMA_OMEGA, MIN_SIGMA_V
from clt.model.range_errors import count_pairs, no_range_errors
from clt.model.range_table import RangeTable, range_table
from clt.model.settings import FilterSettings, NoiseSettings
from clt.model.state_space import world_state_space
from clt.model.twist_segments import TwistSegments, join_segments, no_segments, robot_segments
from clt.model.unicycle import EXACT_NOISE

MAX_UNGATED_NIS = 25.0
"""NIS beyond which a range says no more against a hypothesis, where there is no gate."""
NO_OUTPUTS = Outputs(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True)
class StartWindow:
    """Inputs of the filter from `start` on; state robots in the order of `moving`, `floating`."""

    moving: tuple[str, ...]
    floating: tuple[str, ...]
    start: int
    lever: Floats
    segments: TwistSegments
    ranges: RangeTable
    settings: FilterSettings

    @property
    def size(self) -> int:
        """Length of the state."""
        return 3 * len(self.moving) + 3 * len(self.floating)

    @property
    def inputs(self) -> FilterInputs:
        """What the filter reads: poses in the world, no outputs."""
        return FilterInputs(
            world_state_space(self.size // 3),
            self.lever,
            self.segments,
            self.ranges,
            no_range_errors(count_pairs(self.ranges)),
            NO_OUTPUTS,
            schedule_events(self.ranges, NO_OUTPUTS),
            self.start,
            self.start,
        )


def build_window(
    recording: Recording,
    moving: Sequence[str],
    floating: Sequence[str],
    anchors: Mapping[str, Floats],
    still: Mapping[str, int],
    span: tuple[int, int],
    settings: FilterSettings,
) -> StartWindow:
    """The window over `span` (ns).

    `anchors` are certain positions; `still` says until when (ns) each moving robot stands.
    """
    team, (start, end) = recording.team, span
    parts = []
    for name in moving:
        robot = team.robots[team.index(name)]
        part, _ = robot_segments(recording.odometry[name], robot, settings.noise, start, end)
        part = _with_lasting_errors(part, settings.noise, (end - start) * 1e-9)
        parts.append(_zero_until(part, still.get(name, start)))
    parts += [no_segments() for _ in floating]
    state = {team.index(name): i for i, name in enumerate([*moving, *floating])}
    table, _ = range_table(
        recording.ranges,
        team,
        state,
        {team.index(name): position for name, position in anchors.items()},
        settings.noise,
        start,
        end,
    )
    lever = np.array([team.robots[team.index(n)].antenna for n in (*moving, *floating)], np.float64)
    return StartWindow(
        tuple(moving), tuple(floating), start, lever, join_segments(parts), table, settings
    )


def _with_lasting_errors(
    part: TwistSegments, noise: NoiseSettings, seconds: float
) -> TwistSegments:
    """Twist segments of one robot with the noise that errors of scale and bias come to.

    White noise that adds up to as much over so many `seconds`, and to more before.
    """
    times = seconds / np.maximum(part.interval, 1e-9)
    scale_v, scale_omega, bias = noise.lasting
    return part._replace(
        var_v=part.var_v + times * (scale_v * part.v) ** 2,
        var_omega=part.var_omega + times * ((scale_omega * part.omega) ** 2 + bias**2),
    )


def _zero_until(part: TwistSegments, until: int) -> TwistSegments:
    """Twist segments of one robot, zero up to `until` (ns)."""
    still = part.end <= until
    return part._replace(
        v=np.where(still, 0.0, part.v),
        omega=np.where(still, 0.0, part.omega),
        var_v=np.where(still, MIN_SIGMA_V**2, part.var_v),
        var_omega=np.where(still, MIN_SIGMA_OMEGA**2, part.var_omega),
    )


def filter_window(window: StartWindow, mean: Floats, covariance: Floats) -> eskf_state.KalmanOutput:
    """Filter a window from a joint mean and covariance at its start."""
    return eskf.run_eskf(
        mean,
        covariance,
        window.inputs,
        eskf_state.EskfOptions(window.settings.nis_gate, EXACT_NOISE),
    )


def bounded_nis(window: StartWindow, result: eskf_state.KalmanOutput) -> Floats:
    """NIS of each range, cut off: however far off a range is, it may have been an outlier."""
    worst = window.settings.nis_gate if window.settings.nis_gate > 0.0 else MAX_UNGATED_NIS
    return np.minimum(result.residual**2 / result.variance, worst)


def range_log_likelihoods(window: StartWindow, result: eskf_state.KalmanOutput) -> Floats:
    """Logarithm of how probable each range was, up to a constant.

    A range counts for as many as it is worth where errors are correlated.
    """
    worth = window.ranges.variance / window.ranges.weight_variance
    return np.asarray(-0.5 * worth * (bounded_nis(window, result) + np.log(result.variance)))


def log_likelihood(window: StartWindow, result: eskf_state.KalmanOutput) -> float:
    """Logarithm of how probable all ranges were, up to a constant."""
    return float(np.sum(range_log_likelihoods(window, result)))


def window_nis(window: StartWindow, result: eskf_state.KalmanOutput) -> float:
    """Mean NIS of the ranges of a window, outliers cut off; 1 for a true model."""
    return float(np.mean(bounded_nis(window, result)))


def window_with_ranges(window: StartWindow, rows: NDArray[np.bool_] | slice) -> StartWindow:
    """The window with some of its ranges."""
    columns = window.ranges._asdict().items()
    return replace(window, ranges=RangeTable(**{name: column[rows] for name, column in columns}))


def with_start_copies(window: StartWindow) -> StartWindow:
    """The window with a copy of every moving robot that stays where that robot was at the start.

    The filter's posterior of the copies is what the whole window says about the start: a
    fixed-point smoother.
    """
    count, first = len(window.moving), window.segments.first
    return replace(
        window,
        floating=(*window.floating, *window.moving),
        lever=np.concatenate([window.lever, np.zeros((count, 2))]),
        segments=window.segments._replace(first=np.append(first, np.full(count, first[-1]))),
    )
