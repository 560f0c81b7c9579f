"""Ranges of a small team, and the table that a filter makes of them."""

from __future__ import annotations

import numpy as np

from clt.core.recording import Ranges, Robot, Team
from clt.model.range_table import range_table
from clt.model.settings import NoiseSettings

QUIET = NoiseSettings(sigma_v=0.2, sigma_omega=0.1)
TEAM = Team(
    (
        Robot("A1", 1, static=True, position=(1.0, 2.0)),
        Robot("A2", 2, static=True, position=(5.0, 6.0)),
        Robot("R1", 3),
        Robot("R2", 4),
        Robot("R3", 5),
    ),
    range_sigma=0.1,
)


def ranges(rows, sigma=np.nan):
    """(stamp, source, target, range) per row."""
    stamp, source, target = (np.array([row[k] for row in rows], np.int64) for k in range(3))
    value = np.array([row[3] for row in rows], float)
    sigmas = np.broadcast_to(np.asarray(sigma, float), value.shape)
    return Ranges(stamp, stamp, source, target, value, value, sigmas, np.arange(stamp.size))


def table_of(measured, noise=QUIET, start=0, end=100, state=None):
    """R1 and R2 in the state, A1 and A2 fixed, R3 nowhere."""
    anchors = {k: np.array(TEAM.robots[k].position) for k in (0, 1)}
    return range_table(measured, TEAM, state or {2: 0, 3: 1}, anchors, noise, start, end)
