"""VUB's pair of TurtleBot4 (UPF_RPE, Brussels, 2023): one UWB pair, visual odometry, Vicon truth.

`expN_uwb.csv` (t_unix_s, range_m), `expN_tbX_vio.csv` and `expN_tbX_vicon.csv` (t_unix_s, x_m,
y_m, z_m, qw, qx, qy, qz), each plain or gzip: the arrays of the published experiments at 10 Hz, all
streams at common stamps. When a sample reached the recorder is not known, so log_time = stamp.

- Vicon: z up, body x forward; heading = yaw.
- The odometry is a visual-inertial pose, each robot in its own start frame: z up, body in camera
  axes (z forward, x right, y down), so heading = atan2(R[1, 2], R[0, 2]). Its steps are
  given as the mean twist over the interval that ends at the stamp. A twist has no sideways part:
  the camera sits 0.06 m behind the point about which the robot turns, and drifts sideways by up
  to 4 mm/s; both are left out (dead reckoning of exp4: relative distance 0.26 m; 0.15 m with).
- The path is 13 to 18 % too long and ranges read 0.09 m short: `benchmarks/vub_calibration.toml`.
- exp2's tb2 jumps (heading by up to 58 degrees): such steps are reported and kept.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from clt.core.arrays import Floats
from clt.core.errors import LogError
from clt.core.geometry import heading_of_quaternion, wrap_angle
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.csvfile import CsvTable, read_csv_table
from clt.log.faults import Faults

VUB_FILE_PATTERN = re.compile(
    r"(?P<run>[A-Za-z0-9]+)_(?:uwb|(?P<robot>tb(?P<id>\d+))_(?P<kind>vio|vicon))\.csv(?:\.gz)?"
)
TIME_COLUMN = "t_unix_s"
POSE_COLUMNS = ("x_m", "y_m", "qw", "qx", "qy", "qz")
MAX_SPEED, MAX_TURN_RATE = 1.0, 2.0
"""No TurtleBot4 drives or turns like that, m/s and rad/s."""
VUB_RANGE_SIGMA, VUB_RANGE_CORRELATION = 0.09, 0.8
"""Robust deviation of exp4's ranges from the truth, m; where their correlation is 1/e, s."""
VUB_SIGMA_V, VUB_SIGMA_OMEGA = 0.045, 0.02
"""Of one sample, m/s and rad/s: what makes the errors of means over 0.5 to 10 s, jumps aside."""


def vub_files(path: Path) -> tuple[Path, ...]:
    """All files of one experiment.

    `path` is one of them, or the folder and the experiment's name (`.../exp4`), or a folder that
    holds only one. Raises LogError where these name no experiment, or several.
    """
    folder, name = (path, "") if path.is_dir() else (path.parent, path.name)
    try:
        found = [file for file in sorted(folder.iterdir()) if VUB_FILE_PATTERN.fullmatch(file.name)]
    except OSError as error:
        raise LogError(f"{folder}: {error.strerror or error}") from None
    runs = sorted({file.name.partition("_")[0] for file in found})
    wanted = name.partition("_")[0] if name != "" else runs[0] if len(runs) == 1 else ""
    if wanted not in runs:
        present = ", ".join(runs) or "none of its files (expN_uwb.csv)"
        which = "give one experiment, as FOLDER/NAME" if name == "" else f"no experiment `{wanted}`"
        raise LogError(f"{folder}: {which}; it has: {present}")
    return tuple(file for file in found if file.name.partition("_")[0] == wanted)


def read_vub(path: Path) -> Recording:
    """Read one experiment; `path` as `vub_files` takes it.

    Raises:
        LogError: naming the file and what is missing or wrong in it.
    """
    matches = [(file, VUB_FILE_PATTERN.fullmatch(file.name)) for file in vub_files(path)]
    kinds = {(m["robot"], m["kind"]): file for file, m in matches if m is not None}
    ids = {m["robot"]: int(m["id"]) for _, m in matches if m is not None and m["robot"]}
    place = matches[0][0].with_name(matches[0][0].name.partition("_")[0])
    if (None, None) not in kinds:
        raise LogError(f"{place}: no {place.name}_uwb file beside the poses")
    if len(ids) != 2:
        raise LogError(f"{place}: poses of {len(ids)} robot(s), not of the two that range")
    faults = Faults(str(place))
    names = sorted(ids, key=ids.__getitem__)
    tables = {
        key: read_csv_table(file, TIME_COLUMN, POSE_COLUMNS, faults)
        for key, file in kinds.items()
        if key[0] in ids
    }
    return Recording(
        team=Team(
            tuple(
                Robot(name, ids[name], sigma_v=VUB_SIGMA_V, sigma_omega=VUB_SIGMA_OMEGA)
                for name in names
            ),
            VUB_RANGE_SIGMA,
            VUB_RANGE_CORRELATION,
        ),
        odometry={
            name: _odometry(tables[name, "vio"], kinds[name, "vio"].name, faults)
            for name in names
            if (name, "vio") in tables
        },
        ranges=_ranges(read_csv_table(kinds[None, None], TIME_COLUMN, ("range_m",), faults)),
        truth={name: _truth(tables[name, "vicon"]) for name in names if (name, "vicon") in tables},
        faults=faults.all(),
    )


def _odometry(poses: CsvTable, place: str, faults: Faults) -> Odometry:
    """Steps of a pose as mean twists: a chord and a turn make the arc between two stamps."""
    x, y, qw, qx, qy, qz = (poses.columns[name] for name in POSE_COLUMNS)
    # The camera looks along its z axis: the third column of R, projected.
    heading = np.arctan2(2.0 * (qy * qz - qw * qx), 2.0 * (qx * qz + qw * qy))
    dt = np.diff(poses.stamp) * 1e-9
    turn = wrap_angle(np.diff(heading))
    middle = heading[:-1] + 0.5 * turn
    chord = np.cos(middle) * np.diff(x) + np.sin(middle) * np.diff(y)
    v, omega = chord / np.sinc(turn / (2.0 * np.pi)) / dt, turn / dt
    jumps = int(np.count_nonzero((np.abs(v) > MAX_SPEED) | (np.abs(omega) > MAX_TURN_RATE)))
    if jumps > 0:
        text = (
            f"{jumps} of {len(v)} steps beyond {MAX_SPEED:g} m/s or {MAX_TURN_RATE:g} rad/s; kept"
        )
        faults.add("jump", place, text, count=jumps)
    stamp, unknown = poses.stamp[1:], np.full(len(v), np.nan)
    return Odometry(stamp, stamp, v, omega, sigma_v=unknown, sigma_omega=unknown)


def _truth(poses: CsvTable) -> Poses:
    x, y, qw, qx, qy, qz = (poses.columns[name] for name in POSE_COLUMNS)
    return Poses(WORLD_FRAME, poses.stamp, poses.stamp, x, y, heading_of_quaternion(qx, qy, qz, qw))


def _ranges(table: CsvTable) -> Ranges:
    """The first robot's ranges to the second; uncalibrated, so `range` is `raw`."""
    raw: Floats = table.columns["range_m"]
    count, stamp = len(raw), table.stamp
    source, target = np.zeros(count, np.int64), np.ones(count, np.int64)
    sigma = np.full(count, np.nan)
    return Ranges(stamp, stamp, source, target, raw, raw, sigma, np.arange(count))
