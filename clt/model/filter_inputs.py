"""What every filter reads: one tuple of arrays, and in which order its events come."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.model.range_errors import RangeErrors
from clt.model.range_table import RangeTable
from clt.model.state_space import StateSpace
from clt.model.twist_segments import TwistSegments


class Outputs(NamedTuple):
    """When which block is wanted: rows sorted by stamp."""

    stamp: Stamps
    robot: Indices
    """The block."""


class EventSchedule(NamedTuple):
    """The instants at which ranges or outputs lie, E of them, in order.

    At instant e come the ranges first_range[e] .. first_range[e + 1] - 1, then the outputs
    first_output[e] .. first_output[e + 1] - 1.
    """

    stamp: Stamps
    """ns, (E,)."""
    first_range: Indices
    """(E + 1,)."""
    first_output: Indices
    """(E + 1,)."""


class FilterInputs(NamedTuple):
    """One run of a filter without its belief: B blocks that D drivers move, M ranges, O outputs."""

    space: StateSpace
    lever: Floats
    """Antenna of each block's robot in its body frame, (B, 2), m."""
    segments: TwistSegments
    ranges: RangeTable
    errors: RangeErrors
    outputs: Outputs
    events: EventSchedule
    start: int
    """ns."""
    end: int
    """ns; in the end everything is propagated up to here, or to the last event."""


def schedule_events(ranges: RangeTable, outputs: Outputs) -> EventSchedule:
    """The instants of ranges and outputs, both sorted by stamp (ns)."""
    stamp = np.union1d(ranges.stamp, outputs.stamp)
    return EventSchedule(
        stamp,
        np.append(np.searchsorted(ranges.stamp, stamp), ranges.stamp.size),
        np.append(np.searchsorted(outputs.stamp, stamp), outputs.stamp.size),
    )
