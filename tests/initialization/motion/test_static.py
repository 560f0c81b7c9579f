from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.errors import CltError
from clt.core.recording import Ranges, Recording, Robot, Team
from clt.initialization.motion import realizations
from clt.initialization.motion.frame import survey_frames
from clt.initialization.motion.motion import from_motion
from clt.initialization.motion.static import MIRROR_UNDECIDED
from clt.log.recording.save import save
from clt.model.settings import FilterSettings

PLACES = np.array([[0.0, 0.0], [2.0, 0.0], [0.5, 1.5], [1.5, 1.0]])


def standing(
    positions: dict[int, tuple[float, float]], lost: tuple[tuple[int, int], ...] = ()
) -> Recording:
    """Four static robots, 50 ranges per pair with 1 cm of noise; those of `lost` pairs missing."""
    pairs = [pair for pair in combinations(range(4), 2) if pair not in lost]
    a, b = np.tile(np.array(pairs, np.int64), (50, 1)).T
    stamp = np.arange(1, a.size + 1, dtype=np.int64) * 10_000_000
    distance = np.hypot(*(PLACES[a] - PLACES[b]).T)
    distance += np.random.default_rng(5).normal(scale=0.01, size=a.size)
    unknown = np.full(a.size, np.nan)
    ranges = Ranges(stamp, stamp, a, b, distance, distance, unknown, np.arange(a.size))
    robots = [Robot(f"R{i}", i, static=True, position=positions.get(i)) for i in range(4)]
    return Recording(Team(tuple(robots), range_sigma=0.01), ranges=ranges)


def test_shis_frame() -> None:
    found = from_motion(standing({}), FilterSettings())
    assert not found.surveyed
    assert MIRROR_UNDECIDED in found.notes
    for place, robot in zip(PLACES, found.robots.values(), strict=True):
        assert robot.status == "ok"
        assert robot.pose is not None
        assert robot.pose.mean[:2] == pytest.approx(place, abs=0.01)
        assert robot.pose.covariance.diagonal().max() < 0.01**2


def test_known_positions_hold_the_frame() -> None:
    shifted = {i: (float(x) + 5.0, float(y) - 3.0) for i, (x, y) in enumerate(PLACES[:3])}
    found = from_motion(standing(shifted), FilterSettings())
    assert found.surveyed
    assert MIRROR_UNDECIDED not in found.notes
    last = found.robots["R3"].pose
    assert last is not None
    assert last.mean[:2] == pytest.approx([6.5, -2.0], abs=0.01)
    assert found.frame == "world"


def test_known_positions_name_the_frame() -> None:
    """One that is built from the ranges is no surveyed one, whatever that is called."""
    known = {i: (float(x), float(y)) for i, (x, y) in enumerate(PLACES[:3])}
    for positions, frame in ((known, "map"), ({}, "world")):
        recording = standing(positions)
        recording = replace(recording, team=replace(recording.team, frame="map"))
        assert from_motion(recording, FilterSettings()).frame == frame


def test_beside_the_line_of_two_known_robots_a_place_is_ambiguous() -> None:
    shifted = {i: (float(x) + 5.0, float(y) - 3.0) for i, (x, y) in enumerate(PLACES[:2])}
    found = from_motion(standing(shifted), FilterSettings())
    assert MIRROR_UNDECIDED in found.notes
    assert [robot.status for robot in found.robots.values()] == ["ok", "ok"] + 2 * ["ambiguous"]
    for name, (x, y) in zip(("R2", "R3"), PLACES[2:], strict=True):
        robot = found.robots[name]
        assert robot.pose is not None
        sides = [robot.pose.mean[:2], robot.alternatives[0].mean[:2]]
        sides.sort(key=lambda side: -float(side[1]))
        assert sides[0] == pytest.approx([x + 5.0, y - 3.0], abs=0.01)
        assert sides[1] == pytest.approx([x + 5.0, -y - 3.0], abs=0.01)
        assert robot.probability == robot.alternatives[0].probability == 0.5
    assert set(found.start.poses) == {"R0", "R1"}


def test_too_few_ranges() -> None:
    found = from_motion(standing({}, lost=((0, 3), (1, 3))), FilterSettings())
    assert [robot.status for robot in found.robots.values()] == ["ok", "ok", "ok", "unobservable"]
    assert found.robots["R3"].why == "too few ranges to place it"


def test_no_ranges() -> None:
    with pytest.raises(CltError, match="nothing to lay out"):
        from_motion(Recording(standing({}).team), FilterSettings())


def test_command_needs_no_odometry(tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    with log.open("wb") as file:
        save(file, standing({}), {})
    result = CliRunner().invoke(app, ["init", str(log), "--method", "motion"])
    assert result.exit_code == 0
    assert [line.split()[0] for line in result.stdout.splitlines()] == [
        "robot",
        "R0",
        "R1",
        "R2",
        "R3",
    ]
    refused = CliRunner().invoke(app, ["localize", str(log), "-o", str(tmp_path / "out.mcap")])
    assert refused.exit_code == 1
    assert "no odometry found" in refused.stderr


def test_the_mirror_image_of_a_layout_has_the_mirrored_covariance() -> None:
    recording = standing({}, lost=((2, 3),))
    found = survey_frames(recording, 0, 0, [], FilterSettings())
    assert len(found.frames) == 4
    one, other = found.frames[:2]
    flip = np.diag([1.0, -1.0])
    for name in ("R2", "R3"):
        assert other.anchors[name] == pytest.approx(flip @ one.anchors[name])
        assert other.covariance[name] == pytest.approx(flip @ one.covariance[name] @ flip)
        assert abs(one.covariance[name][0, 1]) > 1e-9


def test_nobody_is_sure_where_not_all_layouts_were_looked_for(monkeypatch) -> None:
    monkeypatch.setattr(realizations, "WORK", 0)
    recording = standing({}, ((2, 3),))
    found = from_motion(recording, FilterSettings())
    assert {robot.status for name, robot in found.robots.items() if name in {"R1", "R2"}} == {
        "ambiguous"
    }
    assert found.robots["R1"].why == realizations.UNSEARCHED
    begun = survey_frames(recording, 0, 0, [], FilterSettings())
    assert (begun.frames, begun.why) == ((), realizations.UNSEARCHED)
