"""Recordings of known truth and known errors, for every test that needs one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from clt.core.geometry import wrap_angle
from clt.core.recording import Innovations, Poses, Recording, Robot, Team

PERIOD = 50_000_000
START = 1_700_000_000_123_456_789
SIGMA = np.array([0.05, 0.03, 0.02])


def poses(frame, stamp, rows, covariance=None):
    """Poses from rows (x, y, heading)."""
    x, y, heading = np.array(rows, float).T
    return Poses(frame, stamp, stamp, x, y, heading, covariance)


def loop(n, index):
    """A lopsided closed path: no mirror image or rotation of itself."""
    s = np.linspace(0.0, 2.0 * np.pi, n) + index
    x = 3.0 * np.cos(s) + 0.8 * np.sin(2.0 * s) + 2.0 * index
    y = 2.0 * np.sin(s) + 0.9 * np.cos(3.0 * s) - index
    return np.column_stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))])


@pytest.fixture(scope="module")
def interpreted() -> Iterator[None]:
    """Run kernels as Python: small ones by themselves, without compiling each."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NUMBA_DISABLE_JIT", "1")
        yield


@pytest.fixture
def synthetic() -> Callable[..., Recording]:
    """Build a recording: two static robots, `moving` robots whose errors have known covariance."""

    def build(n=600, moving=3, seed=0, correlation=0.0):
        rng = np.random.default_rng(seed)
        static = (
            Robot("A1", 1, static=True, position=(0.0, 0.0)),
            Robot("A2", 2, static=True, position=(6.0, 0.0)),
        )
        team = Team((*static, *(Robot(f"R{k + 1}", k + 3) for k in range(moving))))
        stamp = START + PERIOD * np.arange(n)
        angle = 0.4
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        factor = np.eye(3)
        factor[:2, :2] = turn
        P = factor @ np.diag(SIGMA**2) @ factor.T
        truth, estimate, reckoned = {}, {}, {}
        for robot in static:
            truth[robot.name] = poses("world", stamp, np.tile([*robot.position, 0.0], (n, 1)))
        for k, robot in enumerate(team.moving):
            rows = loop(n, k)
            white = rng.standard_normal((n, 3)) * SIGMA
            errors = white.copy()
            for i in range(1, n):
                errors[i] = correlation * errors[i - 1] + np.sqrt(1.0 - correlation**2) * white[i]
            drift = np.cumsum(rng.standard_normal((n, 3)) * [0.03, 0.03, 0.005], axis=0)
            spread = np.arange(1, n + 1)[:, None, None] * np.diag([9e-4, 9e-4, 2.5e-5])
            truth[robot.name] = poses("world", stamp, rows)
            estimated, lost = rows + errors @ factor.T, rows + drift
            estimated[:, 2], lost[:, 2] = wrap_angle(estimated[:, 2]), wrap_angle(lost[:, 2])
            estimate[robot.name] = poses("world", stamp, estimated, np.tile(P, (n, 1, 1)))
            reckoned[robot.name] = poses("world", stamp, lost, spread)
        residual = 0.1 * rng.standard_normal(4 * n)
        accepted = np.abs(residual) < 0.25
        innovations = Innovations(
            stamp=np.repeat(stamp, 4),
            source=np.tile([2, 2, 0, 1 + moving], n),
            target=np.tile([0, 1, 2, 1], n),
            residual=residual,
            sigma=np.full(4 * n, 0.1),
            nis=(residual / 0.1) ** 2,
            accepted=accepted,
        )
        return Recording(
            team,
            truth=truth,
            estimate=estimate,
            dead_reckoning=reckoned,
            innovations=innovations,
            run={"filter": "eskf"},
        )

    return build


@pytest.fixture
def moved() -> Callable[..., Recording]:
    """Apply `change(rows) -> rows` to the estimates of some robots (all by default)."""

    def apply(recording, change, names=None, frame=None):
        tracks = dict(recording.estimate)
        for name in tracks if names is None else names:
            track = tracks[name]
            rows = change(np.column_stack([track.x, track.y, track.heading]))
            tracks[name] = replace(
                track,
                x=rows[:, 0],
                y=rows[:, 1],
                heading=wrap_angle(rows[:, 2]),
                frame=track.frame if frame is None else frame,
            )
        return replace(recording, estimate=tracks)

    return apply
