"""Numbers over time: errors and their bounds; without truth the bounds, or the odometry."""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.geometry import is_heading_unknown
from clt.core.recording import Recording
from clt.metrics.evaluation import Evaluation
from clt.report.figures.paths import MAX_LINE_GAP
from clt.report.figures.thin import break_at_gaps, envelope_rows
from clt.report.html.encode import Document, encode_floats

MAX_BINS, MIN_BINS = 600, 100
"""The least and the largest value of so many intervals are drawn of a line; of many, of fewer."""
MAX_POINTS_OF_PANEL = 9000
"""Of all lines together: what a browser moves smoothly without help of a graphics card."""
AXIS_PERCENTILE, AXIS_HEADROOM = 99.0, 1.6
"""An axis first shows this percentile, with this much room above."""
MAX_HEADING_AXIS = 190.0


class _Panel:
    """One set of axes, filled line by line."""

    def __init__(self, title: str, unit: str, lines: int, *, signed: bool) -> None:
        self.title, self.unit, self.signed = title, unit, signed
        self.bins = min(max(MAX_POINTS_OF_PANEL // (2 * max(lines, 1)), MIN_BINS), MAX_BINS)
        self.lines: list[Document] = []
        self.tops: list[float] = []

    def add(self, robot: str, stamp: Stamps, values: Floats, begin: int, role: str) -> None:
        """A line of a robot: its `value`, or a `bound`."""
        finite = np.abs(values[np.isfinite(values)])
        if finite.size == 0:
            return
        rows = envelope_rows(values, self.bins)
        gap = max(MAX_LINE_GAP, 3.0 * float(np.ptp(stamp)) / 1e9 / len(rows))
        shown = break_at_gaps(stamp[rows], values[rows], gap)
        line = {"time": encode_floats((stamp[rows] - begin) * 1e-9), "value": encode_floats(shown)}
        self.lines.append({"robot": robot, "role": role, "count": len(values), **line})
        self.tops.append(float(np.percentile(finite, AXIS_PERCENTILE)))

    def document(self, most: float = float("inf")) -> Document:
        """What the page draws."""
        limit = min(AXIS_HEADROOM * max([*self.tops, 1e-6]), most)
        return {
            "title": self.title,
            "unit": self.unit,
            "signed": self.signed,
            "limit": limit,
            "lines": self.lines,
        }


def time_panels(
    recording: Recording, evaluation: Evaluation | None, begin: int
) -> tuple[str, list[Document]]:
    """A heading and the panels below each other; time 0 is `begin` (ns)."""
    if evaluation is not None:
        return "Errors over time, with 3-sigma bounds", _errors(evaluation, begin)
    if len(recording.estimate) > 0:
        return "3-sigma bounds over time (there is no truth)", _bounds(recording, begin)
    return "Odometry over time (not localized yet)", _odometry(recording, begin)


def _errors(evaluation: Evaluation, begin: int) -> list[Document]:
    robots = len(evaluation.estimate.tracks)
    position = _Panel("Position error", "m", 2 * robots, signed=False)
    heading = _Panel("Heading error", "degrees", 3 * robots, signed=True)
    for name, matched in evaluation.estimate.tracks.items():
        error = matched.error
        position.add(name, matched.stamp, np.hypot(*error[:, :2].T), begin, "value")
        heading.add(name, matched.stamp, np.degrees(error[:, 2]), begin, "value")
        if matched.covariance is not None:
            radius, turn = three_sigma(matched.covariance)
            position.add(name, matched.stamp, radius, begin, "bound")
            turn[~np.isfinite(error[:, 2])] = np.nan
            for side in (turn, -turn):
                heading.add(name, matched.stamp, side, begin, "bound")
    return [position.document(), heading.document(MAX_HEADING_AXIS)]


def three_sigma(covariance: Floats) -> tuple[Floats, Floats]:
    """3 sigma of the position (longest axis, m) and of the heading (degrees), shape (n,)."""
    longest = np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    variance = covariance[:, 2, 2]
    turn = np.degrees(3.0 * np.sqrt(np.maximum(variance, 0.0)))
    turn[is_heading_unknown(variance)] = np.nan
    return 3.0 * np.sqrt(np.maximum(longest, 0.0)), turn


def _bounds(recording: Recording, begin: int) -> list[Document]:
    robots = len(recording.estimate)
    position = _Panel("3 sigma of the position", "m", robots, signed=False)
    heading = _Panel("3 sigma of the heading", "degrees", robots, signed=False)
    for name, poses in recording.estimate.items():
        if poses.covariance is not None and np.isfinite(poses.covariance).all():
            radius, turn = three_sigma(poses.covariance)
            position.add(name, poses.stamp, radius, begin, "value")
            heading.add(name, poses.stamp, turn, begin, "value")
    return [position.document(), heading.document(MAX_HEADING_AXIS)]


def _odometry(recording: Recording, begin: int) -> list[Document]:
    robots = len(recording.odometry)
    speed = _Panel("Speed", "m/s", robots, signed=True)
    turn = _Panel("Turn rate", "degrees/s", robots, signed=True)
    for name, odometry in recording.odometry.items():
        speed.add(name, odometry.stamp, odometry.v, begin, "value")
        turn.add(name, odometry.stamp, np.degrees(odometry.omega), begin, "value")
    return [speed.document(), turn.document()]
