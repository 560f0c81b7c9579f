"""CSV trajectories with a head line, a file for each robot and stream, covariances included.

`time` (s), `x`, `y` (m), `heading` (rad) and, where the log has them, the six different numbers of
the covariance: `var_x`, `cov_x_y`, `cov_x_heading`, `var_y`, `cov_y_heading`, `var_heading` (m^2,
m rad, rad^2). An empty cell is a number that is not known.
"""

from __future__ import annotations

from clt.core.recording import Poses, Recording
from clt.exporters.export import Export
from clt.exporters.poses import numbers_text, seconds_text, trajectory_files

POSE_COLUMNS = ("time", "x", "y", "heading")
COVARIANCE_COLUMNS = {
    "var_x": (0, 0),
    "cov_x_y": (0, 1),
    "cov_x_heading": (0, 2),
    "var_y": (1, 1),
    "cov_y_heading": (1, 2),
    "var_heading": (2, 2),
}
"""Names of columns, and row and column of the covariance of (x, y, heading)."""


def write_csv(recording: Recording, _log: str) -> Export:
    """Export all trajectories. Raises CltError where there is none."""
    return trajectory_files(recording, ".csv", _encode)


def _encode(poses: Poses) -> bytes:
    names = [*POSE_COLUMNS]
    columns = [seconds_text(poses.stamp), *map(numbers_text, (poses.x, poses.y, poses.heading))]
    if poses.covariance is not None:
        names += COVARIANCE_COLUMNS
        columns += [numbers_text(poses.covariance[:, i, j]) for i, j in COVARIANCE_COLUMNS.values()]
    lines = map(",".join, zip(*columns, strict=True))
    return ("\n".join([",".join(names), *lines]) + "\n").encode()
