"""A recording, a start and a frame laid out as the arrays of one filter run.

World: three numbers (x, y, theta) for every moving robot that has odometry and a start, and for
every static robot whose position is uncertain; static robots of certain position are anchors
outside the state. Ego: every other robot with a start, moving or static, in the ego's body frame.
Mutual: two robots, each in the other's body frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.core.start import Start
from clt.model.belief import Belief, Prior, belief_from_prior, make_prior
from clt.model.choices import FrameSpec
from clt.model.filter_inputs import FilterInputs, Outputs, schedule_events
from clt.model.range_errors import (
    MAX_SLOW_PAIRS,
    RangeErrors,
    count_pairs,
    lay_out_range_errors,
    no_range_errors,
    with_slow_noise,
)
from clt.model.range_measurements import range_measurements
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.state_layout import StateLayout, choose_states, reason_left_out
from clt.model.state_space import (
    ODOMETRY_ERROR_STATES,
    WORLD_REFERENCE,
    StateSpace,
    make_state_space,
)
from clt.model.twist_segments import TwistSegments, join_segments, no_segments, robot_segments
from clt.model.unused import EARLY_END_NS, idle_static_robots, unused_ranges

BASE_LINK_SUFFIX = "/base_link"
"""Ends the id of a frame that moves with a robot."""
MAX_OUTPUT_STEP_NS = 100_000_000
"""Longest time between two outputs, ns ..."""
MAX_OUTPUTS_PER_SAMPLE = 100
"""... but no more outputs than this between two odometry samples, however long a gap is."""
WORLD_FRAME_SPEC = FrameSpec("world")
NO_OUTPUTS = Outputs(np.empty(0, np.int64), np.empty(0, np.int64))


@dataclass(frozen=True)
class Problem:
    """One filter run. Blocks of the state, the drivers' inputs, ranges, outputs."""

    robots: tuple[str, ...]
    """Whose pose each block holds."""
    frames: tuple[str, ...]
    """Id of the frame that it stands in."""
    drivers: tuple[str, ...]
    """Robots whose odometry moves the blocks."""
    space: StateSpace
    prior: Prior | None
    """None where a filter goes on from `belief`, as an earlier run of it left it."""
    belief: Belief
    """At `start`."""
    antenna: Floats
    """Of each driver in its body frame, shape (D, 2), m."""
    lever: Floats
    """The same of each block's robot, shape (B, 2)."""
    segments: TwistSegments
    ranges: RangeTable
    errors: RangeErrors
    """How its ranges err."""
    outputs: Outputs
    start: int
    end: int
    """ns; everything is propagated up to here."""
    diagnostics: tuple[Diagnostic, ...]
    """What had to be assumed, and robots and ranges that nothing is estimated from."""
    epoch: int = 0
    """Counts the runs that go on from one another; what draws at random adds it to its seed."""
    memory: object = None
    """What the earlier run of the same filter kept beside its belief (`Solution.memory`)."""

    @property
    def inputs(self) -> FilterInputs:
        """What a filter reads, its events in order."""
        return FilterInputs(
            self.space,
            self.lever,
            self.segments,
            self.ranges,
            self.errors,
            self.outputs,
            schedule_events(self.ranges, self.outputs),
            self.start,
            self.end,
        )

    @property
    def mean(self) -> Floats:
        """Of the most probable Gaussian at the start, shape (N,)."""
        mean: Floats = self.belief.mean[0]
        return mean

    @property
    def covariance(self) -> Floats:
        """Of the same, shape (N, N)."""
        covariance: Floats = self.belief.covariance[0]
        return covariance


class DriverTwists(NamedTuple):
    """Twist segments of all drivers, and what had to be assumed of them."""

    segments: TwistSegments
    diagnostics: tuple[Diagnostic, ...]


def build_problem(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    view: FrameSpec = WORLD_FRAME_SPEC,
    *,
    lasting_range_errors: bool = False,
    twists: DriverTwists | None = None,
    with_outputs: bool = True,
) -> Problem:
    """Lay a recording out for a filter. Raises CltError where nothing can be estimated.

    lasting_range_errors: the filter estimates those, and weighs outliers. twists: what
    `driver_segments` gives, where that is known. `with_outputs`: estimates are wanted.
    """
    cast = choose_states(recording, start, view)
    names, team = cast.names, recording.team
    odometry = {name: recording.odometry[name] for name in names if name in recording.odometry}
    if len(odometry) == 0:
        why = f": {reason_left_out(cast.left_out[0])}" if len(cast.left_out) > 0 else ""
        raise CltError(f"no moving robot can be localized{why}")
    end = max(int(stream.stamp[-1]) for stream in odometry.values())
    if twists is None:
        twists = driver_segments(recording, names, settings, start.stamp, end)
    table, said, placed = range_measurements(recording, start, cast, view, settings, end)
    left_out = [*cast.left_out, *unused_ranges(recording, placed, end)]
    if table.row.size == 0:
        left_out.append(Diagnostic("no_ranges", "", "partial"))
    for name, stream in odometry.items():
        if end - int(stream.stamp[-1]) > EARLY_END_NS:
            seconds = (end - int(stream.stamp[-1])) * 1e-9
            early = {"early_s": seconds}
            left_out.append(Diagnostic("odometry_ends_early", name, "partial", early))
    sigmas = settings.noise.lasting
    calibrated = [d for d, name in enumerate(names) if name in odometry and any(sigmas)]
    first = 3 * len(cast.who) + ODOMETRY_ERROR_STATES * len(calibrated)
    errors = no_range_errors(count_pairs(table))
    range_sigmas: tuple[float, ...] = ()
    if not lasting_range_errors or count_pairs(table) > MAX_SLOW_PAIRS:
        table = with_slow_noise(table, settings.noise)
        settings = without_lasting_range_errors(settings)
    if lasting_range_errors:
        errors, range_sigmas, _ = lay_out_range_errors(table, recording.ranges, first, settings)
    prior = make_prior(
        start,
        names,
        cast.who,
        cast.base,
        (*(sigmas * len(calibrated)), *range_sigmas),
        still=[name for name in names if name not in odometry],
    )
    robots = tuple(names[j] for j in cast.who)
    antenna = np.array([team.robots[team.index(name)].antenna for name in names], np.float64)
    return Problem(
        robots,
        tuple(
            fixed_frame_id(start) if i == WORLD_REFERENCE else f"{names[i]}{BASE_LINK_SUFFIX}"
            for i in cast.base
        ),
        names,
        make_state_space(cast.who, cast.base, calibrated),
        prior,
        belief_from_prior(prior),
        antenna,
        antenna[list(cast.who)],
        twists.segments,
        table,
        errors,
        output_times(cast, {name: odometry[name].stamp for name in odometry}, start.stamp)
        if with_outputs
        else NO_OUTPUTS,
        start.stamp,
        end,
        (*idle_static_robots(recording, start, view), *twists.diagnostics, *said, *left_out),
    )


def without_lasting_range_errors(settings: FilterSettings) -> FilterSettings:
    """Settings whose ranges have white noise alone."""
    none = {"slow": 0.0, "offset": 0.0, "gain": 0.0}
    return settings.model_copy(update={"noise": settings.noise.model_copy(update=none)})


def fixed_frame_id(start: Start) -> str:
    """Id of the fixed frame of a start: of poses in a body frame, where that robot was then."""
    name, body, _ = start.frame.partition(BASE_LINK_SUFFIX)
    return f"{name}/start" if body else start.frame


def driver_segments(
    recording: Recording, names: Sequence[str], settings: FilterSettings, start: int, end: int
) -> DriverTwists:
    """Twist segments of each robot from `start` to `end` (ns), and what had to be assumed."""
    parts: list[TwistSegments] = []
    notes: list[Diagnostic] = []
    for name in names:
        if name in recording.odometry:
            robot = recording.team.robots[recording.team.index(name)]
            stream = recording.odometry[name]
            part, said = robot_segments(stream, robot, settings.noise, start, end)
            parts.append(part)
            notes += said
        else:
            parts.append(no_segments())
    return DriverTwists(join_segments(parts), tuple(notes))


def output_times(cast: StateLayout, stamps: Mapping[str, Stamps], start: int) -> Outputs:
    """Each block at the start and at its robot's odometry stamps; standing ones with the first's.

    Steps longer than MAX_OUTPUT_STEP_NS are divided, so that slow odometry does not hide what the
    ranges in between show.
    """
    default = next(iter(stamps.values()))
    wanted: list[Indices] = []
    for j in cast.who:
        own = stamps.get(cast.names[j], default)
        own = np.append(start, np.unique(own[own > start]))
        parts = np.clip(-(-np.diff(own) // MAX_OUTPUT_STEP_NS), 1, MAX_OUTPUTS_PER_SAMPLE)
        step = np.repeat(np.arange(parts.size), parts)
        part = np.arange(step.size) - np.repeat(np.cumsum(parts) - parts, parts) + 1
        # Whole parts and rest apart: their product over centuries would not fit 64 bits.
        size, rest = np.divmod(np.diff(own), parts)
        between = own[step] + size[step] * part + rest[step] * part // parts[step]
        wanted.append(np.append(start, between))
    stamp = np.concatenate(wanted).astype(np.int64)
    block = np.repeat(np.arange(len(wanted)), [part.size for part in wanted])
    order = np.argsort(stamp, kind="stable")
    return Outputs(stamp[order], block[order])
