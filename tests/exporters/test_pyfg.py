"""The graph against the format's description and against our own strict importer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.geometry import relative_pose
from clt.core.recording import Robot
from clt.exporters import EXPORT_FORMATS
from clt.exporters.pyfg import ROBOT_LETTERS
from clt.importers.pyfg import read_pyfg

NUMBERS = {"VERTEX_SE2": (2, 3), "VERTEX_XY": (1, 2), "EDGE_SE2": (3, 9), "EDGE_RANGE": (3, 2)}
"""Words (time, names) and numbers of each kind of line, as PyFactorGraph documents them."""


def graph(recording):
    export = EXPORT_FORMATS["pyfg"].write(recording, "log")
    (one,) = export.files
    text = one.make().decode()
    assert len(text.splitlines()) == one.rows
    return text, export.diagnostics


def back(recording, tmp_path):
    (tmp_path / "a.pyfg").write_text(graph(recording)[0])
    return read_pyfg(tmp_path / "a.pyfg")


def with_team(recording, change):
    robots = tuple(map(change, recording.team.robots))
    return replace(recording, team=replace(recording.team, robots=robots))


def test_every_line_is_one_of_the_format(measured):
    text, said = graph(measured)
    assert said == ()
    kinds = {}
    for line in text.splitlines():
        kind, *words = line.split()
        names, numbers = NUMBERS[kind]
        assert len(words) == names + numbers
        assert np.isfinite([float(word) for word in words[names:]]).all()
        kinds[kind] = kinds.get(kind, 0) + 1
    assert kinds == {"VERTEX_SE2": 202, "VERTEX_XY": 2, "EDGE_SE2": 200, "EDGE_RANGE": 303}
    assert text.startswith("VERTEX_SE2 1700000000.123456789 A0 0.0 0.0 0.0\n")


def test_our_importer_gives_the_log_back(measured, tmp_path):
    found = back(measured, tmp_path)
    assert found.team.names == ("A", "B", "L0", "L1")
    assert found.team.robots[3].position == (6.0, 0.0)
    assert np.array_equal(found.ranges.stamp, measured.ranges.stamp)
    assert found.ranges.range == pytest.approx(measured.ranges.range, abs=0.0)
    assert found.ranges.sigma == pytest.approx(0.1)
    given = measured.odometry["R2"]
    odometry = found.odometry["B"]
    assert np.array_equal(odometry.stamp, given.stamp[1:])
    assert odometry.v == pytest.approx(given.v[1:], rel=1e-9)
    assert odometry.omega == pytest.approx(given.omega[1:], rel=1e-9)
    assert odometry.sigma_v == pytest.approx(0.05)
    assert odometry.sigma_omega == pytest.approx(0.02)
    assert found.truth["B"].heading == pytest.approx(measured.truth["R2"].heading)


def test_the_edges_join_the_vertices(measured):
    """The truth follows the odometry, so that every step is the one between its vertices."""
    poses, steps = {}, []
    for line in graph(measured)[0].splitlines():
        kind, *words = line.split()
        if kind == "VERTEX_SE2":
            poses[words[1]] = np.array(words[2:], float)
        elif kind == "EDGE_SE2":
            steps.append((words[1], words[2], np.array(words[3:6], float)))
    for begin, end, step in steps:
        between = relative_pose(poses[begin][None], poses[end][None])[0]
        assert step == pytest.approx(between, abs=1e-9)


def test_what_nothing_states_is_assumed_and_said(measured, tmp_path):
    n = 101
    bare = {
        name: replace(one, sigma_v=np.full(n, np.nan), sigma_omega=np.full(n, np.nan))
        for name, one in measured.odometry.items()
    }
    ranges = replace(measured.ranges, sigma=np.full(3 * n, np.nan))
    silent = replace(measured, odometry=bare, ranges=ranges)
    kinds = [one.kind for one in graph(silent)[1]]
    assert sorted(kinds) == [
        "graph_odometry_noise_assumed", "graph_odometry_noise_assumed", "graph_range_noise_assumed",
    ]  # fmt: skip
    assert back(silent, tmp_path).odometry["A"].sigma_v == pytest.approx(0.1)
    stated = with_team(silent, lambda robot: replace(robot, sigma_v=0.3, sigma_omega=0.2))
    stated = replace(stated, team=replace(stated.team, range_sigma=0.4))
    assert graph(stated)[1] == ()
    found = back(stated, tmp_path)
    assert found.odometry["A"].sigma_v == pytest.approx(0.3)
    assert found.ranges.sigma == pytest.approx(0.4)


def test_without_truth_the_vertices_are_the_odometry(measured, tmp_path):
    recording = replace(measured, truth={})
    assert {(one.kind, one.severity) for one in graph(recording)[1]} == {
        ("graph_from_odometry", "information")
    }
    found = back(recording, tmp_path)
    assert found.truth["A"].x == pytest.approx(measured.truth["R1"].x, abs=1e-6)
    assert found.truth["B"].x + 3.0 == pytest.approx(measured.truth["R2"].x, abs=1e-6)


def test_a_static_robot_that_stands_nobody_knows_where_costs_its_ranges(measured):
    unknown = with_team(measured, lambda r: replace(r, position=None) if r.name == "A2" else r)
    unknown = replace(unknown, truth={k: v for k, v in unknown.truth.items() if k != "A2"})
    text, (said,) = graph(unknown)
    assert (said.kind, said.severity, said.subject) == ("not_in_graph", "partial", "A2, R2")
    assert (said.values["count"], text.count("EDGE_RANGE")) == (101, 202)


def test_what_lies_outside_the_truth_is_left_out(measured):
    short = {
        name: replace(
            poses, stamp=poses.stamp[:51], x=poses.x[:51], y=poses.y[:51],
            heading=poses.heading[:51],
        )
        for name, poses in measured.truth.items()
    }  # fmt: skip
    text, said = graph(replace(measured, truth=short))
    assert [one.kind for one in said] == ["graph_cut", "graph_cut", "not_in_graph"]
    assert text.count("VERTEX_SE2") == 102
    assert said[0].values == {"count": 50, "total": 101}
    # So do ranges more than half a second behind the last pose, which is that of row 50.
    last = measured.odometry["R1"].stamp[50]
    kept = np.count_nonzero(measured.ranges.stamp - last <= 500_000_000)
    assert text.count("EDGE_RANGE") == kept == 182


def test_logs_that_hold_no_graph_are_refused(measured, synthetic):
    write = EXPORT_FORMATS["pyfg"].write
    with pytest.raises(CltError, match="export the log that was localized"):
        write(synthetic(n=20), "log")
    with pytest.raises(CltError, match="no odometry in this log"):
        write(replace(measured, odometry={}), "log")
    none = np.flatnonzero(np.zeros(1))
    empty = {name: column[none] for name, column in vars(measured.ranges).items()}
    with pytest.raises(CltError, match="no ranges in this log"):
        write(replace(measured, ranges=type(measured.ranges)(**empty)), "log")
    names = [f"M{k}" for k in range(len(ROBOT_LETTERS) + 1)]
    team = replace(measured.team, robots=tuple(Robot(n, k) for k, n in enumerate(names, 1)))
    many = replace(measured, team=team, odometry=dict.fromkeys(names, measured.odometry["R1"]))
    with pytest.raises(CltError, match="51 robots move; a PyFG file has letters for 50"):
        write(many, "log")
