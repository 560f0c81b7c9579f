"""TUM trajectories for evo: lines of `t x y z qx qy qz qw`, a file for each robot and stream.

Seconds, metres, z = 0. A heading that is not known is a quaternion of zeros, as `clt import tum`
reads it. TUM has no frame and no covariance: the frames stand in the summary, the covariances in
the format `csv`.
"""

from __future__ import annotations

import numpy as np

from clt.core.recording import Poses, Recording
from clt.exporters.export import Export
from clt.exporters.poses import numbers_text, seconds_text, trajectory_files


def write_tum(recording: Recording, _log: str) -> Export:
    """Export all trajectories. Raises CltError where there is none."""
    return trajectory_files(recording, ".tum", _encode)


def _encode(poses: Poses) -> bytes:
    half = poses.heading / 2.0
    columns = (
        seconds_text(poses.stamp),
        numbers_text(poses.x),
        numbers_text(poses.y),
        numbers_text(np.sin(half), "0.0"),
        numbers_text(np.cos(half), "0.0"),
    )
    lines = [f"{t} {x} {y} 0 0 0 {s} {c}\n" for t, x, y, s, c in zip(*columns, strict=True)]
    return "".join(lines).encode()
