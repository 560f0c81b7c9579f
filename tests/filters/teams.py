"""Small recordings made by hand, independent of clt.sim, for the filters' tests."""

from __future__ import annotations

import numpy as np

from clt.core.geometry import wrap_angle
from clt.core.recording import Odometry, Poses, Ranges, Recording, Robot, Team

FINE = 1000
ANCHORS = ((0.0, 0.0), (12.0, 0.0))


def drive(seed: int, seconds: float):
    """Fine-grid (t, x, y, theta, s) of one robot on a winding path."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * FINE) + 1) / FINE
    omega = 0.4 * np.sin(2 * np.pi * t / rng.uniform(20, 40) + rng.uniform(0, 6)) + 0.1
    v = 0.6 + 0.2 * np.sin(t / 5.0 + seed)
    step = lambda f: np.append(0.0, np.cumsum(0.5 * (f[1:] + f[:-1])) / FINE)  # noqa: E731
    theta = rng.uniform(-3, 3) + step(omega)
    x, y = step(v * np.cos(theta)), step(v * np.sin(theta))
    return t, x + 6 - x.mean(), y + 6 - y.mean(), theta, step(v)


def team_recording(
    seed=0, moving=3, seconds=20.0, rate=20, range_rate=20, noise=1.0, antenna=(0.0, 0.0), shift=0
):
    """Two anchors, `moving` robots; sigma 0.2 m/s, 0.1 rad/s, 0.1 m, scaled by `noise`.

    Range stamps are `shift` ns after the multiples of their period.
    """
    rng = np.random.default_rng(seed)
    anchors = [Robot(f"S{k + 1}", k + 1, static=True, position=p) for k, p in enumerate(ANCHORS)]
    movers = [
        Robot(f"R{k + 1}", k + 3, antenna=antenna, sigma_v=0.2, sigma_omega=0.1)
        for k in range(moving)
    ]
    steps, pings = int(seconds * rate), int(seconds * range_rate)
    stamp = np.arange(steps + 1) * (1_000_000_000 // rate)
    ping = np.arange(1, pings + 1) * (1_000_000_000 // range_rate) + shift
    odometry, truth = {}, {}
    places = [np.tile(anchor, (pings, 1)) for anchor in ANCHORS]
    for k, robot in enumerate(movers):
        t, x, y, theta, s = drive(1000 * seed + k, seconds + 1)
        at = lambda times, f, t=t: np.interp(times * 1e-9, t, f)  # noqa: E731
        unknown = np.full(steps, np.nan)
        odometry[robot.name] = Odometry(
            stamp[1:],
            stamp[1:],
            np.diff(at(stamp, s)) * rate + noise * 0.2 * rng.normal(size=steps),
            np.diff(at(stamp, theta)) * rate + noise * 0.1 * rng.normal(size=steps),
            unknown,
            unknown,
        )
        truth[robot.name] = Poses(
            "world", stamp, stamp, at(stamp, x), at(stamp, y), wrap_angle(at(stamp, theta))
        )
        heading = at(ping, theta)
        c, sn = np.cos(heading), np.sin(heading)
        arm = np.stack([c * antenna[0] - sn * antenna[1], sn * antenna[0] + c * antenna[1]], axis=1)
        places.append(np.stack([at(ping, x), at(ping, y)], axis=1) + arm)
    pairs = [(a, b) for b in range(2, moving + 2) for a in range(b)]
    count = len(pairs)
    distance = np.stack([np.linalg.norm(places[a] - places[b], axis=1) for a, b in pairs], axis=1)
    measured = (distance + noise * 0.1 * rng.normal(size=distance.shape)).ravel()
    stamps = np.repeat(ping, count)
    source = np.tile([a for a, _ in pairs], pings)
    target = np.tile([b for _, b in pairs], pings)
    ranges = Ranges(
        stamps, stamps, source, target, measured, measured,
        np.full(stamps.size, np.nan), np.arange(stamps.size),
    )  # fmt: skip
    return Recording(Team((*anchors, *movers), range_sigma=0.1), odometry, ranges, truth=truth)


def standing_pair(seed: int, seconds=20.0, rate=10):
    """R1 and R2, which stand 2 m to 6 m apart and range; sigma 0.1 m, odometry that says so."""
    rng = np.random.default_rng(seed)
    distance, bearing, *heading = rng.uniform((2.0, -np.pi, -np.pi, -np.pi), (6.0, *[np.pi] * 3))
    place = [(0.0, 0.0), (distance * np.cos(bearing), distance * np.sin(bearing))]
    stamp = np.arange(int(seconds * rate) + 1) * (1_000_000_000 // rate)
    still, fine = np.zeros(stamp.size - 1), np.full(stamp.size - 1, 1e-4)
    odometry, truth = {}, {}
    for name, (x, y), theta in zip(("R1", "R2"), place, heading, strict=True):
        odometry[name] = Odometry(stamp[1:], stamp[1:], still, still, fine, fine)
        ones = np.ones(stamp.size)
        truth[name] = Poses("world", stamp, stamp, x * ones, y * ones, theta * ones)
    measured = distance + 0.1 * rng.standard_normal(still.size)
    source = rng.integers(0, 2, still.size)
    ranges = Ranges(
        stamp[1:], stamp[1:], source, 1 - source, measured, measured,
        np.full(still.size, np.nan), np.arange(still.size),
    )  # fmt: skip
    return Recording(
        Team((Robot("R1", 1), Robot("R2", 2)), range_sigma=0.1), odometry, ranges, truth=truth
    )
