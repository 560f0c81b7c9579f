"""What is saved is what is loaded."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.core.geometry import wrap_angle
from clt.core.recording import (
    Attachment,
    Innovations,
    Odometry,
    Poses,
    Ranges,
    Recording,
    Robot,
    Team,
    UwbPackets,
)
from clt.log.output import open_output
from clt.log.recording.load import load
from clt.log.recording.save import save

TEAM = Team(
    (
        Robot("A1", 9, static=True, position=(0.5, -1.0)),
        Robot("R1", 1, antenna=(0.1, 0.0), sigma_v=0.2, sigma_omega=0.1),
        Robot("R2", 65535, twist="instant"),
    ),
    range_sigma=0.1,
)


def clock(rng, n):
    """Increasing stamps, and log times after them in the same order."""
    stamp = 10**18 + np.cumsum(rng.integers(1, 10**8, n))
    return stamp, stamp + rng.integers(0, 10**6)


def poses(rng, n, frame, covariance):
    stamp, log_time = clock(rng, n)
    root = rng.normal(size=(n, 3, 3))
    square = root @ root.transpose(0, 2, 1)
    square = (square + square.transpose(0, 2, 1)) / 2
    x, y = rng.normal(0.0, 10.0, (2, n))
    heading = wrap_angle(rng.uniform(-4.0, 4.0, n))
    return Poses(frame, stamp, log_time, x, y, heading, square if covariance else None)


def sigmas(rng, n):
    return np.where(rng.random(n) < 0.3, math.nan, rng.uniform(1e-3, 1.0, n))


@st.composite
def recordings(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, frame = draw(st.integers(1, 30)), draw(st.sampled_from(["world", "mocap", "R1/base_link"]))
    moving = [robot.name for robot in TEAM.moving]
    odometry = {}
    for name in moving:
        v, omega = rng.normal(size=(2, n))
        odometry[name] = Odometry(*clock(rng, n), v, omega, sigmas(rng, n), sigmas(rng, n))
    stamp, log_time = clock(rng, n)
    source = rng.integers(0, 3, n)
    target = (source + rng.integers(1, 3, n)) % 3
    ranges = Ranges(
        stamp, log_time, source, target, *rng.uniform(0.1, 9.0, (2, n)), sigmas(rng, n),
        rng.integers(0, 2**32, n),
    )  # fmt: skip
    carried = rng.random(n) < 0.7
    some = (rng.random((n, 3)) < 0.6) & (source[:, None] != np.arange(3))
    ticks = rng.integers(0, 1 << 40, (n, 3))
    frames = UwbPackets(
        stamp, log_time, source, rng.integers(0, 2**32, n), rng.integers(0, 1 << 40, n),
        np.where(some, ticks, -1), np.where(some, rng.integers(0, 2**32, (n, 3)), -1),
        np.where(carried, ticks[:, 0], -1),
        *(np.where(carried, rng.normal(size=n), np.nan) for _ in range(2)),
    )  # fmt: skip
    residual, sigma, nis = rng.normal(size=n), *rng.uniform(0.1, 1.0, (2, n))
    return Recording(
        TEAM,
        odometry,
        ranges,
        {name: poses(rng, n, frame, covariance=False) for name in moving},
        {name: poses(rng, n, frame, covariance=True) for name in moving},
        {name: poses(rng, n, frame, covariance=True) for name in moving},
        Innovations(stamp, source, target, residual, sigma, nis, rng.random(n) < 0.5),
        attachments=(Attachment("scenario.toml", "application/toml", rng.bytes(n)),),
        frames=frames,
    )


def assert_same(before, after):
    """Every column equal to the bit; headings to rounding, for they travel as quaternions."""
    for field in fields(before):
        mine, theirs = getattr(before, field.name), getattr(after, field.name)
        if field.name == "heading":
            error = np.nan_to_num(wrap_angle(mine - theirs))
            np.testing.assert_allclose(error, 0.0, atol=1e-14)
            np.testing.assert_array_equal(np.isnan(mine), np.isnan(theirs))
        elif field.name == "covariance" and mine is not None:
            np.testing.assert_array_equal(mine, theirs)
        elif isinstance(mine, np.ndarray):
            np.testing.assert_array_equal(mine, theirs, field.name)
        else:
            assert mine == theirs


@pytest.mark.parametrize("scene", [False, True])
@settings(max_examples=20, deadline=None)
@given(recording=recordings())
def test_there_and_back(tmp_path_factory, scene, recording):
    path = tmp_path_factory.mktemp("log") / "a.mcap"
    with open_output(path) as file:
        save(file, recording, {"filter": "eskf", "seed": "7"}, scene=scene)
    again = load(path).recording
    assert repr(again.team) == repr(recording.team)
    assert again.run == {"filter": "eskf", "seed": "7"}
    assert again.attachments == recording.attachments
    assert again.faults == ()
    assert_same(recording.ranges, again.ranges)
    assert_same(recording.innovations, again.innovations)
    for kind in ("odometry", "truth", "estimate", "dead_reckoning"):
        before, after = getattr(recording, kind), getattr(again, kind)
        assert before.keys() == after.keys()
        for name, stream in before.items():
            assert_same(stream, after[name])


def test_an_unknown_heading_stays_unknown(tmp_path):
    track = poses(np.random.default_rng(0), 5, "mocap", covariance=False)
    track = replace(track, heading=np.full(5, math.nan))
    path = tmp_path / "a.mcap"
    with open_output(path) as file:
        save(file, Recording(TEAM, truth={"R1": track}), {})
    assert_same(track, load(path).recording.truth["R1"])
