from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.importers.tum import read_tum, tum_files

LINES = "# t x y z qx qy qz qw\n1.000000001 1 2 3 0 0 0 1\n1.5 1.5 2.5 3 0 0 2 2\n"


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "R1.tum").write_text(LINES)
    (tmp_path / "R2.ground_truth.tum").write_text(LINES.replace("0 0 2 2", "0 0 0 0"))
    (tmp_path / "R1.estimate.tum").write_text(LINES)
    (tmp_path / "notes.txt").write_text("nothing")
    return tmp_path


def test_robots_and_streams_by_name(folder):
    recording = read_tum((folder,))
    assert recording.team.names == ("R1", "R2")
    assert sorted(recording.truth) == ["R1", "R2"]
    assert list(recording.estimate) == ["R1"]
    truth = recording.truth["R1"]
    assert truth.stamp.tolist() == [1_000_000_001, 1_500_000_000]
    assert truth.x.tolist() == [1.0, 1.5]
    assert truth.heading == pytest.approx([0.0, np.pi / 2])
    assert truth.frame == "world"
    assert np.isnan(recording.truth["R2"].heading).tolist() == [False, True]
    assert len(tum_files((folder,))) == 3


def test_a_name_on_the_command_line(folder):
    odd = folder / "2022-01.txt"
    odd.write_text(LINES)
    recording = read_tum((Path(f"tb1={odd}"), folder / "R1.tum"))
    assert recording.team.names == ("R1", "tb1")
    assert tum_files((Path(f"tb1={odd}"),)) == (odd,)
    with pytest.raises(LogError, match="no name of a robot; give it as NAME="):
        read_tum((odd,))


def test_what_does_not_fit(folder):
    with pytest.raises(LogError, match="a second file of R1's ground_truth"):
        read_tum((folder, Path(f"R1={folder / 'R1.tum'}")))
    (folder / "R1.estimate.tum").write_text(LINES.replace("0 0 2 2", "0 0 0 0"))
    with pytest.raises(LogError, match="an estimate needs headings"):
        read_tum((folder,))
    (folder / "R1.tum").write_text("1.0 2 3 4\n")
    with pytest.raises(LogError, match=r"R1\.tum: no line holds a pose"):
        read_tum((folder / "R1.tum",))
    empty = folder / "empty"
    empty.mkdir()
    with pytest.raises(LogError, match=r"no file in it ends in \.tum"):
        read_tum((empty,))


def test_bad_lines_are_counted(folder):
    (folder / "R1.tum").write_text(LINES + "2.0 1 2\n1.5 9 9 9 0 0 0 1\n")
    recording = read_tum((folder / "R1.tum",))
    assert {fault.kind: fault.data_lost for fault in recording.faults} == {
        "row": True,
        "duplicate": False,
    }
    assert recording.truth["R1"].x.tolist() == [1.0, 1.5]
