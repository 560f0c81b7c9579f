"""CMU "Plaza" data sets: an autonomous mower, ranging radios, GPS truth (Djugash et al., JFR 2009).

One `PlazaN_.mat` (MATLAB 5), or the folder that holds it. Seconds, metres, radians, planar:

- `GT`: t, x, y, heading; `DR`: t, way, turn since the row before (the first: since the first row
  of `GT`); `TD`: t, sender antenna, beacon id, range; `TL`: beacon id, x, y.
- Increments become mean twists over the interval that ends at their stamp. An interval much longer
  than the others is one drive of which the increment is known, not a gap: it becomes several
  samples.
- The headings of `GT` point against the course in what is published: where they do, by the course
  over ground of `GT` itself, they are turned by pi.
- Nothing links a range to a row of `GT`: all streams keep their own stamps; log_time = stamp.
- Nothing is calibrated: ranges are about 7 % long, the gyro drifts by -0.007 rad/s (Plaza 2).

The mower is `mower`, beacons are B<id>, static, at their surveyed positions.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from clt.core.arrays import Floats, Stamps
from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.columns import RawRanges, run_notes, sorted_ranges, truth_of_static
from clt.importers.matfile import mat_table, read_mat_file
from clt.importers.steps import TwistIntervals, intervals_to_odometry
from clt.importers.textfile import ROS_TIME_END_S
from clt.log.faults import Faults

PLAZA_FILES = "Plaza*_.mat"
COURSE_ROWS = 10
"""The course over ground is taken over as many rows of the truth on both sides."""
MIN_COURSE_WAY = 1.0
"""It is known where the robot is so far away after them, m."""


def plaza_files(path: Path) -> tuple[Path]:
    """The file itself, or the only one of its kind in a folder. Raises LogError otherwise."""
    if not path.is_dir():
        return (path,)
    found = sorted(path.glob(PLAZA_FILES))
    if len(found) != 1:
        there = ", ".join(file.name for file in found) or "none"
        raise LogError(f"{path}: give one {PLAZA_FILES}; it has: {there}")
    return (found[0],)


def read_plaza(path: Path) -> Recording:
    """Read one data set; `path` as `plaza_files` takes it.

    Raises:
        LogError: naming the file, the variable and the row that is missing or wrong.
    """
    (mat,) = plaza_files(path)
    content = read_mat_file(mat, PLAZA_FILES)
    truth, steps = mat_table(content, "GT", 4, mat), mat_table(content, "DR", 3, mat)
    measured, beacons = mat_table(content, "TD", 4, mat), mat_table(content, "TL", 3, mat)
    faults, notes = Faults(str(mat)), list[str]()
    team = _team(beacons, mat)
    poses = _truth(truth, mat, notes)
    odometry = _odometry(steps, float(truth[0, 0]), mat, notes)
    known = {"mower": poses}
    return Recording(
        team=team,
        odometry={"mower": odometry},
        ranges=_ranges(measured, team, mat, faults),
        truth={**known, **truth_of_static(team.robots, known)},
        run=run_notes(notes),
        faults=faults.all(),
    )


def _stamps(table: Floats, name: str, mat: Path) -> Stamps:
    """The first column as ns. Raises LogError for a time that does not rise or is none of ROS 2."""
    t = table[:, 0]
    if t.min() < 0.0 or t.max() >= ROS_TIME_END_S:
        raise LogError(f"{mat}: `{name}`: times are not seconds from 0 to 2^31")
    stamp: Stamps = np.rint(t * 1e9).astype(np.int64)
    back = np.flatnonzero(np.diff(stamp) <= 0)
    if len(back) > 0:
        raise LogError(f"{mat}: `{name}`, row {back[0] + 2}: not later than the row before")
    return stamp


def _team(beacons: Floats, mat: Path) -> Team:
    """The mower with the lowest free id, and the beacons."""
    ids = beacons[:, 0]
    if np.any(ids != np.round(ids)) or ids.min() < 0 or ids.max() >= 1 << 16:
        raise LogError(f"{mat}: `TL`: the first column holds no ids of beacons")
    if len(np.unique(ids)) < len(ids):
        raise LogError(f"{mat}: `TL`: two beacons share one id")
    taken = {int(number) for number in ids}
    own = next(number for number in range(1, 1 << 16) if number not in taken)
    static = [
        Robot(f"B{int(number)}", int(number), static=True, position=(x, y))
        for number, x, y in sorted(beacons.tolist())
    ]
    return Team((Robot("mower", own), *static))


def _odometry(steps: Floats, start: float, mat: Path, notes: list[str]) -> Odometry:
    end = _stamps(steps, "DR", mat)
    first = round(start * 1e9)
    if not 0 < end[0] - first <= 3 * np.median(np.diff(end)):
        first = int(end[0] - np.median(np.diff(end)))
    begin = np.append(np.int64(first), end[:-1])
    seconds, unknown = (end - begin) * 1e-9, np.full(len(end), np.nan)
    twists = TwistIntervals(
        begin, end, steps[:, 1] / seconds, steps[:, 2] / seconds, unknown, unknown
    )
    odometry, cut = intervals_to_odometry(twists)
    if cut > 0:
        notes.append(f"mower: {cut} of {len(end)} increments span several periods: cut into them")
    return odometry


def _truth(table: Floats, mat: Path, notes: list[str]) -> Poses:
    stamp = _stamps(table, "GT", mat)
    _, x, y, heading = table.T
    behind = slice(None, -2 * COURSE_ROWS)
    ahead, middle = slice(2 * COURSE_ROWS, None), slice(COURSE_ROWS, -COURSE_ROWS)
    dx, dy = x[ahead] - x[behind], y[ahead] - y[behind]
    off = np.arctan2(dy, dx) - heading[middle] if len(dx) > 0 else np.empty(0)
    off = off[np.hypot(dx, dy) > MIN_COURSE_WAY] if len(dx) > 0 else off
    if len(off) > 0 and np.mean(np.cos(off)) < 0.0:
        heading = heading + np.pi
        notes.append("mower: headings of the truth pointed against the course: turned by pi")
    return Poses(WORLD_FRAME, stamp, stamp, x, y, wrap_angle(heading))


def _ranges(measured: Floats, team: Team, mat: Path, faults: Faults) -> Ranges:
    stamp = np.rint(measured[:, 0] * 1e9)
    if stamp.min() < 0.0 or stamp.max() >= ROS_TIME_END_S * 1e9:
        raise LogError(f"{mat}: `TD`: times are not seconds from 0 to 2^31")
    index = {robot.id: row for row, robot in enumerate(team.robots) if robot.static}
    target = np.array([index.get(number, -1) for number in measured[:, 2].tolist()])
    known = target >= 0
    if not known.all():
        count = int(np.count_nonzero(~known))
        text = f"{count} of {len(known)} ranges are to a beacon that TL lacks; dropped"
        faults.add("unknown", "TD", text, count=count, lost=True)
    raw = measured[known, 3]
    columns = (stamp[known].astype(np.int64), np.zeros(len(raw), np.int64), target[known])
    return sorted_ranges(
        RawRanges(*columns, raw, np.full(len(raw), np.nan)), len(team.robots), faults
    )
