from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.recording import Poses, Recording, Robot, Team
from clt.metrics.reference import assign_reference, shift_poses, with_reference
from clt.metrics.time_offset import _signals, estimate_time_offset

SECOND = 1_000_000_000


def path(rate=20.0, seconds=60.0, seed=1, start=100.0):
    """A drive at a speed and a turn rate that change every 3 s; its times need no grid."""
    random = np.random.default_rng(seed)
    fine = np.arange(0.0, seconds, 0.01)
    knots = np.arange(0.0, seconds + 3.0, 3.0)
    v = np.interp(fine, knots, random.uniform(0.0, 1.0, len(knots)))
    omega = np.interp(fine, knots, random.uniform(-0.8, 0.8, len(knots)))
    heading = np.cumsum(omega) * 0.01
    x, y = np.cumsum(v * np.cos(heading)) * 0.01, np.cumsum(v * np.sin(heading)) * 0.01
    t = np.arange(0.0, seconds - 0.02, 1.0 / rate)
    stamp = np.rint((start + t) * 1e9).astype(np.int64)
    return Poses("world", stamp, stamp, *(np.interp(t, fine, c) for c in (x, y, heading)))


def seen_from_elsewhere(poses, seed=2, noise=0.01):
    """The same drive in another frame, with noise."""
    random = np.random.default_rng(seed)
    c, s = np.cos(1.0), np.sin(1.0)
    x, y = c * poses.x - s * poses.y + 5.0, s * poses.x + c * poses.y - 3.0
    x, y = x + noise * random.normal(size=len(x)), y + noise * random.normal(size=len(y))
    return replace(poses, frame="vicon", x=x, y=y, heading=poses.heading + 1.0)


@pytest.mark.parametrize("offset", [0.0, 0.237, -12.5, 1_650_000_000.125])
@pytest.mark.parametrize("rate", [100.0, 10.0])
def test_the_offset_is_found(offset, rate):
    """Of a reference that counts from 1970 the offset is negative: logs begin at 100 s here."""
    tracks = {name: path(seed=seed) for name, seed in (("R1", 1), ("R2", 7))}
    sign = 1 if offset > 100.0 else -1
    truth = {
        name: shift_poses(seen_from_elsewhere(path(rate, seed=seed)), sign * round(offset * 1e9))
        for name, seed in (("R1", 1), ("R2", 7))
    }
    expected = -sign * offset
    found = estimate_time_offset(truth, tracks, {})
    assert found.nanoseconds * 1e-9 == pytest.approx(expected, abs=0.005)
    assert found.correlation > 0.9


def test_a_part_without_headings_and_a_track_that_drifts():
    track = path(seed=3)
    truth = seen_from_elsewhere(path(2.0, seed=3))
    keep = (truth.stamp > 110 * SECOND) & (truth.stamp < 150 * SECOND)
    columns = ("stamp", "log_time", "x", "y")
    part = replace(
        truth,
        **{name: getattr(truth, name)[keep] for name in columns},
        heading=np.full(np.count_nonzero(keep), np.nan),
    )
    reckoned = replace(track, x=1.02 * track.x, y=1.02 * track.y, heading=track.heading + 0.3)
    found = estimate_time_offset(
        {"R1": shift_poses(part, -3 * SECOND)}, {"R1": track}, {"R1": reckoned}
    )
    assert found.nanoseconds * 1e-9 == pytest.approx(3.0, abs=0.02)


@pytest.mark.parametrize(("gap", "known"), [(0.4, 1.0), (0.7, 0.0)])
def test_motion_is_unknown_across_gaps_longer_than_the_window(gap, known):
    """At 10 Hz it is measured over 0.5 s."""
    t = np.arange(101) / 10.0
    t = t[(t <= 4.0) | (t > 3.95 + gap)]
    stamp = np.rint(t * 1e9).astype(np.int64)
    speed, turn = _signals(
        Poses("world", stamp, stamp, t, 0.0 * t, 0.0 * t), 0, 10 * SECOND, SECOND // 20
    )
    for signal in (speed, turn):
        assert signal.known[84] == known
        assert signal.known[[4, 60, 120, 196]].tolist() == [0.0, 1.0, 1.0, 0.0]


def still(poses):
    return replace(poses, x=np.zeros(len(poses.x)), y=np.zeros(len(poses.x)), heading=0 * poses.x)


@pytest.mark.parametrize(
    ("truth", "track", "said"),
    [
        (path(seed=1), path(seed=2), "do not move alike"),
        (path(), still(path()), "no robot moves in both"),
        (replace(path(), stamp=path().stamp[:2]), path(), "no robot has both"),
    ],
)
def test_what_cannot_be_found_is_refused(truth, track, said):
    with pytest.raises(CltError, match=said):
        estimate_time_offset({"R1": truth}, {"R1": track}, {})


def test_motion_that_repeats_is_ambiguous():
    t = np.arange(0.0, 120.0, 0.05)
    stamp = np.rint((100.0 + t) * 1e9).astype(np.int64)
    x = 3.0 * np.sin(2.0 * np.pi * t / 10.0)
    poses = Poses("world", stamp, stamp, x, 0.0 * x, 0.0 * x)
    with pytest.raises(CltError, match=r"another time offset, .* from the best, fits as well"):
        estimate_time_offset({"R1": poses}, {"R1": poses}, {})


def recording():
    track = path()
    team = Team((Robot("R1", 1), Robot("B", 2, static=True)))
    return Recording(team=team, estimate={"R1": track}, truth={"R1": track})


def test_the_reference_is_cut_to_the_estimates():
    longer = path(seconds=90.0, start=90.0)
    found = with_reference(recording(), {"R1": longer}, 0).truth["R1"]
    assert found.stamp[0] == 100 * SECOND
    assert found.stamp[-1] <= recording().estimate["R1"].stamp[-1]
    with pytest.raises(CltError, match=r"begins -90\.0 s from the estimates and does not overlap"):
        with_reference(recording(), {"R1": path(start=10.0)}, 0)
    with_reference(recording(), {"R1": path(start=10.0)}, 90 * SECOND)


def test_whose_the_reference_is():
    track = path()
    assert list(assign_reference({"R1": track, "X": track}, recording())) == ["R1"]
    assert list(assign_reference({"vicon_01": track}, recording())) == ["R1"]
    with pytest.raises(CltError, match="the truth is that of X, Y, the log is about R1, B"):
        assign_reference({"X": track, "Y": track}, recording())
