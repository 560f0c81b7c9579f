"""UTIAS MRCLAM: five iRobot Create, landmarks, camera measurements, Vicon truth (2009).

The folder of one data set, each file plain or gzip: `Barcodes.dat` (subject, barcode),
`Landmark_Groundtruth.dat` (subject, x, y, deviations), and of every robot N
`RobotN_Odometry.dat` (t, v, omega), `RobotN_Measurement.dat` (t, barcode, range, bearing),
`RobotN_Groundtruth.dat` (t, x, y, heading). Unix seconds, metres, radians; `#` begins a comment.
Nothing says when a sample reached the recorder, so log_time = stamp.

- The odometry is what the robots were commanded, not what their wheels did. A command holds until
  the next one: it becomes samples that end there, at most MAX_HELD_S after it was given.
- Ranges are the cameras' distances to barcodes; the bearings are left out. A barcode that nobody
  carries was misread: those measurements are counted and dropped.
- Robots are named R<subject>, landmarks L<subject>: static, at their surveyed positions.
- Neither noise nor calibration is stated: the commands are 5 to 13 % larger than the motion.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from clt.core.errors import LogError
from clt.core.recording import WORLD_FRAME, Odometry, Poses, Ranges, Recording, Robot, Team
from clt.importers.columns import RawRanges, run_notes, sorted_ranges, truth_of_static
from clt.importers.steps import TwistIntervals, intervals_to_odometry
from clt.importers.textfile import parse_floats, read_rows, read_words
from clt.log.faults import Faults

MRCLAM_FILE_PATTERN = re.compile(
    r"(?:Robot(?P<robot>[1-9]\d?)_(?P<kind>Odometry|Measurement|Groundtruth)"
    r"|(?P<shared>Barcodes|Landmark_Groundtruth))\.dat(?:\.gz)?",
    re.ASCII,
)
MAX_HELD_S = 2.0
"""A command is taken to hold no longer, s."""

MrclamFiles = Mapping[tuple[str, int], Path]
"""By kind and number of the robot; 0 for what all share."""


def mrclam_files(path: Path) -> tuple[Path, ...]:
    """The files of a data set's folder. Raises LogError where it is none."""
    return tuple(_files_by_kind(path).values())


def read_mrclam(path: Path) -> Recording:
    """Read the folder of one data set.

    Raises:
        LogError: naming the file, the line and what is missing or wrong in it.
    """
    files = _files_by_kind(path)
    faults = Faults(str(path))
    subject_of = _barcodes(files["Barcodes", 0])
    numbers = sorted({number for _, number in files if number > 0})
    team = _team(numbers, sorted(subject_of.values()), _landmarks(files))
    notes = ["bearings of the cameras were left out"]
    odometry = {
        f"R{number}": _odometry(files["Odometry", number], f"R{number}", faults, notes)
        for number in numbers
        if ("Odometry", number) in files
    }
    truth = {
        f"R{number}": _truth(files["Groundtruth", number], faults)
        for number in numbers
        if ("Groundtruth", number) in files
    }
    return Recording(
        team=team,
        odometry=odometry,
        ranges=_ranges(files, subject_of, team, faults),
        truth={**truth, **truth_of_static(team.robots, truth)},
        run=run_notes(notes),
        faults=faults.all(),
    )


def _files_by_kind(path: Path) -> MrclamFiles:
    try:
        found = [(file, MRCLAM_FILE_PATTERN.fullmatch(file.name)) for file in path.iterdir()]
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}") from None
    files = {
        (match["shared"] or match["kind"], int(match["robot"] or 0)): file
        for file, match in sorted(found)
        if match is not None
    }
    if ("Barcodes", 0) not in files:
        raise LogError(f"{path}: no Barcodes.dat in it; give the folder of one MRCLAM data set")
    if not any(kind == "Measurement" for kind, _ in files):
        raise LogError(f"{path}: no RobotN_Measurement.dat in it: there are no ranges")
    return files


def _barcodes(path: Path) -> dict[int, int]:
    """Subjects by barcode. Raises LogError for a line that holds no two whole numbers."""
    found: dict[int, int] = {}
    for number, words in read_words(path):
        if len(words) < 2 or not (words[0].isdecimal() and words[1].isdecimal()):
            raise LogError(f"{path}: line {number}: not a subject and its barcode")
        subject, barcode = int(words[0]), int(words[1])
        if barcode in found or subject in found.values() or not 0 < subject < 1 << 16:
            raise LogError(f"{path}: line {number}: subject or barcode is there twice, or no id")
        found[barcode] = subject
    return found


def _landmarks(files: MrclamFiles) -> dict[int, tuple[float, float]]:
    """Surveyed positions (m) by subject; empty where the data set has none."""
    path = files.get(("Landmark_Groundtruth", 0))
    if path is None:
        return {}
    found: dict[int, tuple[float, float]] = {}
    for number, words in read_words(path):
        values = parse_floats(words[1:3])
        if not words[0].isdecimal() or values is None or not np.all(np.isfinite(values)):
            raise LogError(f"{path}: line {number}: not a subject and its position")
        if len(values) < 2:
            raise LogError(f"{path}: line {number}: not a subject and its position")
        found[int(words[0])] = (values[0], values[1])
    return found


def _team(
    robots: list[int], subjects: list[int], landmarks: Mapping[int, tuple[float, float]]
) -> Team:
    """Robots, then every other subject as a landmark."""
    moving = [Robot(f"R{number}", number) for number in robots]
    static = [
        Robot(f"L{subject}", subject, static=True, position=landmarks.get(subject))
        for subject in subjects
        if subject not in robots
    ]
    return Team((*moving, *static))


def _odometry(path: Path, name: str, faults: Faults, notes: list[str]) -> Odometry:
    """Commands as the samples over which they held."""
    rows = read_rows(path, 2, "a time, v and omega", faults)
    held = np.append(np.diff(rows.stamp), 0)
    kept = np.flatnonzero(held > 0)  # of equal stamps the last counts
    if len(kept) == 0:
        raise LogError(f"{path}: commands at one time only: they hold over no interval")
    begin, v, omega = rows.stamp[kept], *rows.values[kept].T
    end = begin + np.minimum(held[kept], round(MAX_HELD_S * 1e9))
    unknown = np.full(len(kept), np.nan)
    odometry, cut = intervals_to_odometry(TwistIntervals(begin, end, v, omega, unknown, unknown))
    notes.append(
        f"{name}: odometry holds commands, each until the next; {cut} of {len(kept)} held so long "
        "that they became several samples"
    )
    return odometry


def _truth(path: Path, faults: Faults) -> Poses:
    rows = read_rows(path, 3, "a time, x, y and heading", faults)
    x, y, heading = rows.values.T
    return Poses(WORLD_FRAME, rows.stamp, rows.stamp, x, y, heading)


def _ranges(
    files: MrclamFiles, subject_of: Mapping[int, int], team: Team, faults: Faults
) -> Ranges:
    """Distances that the cameras measured to robots and landmarks."""
    index = {robot.id: row for row, robot in enumerate(team.robots)}
    by_barcode = {barcode: index[subject] for barcode, subject in subject_of.items()}
    parts = []
    for (kind, number), path in files.items():
        if kind != "Measurement":
            continue
        rows = read_rows(path, 2, "a time, a barcode and a range", faults)
        target = np.array([by_barcode.get(code, -1) for code in rows.values[:, 0].tolist()])
        known = target >= 0
        if not known.all():
            count = int(np.count_nonzero(~known))
            text = f"{count} of {len(known)} measurements show a barcode of nobody; dropped"
            faults.add("barcode", path.name, text, count=count)
        source = np.full(np.count_nonzero(known), index[number])
        raw = rows.values[known, 1]
        parts.append(
            RawRanges(rows.stamp[known], source, target[known], raw, np.full(len(raw), np.nan))
        )
    return sorted_ranges(
        RawRanges(*(np.concatenate(column) for column in zip(*parts, strict=True))),
        len(team.robots),
        faults,
    )
