from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.importers.columns import NOTES_KEY
from clt.importers.pyfg import read_pyfg
from clt.model.odometry_gaps import odometry_gaps

REAL = Path(__file__).parents[3] / "shared" / "data" / "pyfg_samples"
DRIFT = 2.0 * np.pi
"""What is added to a turn as the published files have it."""


def graph(extra=()):
    """Robots A (on +x at 1 m/s, 10 Hz) and B (standing), landmark L0."""
    out = []
    for k in range(21):
        out.append(f"VERTEX_SE2 {100 + k / 10:.9f} A{k} {k / 10} 0 0")
        out.append(f"VERTEX_SE2 {100 + k / 10:.9f} B{k} 5 1 {2.5 + DRIFT}")
    out.append("VERTEX_XY L0 3.5 -4.5")
    for k in range(20):
        t = f"{100.1 + k / 10:.9f}"
        turn = DRIFT if k == 3 else 0.0
        out.append(f"EDGE_SE2 {t} A{k} A{k + 1} 0.1 0 {turn} 0.01 0 0 0.01 0 0.0004")
        out.append(f"EDGE_SE2 {t} B{k} B{k + 1} 0 0 0 0 0 0 0 0 0")
    out.append("EDGE_RANGE 100.020000000 A0 B0 5.1 0.04")
    out.append("EDGE_RANGE 100.100000000 A1 L0 5.6 0.09")
    out.append("EDGE_RANGE 110.000000000 A2 L0 5.5 0")
    out.append("EDGE_SE2_XY 100.300000000 A3 L0 3 -4 0.01 0 0.04")
    return [*out, *extra]


def written(tmp_path, lines):
    path = tmp_path / "graph.pyfg"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_team_and_truth(tmp_path):
    recording = read_pyfg(written(tmp_path, graph()))
    team = recording.team
    assert team.names == ("A", "B", "L0")
    assert [robot.static for robot in team.robots] == [False, False, True]
    assert team.robots[2].position == (3.5, -4.5)
    assert recording.truth["A"].x == pytest.approx(np.arange(21) / 10)
    assert recording.truth["B"].heading == pytest.approx(2.5)
    assert recording.truth["L0"].y.tolist() == [-4.5, -4.5]


def test_odometry_with_stated_noise(tmp_path):
    recording = read_pyfg(written(tmp_path, graph()))
    a, b = recording.odometry["A"], recording.odometry["B"]
    assert a.stamp.tolist() == [100_100_000_000 + 10**8 * k for k in range(20)]
    assert a.v == pytest.approx(1.0)
    assert a.omega == pytest.approx(0.0, abs=1e-12)
    assert a.sigma_v == pytest.approx(1.0)
    assert a.sigma_omega == pytest.approx(0.2)
    assert np.all(b.v == 0.0)
    assert np.all(np.isnan(b.sigma_v))
    assert "A: 1 of 20 turns beyond pi were wrapped" in json.loads(recording.run[NOTES_KEY])


def test_ranges_keep_the_stamps_of_their_edges(tmp_path):
    recording = read_pyfg(written(tmp_path, graph()))
    ranges = recording.ranges
    assert ranges.stamp.tolist() == [
        100_020_000_000,
        100_100_000_000,
        100_200_000_000,
        100_300_000_000,
    ]
    assert ranges.source.tolist() == [0, 0, 0, 0]
    assert ranges.target.tolist() == [1, 2, 2, 2]
    assert ranges.raw == pytest.approx([5.1, 5.6, 5.5, 5.0])
    across = np.sqrt(0.36 * 0.01 + 0.64 * 0.04)
    assert ranges.sigma == pytest.approx([0.2, 0.3, np.nan, across], nan_ok=True)
    notes = json.loads(recording.run[NOTES_KEY])
    assert "1 ranges keep the stamp of their edge, up to 0.020 s off that of their pose" in notes
    assert any(note.startswith("1 ranges took the stamp of their pose") for note in notes)
    assert "1 relative positions (EDGE_SE2_XY) became their distances" in notes


def test_a_long_step_is_no_gap(tmp_path):
    extra = [
        "VERTEX_SE2 120.000000000 A21 10 0 0",
        "EDGE_SE2 120.000000000 A20 A21 9 0 0 0.01 0 0 0.01 0 0.0004",
    ]
    odometry = read_pyfg(written(tmp_path, graph(extra))).odometry["A"]
    assert not odometry_gaps(odometry.stamp).any()
    late = odometry.stamp > 102_000_000_000
    assert odometry.v[late] == pytest.approx(0.5)
    assert odometry.stamp[-1] == 120_000_000_000


def test_loops_and_priors_are_left_out(tmp_path):
    extra = [
        "EDGE_SE2 101.0 A5 A9 1 1 1 0.01 0 0 0.01 0 0.0004",
        "EDGE_SE2 101.0 A5 B9 1 1 1 0.01 0 0 0.01 0 0.0004",
        "VERTEX_SE2:PRIOR 100.0 A0 0 0 0 1 0 0 1 0 1",
    ]
    plain, recording = (read_pyfg(written(tmp_path, graph(more))) for more in ((), extra))
    assert recording.odometry["A"].v.tolist() == plain.odometry["A"].v.tolist()
    notes = json.loads(recording.run[NOTES_KEY])
    assert "A: 2 relative poses are loops or lead to other robots: left out" in notes
    assert "1 lines VERTEX_SE2:PRIOR were left out" in notes


def test_a_missing_edge_is_a_gap(tmp_path):
    lines = [line for line in graph() if " A7 A8 " not in line and " A8 A9 " not in line]
    recording = read_pyfg(written(tmp_path, lines))
    assert odometry_gaps(recording.odometry["A"].stamp).sum() == 1
    assert "A: 2 of 18 steps have no edge" in json.loads(recording.run[NOTES_KEY])


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("VERTEX_SE3:QUAT 1 A9 0 0 0 0 0 0 1", "line 88: VERTEX_SE3:QUAT is three-dimensional"),
        ("HELLO 1 2", "line 88: `HELLO` is no line of PyFG that clt reads"),
        ("EDGE_RANGE 100.0 A1 B1 5.0", "line 88: EDGE_RANGE without a time"),
        ("EDGE_RANGE x A1 B1 5.0 0.1", "line 88: EDGE_RANGE without a time"),
        ("EDGE_RANGE 1.0 A1 B1 nan 0.1", "line 88: EDGE_RANGE without a time"),
        ("EDGE_RANGE", "line 88: EDGE_RANGE without a time"),
        ("VERTEX_XY L1 1", "line 88: VERTEX_XY without its names and 2 finite numbers"),
        ("EDGE_RANGE 100.0 A1 C1 5.0 0.1", "line 88: C1 has no vertex"),
        ("EDGE_SE2 100 A1 L0 1 0 0 1 0 0 1 0 1", "line 88: EDGE_SE2 to or from a landmark"),
        ("VERTEX_SE2 1 A1 0 0 0", "line 88: A1 is there twice"),
        ("VERTEX_XY 12 0 0", "line 88: 12 is there twice, or no letters and a number"),
        ("VERTEX_SE2 100.0 A99 0 0 0", "robot A has two poses at 100.000 s"),
    ],
)
def test_one_line_for_what_does_not_fit(tmp_path, line, said):
    with pytest.raises(LogError, match=said) as caught:
        read_pyfg(written(tmp_path, graph([line])))
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_poses_or_no_ranges(tmp_path):
    with pytest.raises(LogError, match="no VERTEX_SE2 in it"):
        read_pyfg(written(tmp_path, ["VERTEX_XY L0 0 0"]))
    with pytest.raises(LogError, match="there are no ranges"):
        read_pyfg(written(tmp_path, ["VERTEX_SE2 1 A0 0 0 0"]))


@pytest.mark.parametrize(("name", "ranges"), [("plaza2", 1807), ("mrclam5a", 1443)])
def test_the_real_graphs(name, ranges):
    path = REAL / f"{name}.pyfg.gz"
    if not path.is_file():
        pytest.skip("the PyFG samples are not here")
    recording = read_pyfg(path)
    assert recording.faults == ()
    assert len(recording.ranges.stamp) == ranges
    for robot, odometry in recording.odometry.items():
        assert not odometry_gaps(odometry.stamp).any()
        truth = recording.truth[robot]
        begin = np.append(truth.stamp[0], odometry.stamp[:-1])
        turn = np.sum(odometry.omega * (odometry.stamp - begin) * 1e-9)
        expected = sum_of_turns(path, robot)
        assert wrap_angle(np.array([turn - expected]))[0] == pytest.approx(0.0, abs=1e-6)
        assert odometry.stamp[-1] == truth.stamp[-1]


def sum_of_turns(path, robot):
    with gzip.open(path, "rt") as file:
        rows = [line.split() for line in file if line.startswith("EDGE_SE2 ")]
    return sum(float(words[6]) for words in rows if words[2][0] == robot)
