"""Logs that are wrong in one way end with a line that says so; matched ones do not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from clt.estimation import estimators
from clt.estimation.estimators import Estimator
from clt.initialization.given.truth import from_truth
from clt.model.choices import parse_frame_spec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from tests.messages import failings


@pytest.fixture(scope="module")
def matched():
    """Thirty seconds of three moving robots among two surveyed ones: R3, R4, R5; R1, R2."""
    return simulate(load_scenario("shi-sim", {"seed": 7, "duration": 30.0}))


def localized(recording, *, filter_="eskf", frame="world", **settings):
    """What is said to be wrong with a run from the truth: the lines that end with exit code 3."""
    chosen = FilterSettings.model_validate({"gate": 16.0, **settings})
    start = from_truth(recording, chosen.initial.sigma)
    estimator = Estimator(filter_, parse_frame_spec(frame))
    posterior = estimators.localize_recording(recording, start, chosen, estimator)
    return [line for line in failings(posterior) if "covariances are too small" in line]


def between(recording, *names):
    """Rows of the ranges that touch one robot, or that two have with each other."""
    ranges, wanted = recording.ranges, [recording.team.index(name) for name in names]
    touched = [(ranges.source == i) | (ranges.target == i) for i in wanted]
    return np.all(touched, axis=0)


def ranged(recording, values):
    return replace(recording, ranges=replace(recording.ranges, range=values))


def longer(recording, by, *names, gain=1.0):
    values = recording.ranges.range
    return ranged(recording, np.where(between(recording, *names), gain * values + by, values))


def surveyed(recording, **places):
    """The static robots at other stated positions."""
    robots = tuple(
        replace(robot, position=places.get(robot.name, robot.position))
        for robot in recording.team.robots
    )
    return replace(recording, team=replace(recording.team, robots=robots))


def late(recording, seconds, *names):
    odometry = {
        name: replace(stream, stamp=stream.stamp + round(seconds * 1e9) * (name in names))
        for name, stream in recording.odometry.items()
    }
    return replace(recording, odometry=odometry)


def ahead(recording, name, seconds):
    """The clock of a robot wrong: stamps of its odometry and of the ranges that it measured."""
    ranges = recording.ranges
    own = ranges.source == recording.team.index(name)
    stamp = ranges.stamp + round(seconds * 1e9) * own
    order = np.argsort(stamp, kind="stable")
    columns = {
        column: getattr(ranges, column)[order] for column in vars(ranges) if column != "stamp"
    }
    moved = replace(recording, ranges=replace(ranges, stamp=stamp[order], **columns))
    return late(moved, seconds, name)


def frozen(recording, *names):
    """The ranges of a pair all the same from a third on."""
    rows = np.flatnonzero(between(recording, *names))
    stuck = rows[rows.size // 3 :]
    values = recording.ranges.range.copy()
    values[stuck] = values[stuck[0]]
    return ranged(recording, values)


def interchanged(recording, one, other):
    """Two robots under each other's ids."""
    a, b = recording.team.index(one), recording.team.index(other)
    ids = np.arange(len(recording.team.robots))
    ids[[a, b]] = b, a
    ranges = recording.ranges
    ranges = replace(ranges, source=ids[ranges.source], target=ids[ranges.target])
    return replace(recording, ranges=ranges)


def turned(recording, name, *, scale=1.0, bias=0.0):
    stream = recording.odometry[name]
    odometry = {**recording.odometry, name: replace(stream, omega=scale * stream.omega + bias)}
    return replace(recording, odometry=odometry)


def noisier(recording, factor):
    ranges, rng = recording.ranges, np.random.default_rng(1)
    more = 0.1 * np.sqrt(factor**2 - 1.0) * rng.normal(size=ranges.range.size)
    return ranged(recording, ranges.range + more)


ALL = ("R3", "R4", "R5")
WRONG = {
    "offset": (lambda r: longer(r, 0.5), "all ranges are 0.4[0-9] m too long: calibrate"),
    "offset of one": (
        lambda r: longer(r, -0.3, "R3"),
        "the ranges of R3 are 0.[23][0-9] m too short",
    ),
    "offset of a pair": (lambda r: longer(r, 0.3, "R1", "R3"), "ranges R1-R3 are 0.[23][0-9] m"),
    "gain": (lambda r: longer(r, 0.0, gain=1.05), "all ranges are [45].[0-9] % too long"),
    "anchor": (
        lambda r: surveyed(r, R1=(0.6, 0.8)),
        "R1 stands about [01].[0-9]+ m from its stated",
    ),
    "near anchor": (lambda r: surveyed(r, R1=(0.2, 0.2)), "R1 stands about 0.[23][0-9] m from its"),
    "anchors": (
        lambda r: surveyed(r, R1=(12.0, 0.0), R2=(0.0, 0.0)),
        "R1 and R2 are interchanged: check their ids",
    ),
    "ids": (lambda r: interchanged(r, "R3", "R5"), "R3 and R5 are interchanged"),
    "clock": (lambda r: ahead(r, "R3", 1.0), "the clock of R3 is about 1.00 s ahead"),
    "clock a little": (
        lambda r: ahead(r, "R3", 0.2),
        "the clock of R3 is about 0.[12][0-9] s ahead",
    ),
    "late": (lambda r: late(r, 0.5, *ALL), "all odometry is stamped about 0.[45][0-9] s too late"),
    "a little late": (lambda r: late(r, 0.2, *ALL), "all odometry is stamped about 0.[12][0-9] s"),
    "frozen": (lambda r: frozen(r, "R3", "R4"), "the ranges R3-R4 are frozen"),
    "frozen anchor": (lambda r: frozen(r, "R1", "R4"), "the ranges R1-R4 are frozen"),
    "noise": (lambda r: noisier(r, 2.0), "noise of the ranges is about 2 times what is stated"),
    "sign": (lambda r: turned(r, "R4", scale=-1.0), "the turn rate of R4 has the wrong sign"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_named(matched, name):
    change, expected = WRONG[name]
    lines = localized(change(matched))
    assert len(lines) == 1
    assert "\n" not in lines[0]
    assert len(lines[0]) < 600
    assert re.search(expected, lines[0]), lines[0]


@pytest.mark.parametrize("filter_", ["eskf", "ekf"])
def test_matched_sensors_fit(matched, filter_):
    assert localized(matched, filter_=filter_) == []


@pytest.fixture(scope="module")
def crossing():
    """Two cars, ten seconds: few ranges, for filters that are slow."""
    return simulate(load_scenario("araki-left-turns", {"seed": 3}))


@pytest.mark.parametrize("filter_", ["eskf", "mixture"])
def test_relative_poses(crossing, filter_):
    chosen = {"filter_": filter_, "frame": "ego:car1"}
    assert localized(crossing, **chosen) == []
    (line,) = localized(frozen(crossing, "car1", "car2"), **chosen)
    assert "the ranges car1-car2 are frozen" in line


def test_a_quarter_of_a_pairs_ranges_rejected_is_a_misfit(matched):
    rows = np.flatnonzero(between(matched, "R2", "R5"))
    values = matched.ranges.range.copy()
    values[rows[::3]] += 5.0
    (line,) = localized(ranged(matched, values))
    assert "R2-R5: 33 % of 600 rejected" in line
    values[rows[::3]] -= 5.0
    values[rows[::6]] += 5.0
    assert localized(ranged(matched, values)) == []


def test_larger_noise_as_stated_fits(matched):
    assert localized(noisier(matched, 2.0), noise={"sigma_range": 0.2}) == []


def test_robots_that_stand_may_repeat_their_ranges(matched):
    """Coarse radios repeat themselves; that is no freezing while nobody moves."""
    recording = simulate(load_scenario("shi-three", {"seed": 3, "duration": 6.0}))
    values = np.round(recording.ranges.range, 0)
    lines = localized(ranged(recording, values), noise={"sigma_range": 0.5})
    assert not any("frozen" in line for line in lines)
