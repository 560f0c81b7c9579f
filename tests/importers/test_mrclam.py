from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.importers.columns import NOTES_KEY
from clt.importers.mrclam import mrclam_files, read_mrclam
from clt.model.odometry_gaps import odometry_gaps

REAL = Path(__file__).parents[3] / "shared" / "data" / "mrclam6"
HEAD = "# UTIAS\n# Time [s] values\n"
BARCODES = "1 5\n2 14\n6 63\n7 81\n"


@pytest.fixture
def folder(tmp_path):
    """Two robots and two landmarks for 2 s; the first robot's commands pause for 1 s."""
    times = [*np.arange(10, 20) / 10, *np.arange(30, 40) / 10]
    for robot in (1, 2):
        lines = [f"{t:.3f} {0.1 * robot:.3f} -0.2" for t in times]
        write(tmp_path / f"Robot{robot}_Odometry.dat.gz", lines)
        write(
            tmp_path / f"Robot{robot}_Groundtruth.dat",
            [f"{t:.3f} {t} {-t} {0.1 * t}" for t in times],
        )
    write(tmp_path / "Robot1_Measurement.dat", ["1.5 14 3.5 0.1", "1.5 63 2.5 0.2", "2.5 99 1 0"])
    write(tmp_path / "Robot2_Measurement.dat", ["1.6 81 4.5 0.1", "1.7 14 1.0 0.0"])
    write(tmp_path / "Barcodes.dat", BARCODES.splitlines())
    write(tmp_path / "Landmark_Groundtruth.dat", ["6 1.5 -2.5 0.001 0.001", "7 3 4 0.001 0.001"])
    return tmp_path


def write(path, lines):
    data = (HEAD + "\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


def test_team_and_streams(folder):
    recording = read_mrclam(folder)
    team = recording.team
    assert team.names == ("R1", "R2", "L6", "L7")
    assert [robot.id for robot in team.robots] == [1, 2, 6, 7]
    assert [robot.static for robot in team.robots] == [False, False, True, True]
    assert team.robots[2].position == (1.5, -2.5)
    assert np.isnan(team.robots[0].sigma_v)
    assert np.isnan(team.range_sigma)
    assert recording.truth["R1"].heading == pytest.approx(0.1 * recording.truth["R1"].x)
    assert recording.truth["L7"].x.tolist() == [3.0, 3.0]
    assert recording.truth["L7"].stamp.tolist() == [10**9, 3_900_000_000]


def test_commands_hold_until_the_next(folder):
    odometry = read_mrclam(folder).odometry["R2"]
    assert odometry.stamp[0] == 1_100_000_000
    assert odometry.stamp[-1] == 3_900_000_000
    assert not odometry_gaps(odometry.stamp).any()
    assert np.diff(odometry.stamp).tolist() == pytest.approx([10**8] * 28, abs=1)
    assert odometry.v == pytest.approx(0.2)


def test_a_command_holds_two_seconds_at_most(folder):
    write(
        folder / "Robot1_Odometry.dat.gz",
        ["1.0 0.1 0", "1.1 0.1 0", "1.2 0.1 0", "9.0 0.3 0", "9.1 0.3 0"],
    )
    odometry = read_mrclam(folder).odometry["R1"]
    assert odometry.stamp[odometry.v < 0.2][-1] == 3_200_000_000
    assert odometry.stamp[odometry.v > 0.2].tolist() == [9_100_000_000]


def test_of_commands_at_one_time_the_last_counts(folder):
    write(folder / "Robot1_Odometry.dat.gz", ["1.0 0.1 0", "1.1 0.2 0", "1.1 0.3 0", "1.2 0.4 0"])
    odometry = read_mrclam(folder).odometry["R1"]
    assert odometry.v.tolist() == [0.1, 0.3]


def test_ranges_by_barcode(folder):
    recording = read_mrclam(folder)
    ranges = recording.ranges
    assert list(zip(ranges.source, ranges.target, ranges.raw, strict=True)) == [
        (0, 1, 3.5),
        (0, 2, 2.5),
        (1, 3, 4.5),
    ]
    assert np.all(np.isnan(ranges.sigma))
    found = {fault.kind: (fault.count, fault.data_lost) for fault in recording.faults}
    assert found == {"barcode": (1, False), "self": (1, True)}
    notes = json.loads(recording.run[NOTES_KEY])
    assert notes[0] == "bearings of the cameras were left out"
    assert notes[1].startswith("R1: odometry holds commands, each until the next; 1 of 19 held")


def test_without_a_reference(folder):
    for file in folder.glob("*Groundtruth*"):
        file.unlink()
    recording = read_mrclam(folder)
    assert recording.truth == {}
    assert recording.team.robots[2].position is None


@pytest.mark.parametrize(
    ("name", "lines", "said"),
    [
        ("Barcodes.dat", ["1 5", "x 6"], "Barcodes.dat: line 4: not a subject and its barcode"),
        ("Barcodes.dat", ["1 5", "2 5"], "line 4: subject or barcode is there twice"),
        ("Landmark_Groundtruth.dat", ["6 1.5"], "line 3: not a subject and its position"),
        ("Landmark_Groundtruth.dat", ["6 1.5 nan"], "line 3: not a subject and its position"),
        ("Robot1_Odometry.dat.gz", ["1.0 0.1"], "no line holds a time, v and omega"),
        ("Robot1_Odometry.dat.gz", ["1.0 0.1 0.2"], "commands at one time only"),
        ("Robot1_Measurement.dat", [], "no line holds a time, a barcode and a range"),
    ],
)
def test_one_line_for_what_does_not_fit(folder, name, lines, said):
    write(folder / name, lines)
    with pytest.raises(LogError, match=said) as caught:
        read_mrclam(folder)
    assert "\n" not in str(caught.value)


def test_what_is_no_folder_of_it(folder, tmp_path_factory):
    empty = tmp_path_factory.mktemp("empty")
    with pytest.raises(LogError, match=r"no Barcodes\.dat in it; give the folder"):
        mrclam_files(empty)
    with pytest.raises(LogError, match="No such file"):
        mrclam_files(empty / "nowhere")
    for file in folder.glob("*Measurement*"):
        file.unlink()
    with pytest.raises(LogError, match="there are no ranges"):
        mrclam_files(folder)


def test_the_real_files_are_found():
    if not REAL.is_dir():
        pytest.skip("MRCLAM 6 is not here")
    assert len(mrclam_files(REAL)) == 17
