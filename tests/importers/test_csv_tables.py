from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.importers.csv_tables import csv_files, read_csv_tables

RANGES = "t,source,target,range,sigma\n1.5,R1,A,2.5,0.1\n1.25,R2,R1,3.5,\n2.0,R1,B,4.5,inf\n"
ODOMETRY = "time,v,omega,sigma_v\n1.0,0.5,-0.1,0.02\n1.1,0.6,-0.2,\n"
TRUTH = "timestamp,robot,x,y,heading,z\n1.0,R1,1,2,0.5,9\n1.0,R2,3,4,0.25,9\n1.1,R1,1.5,2,0.5,9\n"
STATIC = "robot,x,y,id\nA,0.5,-0.5,7\nB,,,\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "ranges.csv").write_text(RANGES)
    (tmp_path / "R1.odometry.csv").write_text(ODOMETRY)
    (tmp_path / "truth.csv.gz").write_bytes(gzip.compress(TRUTH.encode(), mtime=0))
    (tmp_path / "static.csv").write_text(STATIC)
    return tmp_path


def test_a_folder_of_tables(folder):
    recording = read_csv_tables((folder,))
    team = recording.team
    assert team.names == ("R1", "R2", "A", "B")
    assert [robot.id for robot in team.robots] == [1, 2, 7, 3]
    assert [robot.static for robot in team.robots] == [False, False, True, True]
    assert [robot.position for robot in team.static] == [(0.5, -0.5), None]
    ranges = recording.ranges
    assert ranges.stamp.tolist() == [1_250_000_000, 1_500_000_000, 2_000_000_000]
    assert ranges.source.tolist() == [1, 0, 0]
    assert ranges.target.tolist() == [0, 2, 3]
    assert ranges.sigma == pytest.approx([np.nan, 0.1, np.nan], nan_ok=True)
    odometry = recording.odometry["R1"]
    assert odometry.v.tolist() == [0.5, 0.6]
    assert odometry.sigma_v == pytest.approx([0.02, np.nan], nan_ok=True)
    assert np.all(np.isnan(odometry.sigma_omega))
    assert recording.truth["R1"].x.tolist() == [1.0, 1.5]
    assert recording.truth["R2"].heading.tolist() == [0.25]
    assert recording.truth["A"].x.tolist() == [0.5, 0.5]
    assert [fault.kind for fault in recording.faults] == ["backwards"]
    assert len(csv_files((folder,))) == 4


def test_bad_rows_are_counted_with_the_first_line(folder):
    (folder / "ranges.csv").write_text(
        RANGES + "x,R1,A,1,1\n3.0,R1,2bad,1,1\n3.0,R1,A\n3.0,R1,A,nan,1\n"
    )
    recording = read_csv_tables((folder,))
    assert len(recording.ranges.stamp) == 3
    found = {fault.kind: (fault.count, fault.text) for fault in recording.faults}
    assert found["row"][0] == 3
    assert (
        "ranges.csv line 5: 3 lines without time, source, target, range; dropped" in found["row"][1]
    )
    assert found["nan"][0] == 1


def test_estimates_by_name(tmp_path):
    (tmp_path / "R1.estimate.csv").write_text("time,x,y,heading\n1,2,3,0.5\n")
    (tmp_path / "R1.csv").write_text("time,x,y\n1,2,3\n")
    recording = read_csv_tables((tmp_path,))
    assert recording.estimate["R1"].heading.tolist() == [0.5]
    assert np.isnan(recording.truth["R1"].heading).all()
    (tmp_path / "R1.estimate.csv").write_text("time,x,y\n1,2,3\n")
    with pytest.raises(LogError, match="the estimate of R1 needs a `heading`"):
        read_csv_tables((tmp_path,))


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("x.csv", "a,b\n1,2\n", r"line 1: its columns \(a, b\) fit no table: time,source,target"),
        ("x.csv", "", "fit no table"),
        ("2x.csv", "time,v,omega\n1,2,3\n", "whose is it"),
        ("R1.csv", "time,v,omega\n2,0,0\n", "a second table of the same kind for R1"),
        ("x.csv", "time,source,target,range\n", "no row with time, source, target, range"),
        ("x.csv", 'time,x,y\n1,"' + "9" * 200_000 + '",3\n', "line 2: not CSV"),
        ("s.csv", "robot,x,y\nA,1,2\n", "A is there twice"),
        ("s.csv", "robot,x,y\nC,1,\n", "C has one of x and y"),
        ("s.csv", "robot,id\nC,1.5\n", "C: 1.5 is no id"),
        ("s.csv", "robot,id\nC,7\n", "two static robots share one id"),
    ],
)
def test_one_line_for_what_does_not_fit(folder, name, text, said):
    (folder / name).write_text(text)
    with pytest.raises(LogError, match=said) as caught:
        read_csv_tables((folder,))
    assert "\n" not in str(caught.value)


def test_whose_by_the_command_line(tmp_path):
    (tmp_path / "2x.csv").write_text("time,v,omega\n1,2,3\n")
    recording = read_csv_tables((Path(f"tb={tmp_path / '2x.csv'}"),))
    assert list(recording.odometry) == ["tb"]
