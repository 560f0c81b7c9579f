"""Weights of hypotheses and the evidence between them, by hand and by numerical derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.geometry import rotation_matrix
from clt.initialization.pairwise import hypotheses
from clt.initialization.pairwise.branch_and_bound import CELL_FIELDS
from clt.initialization.pairwise.evidence import evidence_share, lines_of_sight
from clt.initialization.pairwise.hypotheses import (
    MAX_SHARP_SIGMAS,
    fair_weights,
    flattened_masses,
    is_sharp,
)
from clt.initialization.pairwise.likelihood import (
    COST,
    COST_FIELDS,
    DISTANCE,
    LOG_DET,
    PHI,
    THETA,
)
from tests.initialization.pairwise.winding import winding


def seed_at(theta, phi, d, cost=0.0, log_det=0.0):
    seed = np.zeros(COST_FIELDS)
    seed[[THETA, PHI, DISTANCE, COST, LOG_DET]] = theta, phi, d, cost, log_det
    return seed


def predicted(pair, pose, a, b):
    """Ranges (n,) at a pose along tracks that may differ from those measured."""
    q = pose[DISTANCE] * np.array([np.cos(pose[THETA]), np.sin(pose[THETA])])
    w = q + (b - pair.b[0]) @ rotation_matrix(pose[PHI]).T - (a - pair.a[0])
    return np.hypot(*w.T)


def difference(pair, one, other, a, b):
    return predicted(pair, one, a, b) - predicted(pair, other, a, b)


@pytest.mark.parametrize("with_b", [False, True])
@pytest.mark.parametrize("drift", [0.4, 1.0, 4.0])
def test_evidence_counts_as_far_as_it_exceeds_what_noise_fakes(drift, with_b):
    """C is worked out by moving each point of the tracks."""
    rng = np.random.default_rng(3)
    pair, _ = winding(rng, 8, 0.05, drift)
    if not with_b:
        pair = pair._replace(P_b=np.zeros_like(pair.P_b))
    one, other = seed_at(0.4, 0.3, 2.0), seed_at(0.5, 0.2, 2.1)
    n, h = pair.z.size, 1e-6
    G = np.zeros((2, n, n, 2))
    for side in range(2):
        for k in range(n):
            for i in range(2):
                moved = [pair.a.copy(), pair.b.copy()]
                moved[side][k, i] += h
                up = difference(pair, one, other, *moved)
                moved[side][k, i] -= 2.0 * h
                G[side, :, k, i] = (up - difference(pair, one, other, *moved)) / (2.0 * h)
    C = sum(
        np.einsum("kai,abij,mbj->km", g, P, g) for g, P in zip(G, (pair.P_a, pair.P_b), strict=True)
    )
    S = C + np.diag(pair.variance)
    Delta = difference(pair, one, other, pair.a, pair.b)
    nu = np.trace(np.linalg.solve(S, C))
    expected = 1.0 - (nu + 2.0 * np.sqrt(2.0 * nu)) / (Delta @ np.linalg.solve(S, Delta))
    assert evidence_share(pair, one, other) == pytest.approx(max(expected, 0.0), abs=1e-6)
    assert expected < 0.99


def test_exact_tracks_fake_nothing_and_equal_poses_show_nothing():
    pair, _ = winding(np.random.default_rng(4), 8, 0.05, 0.0)
    one, other = seed_at(0.4, 0.3, 2.0), seed_at(0.9, -0.4, 2.3)
    assert evidence_share(pair, one, other) == 1.0
    assert evidence_share(pair, one, one) == 1.0
    vague, _ = winding(np.random.default_rng(4), 8, 0.05, 5.0)
    assert evidence_share(vague, seed_at(0.4, 0.3, 2.0), seed_at(0.41, 0.3, 2.0)) == 0.0


def test_errors_across_the_line_of_sight_alone_fake_something():
    """P_a in y only; both robots drive along x, and the poses lie on either side."""
    pair, _ = winding(np.random.default_rng(5), 8, 0.05, 0.0)
    P = np.zeros_like(pair.P_a)
    P[1:, 1:, 1, 1] = 0.01
    one, other = seed_at(0.7, 0.0, 2.0), seed_at(-0.7, 0.0, 2.0)
    assert evidence_share(pair, one, other) == 1.0
    assert evidence_share(pair._replace(P_a=P), one, other) < 1.0


def test_lines_of_sight_are_those_of_both_frames():
    pair, _ = winding(np.random.default_rng(6), 6, 0.05, 0.1)
    pose = seed_at(0.4, 0.9, 2.0)
    u, v, apart = lines_of_sight(pair, pose)
    np.testing.assert_allclose(apart, predicted(pair, pose, pair.a, pair.b), atol=1e-12)
    np.testing.assert_allclose(np.hypot(*u.T), 1.0)
    np.testing.assert_allclose(v @ rotation_matrix(0.9).T, u, atol=1e-12)
    assert u[0] == pytest.approx([np.cos(0.4), np.sin(0.4)])


def test_fair_weights_by_hand(monkeypatch):
    """Of three seeds two lead to one solution; a quarter of the evidence counts."""
    monkeypatch.setattr(hypotheses, "evidence_share", lambda *_: 0.25)
    seeds = np.array([seed_at(0, 0, 1, 2.0, 1.0), seed_at(1, 0, 1, 4.0, 1.0), seed_at(1, 0, 1)])
    parent, weight = np.array([0, 1, 1]), np.array([0.8, 0.15, 0.05])
    # Solution 1 costs 2 more: half of that is its loss, of which 3 / 4 are given back.
    raised = np.array([0.8, 0.15 * np.exp(0.75), 0.05 * np.exp(0.75)])
    found = fair_weights(None, seeds, parent, weight)
    np.testing.assert_allclose(found, raised / raised.sum(), rtol=1e-12)


def test_no_solution_becomes_more_probable_than_the_best(monkeypatch):
    monkeypatch.setattr(hypotheses, "evidence_share", lambda *_: 0.0)
    seeds = np.array([seed_at(0, 0, 1), seed_at(1, 0, 1, 20.0), seed_at(2, 0, 1, 0.0, 40.0)])
    found = fair_weights(None, seeds, np.arange(3), np.array([0.7, 0.2, 0.1]))
    np.testing.assert_allclose(found, np.full(3, 1.0 / 3.0))
    # One that explains more than the best, with less around it, loses nothing that is given back.
    seeds[1, COST] = -5.0
    found = fair_weights(None, seeds, np.arange(3), np.array([0.7, 0.2, 0.1]))
    np.testing.assert_allclose(found, np.array([0.7, 0.2, 0.7]) / 1.6)


def test_costs_within_what_noise_fakes_are_all_the_same():
    cells = np.zeros((3, CELL_FIELDS))
    cells[:, COST] = 5.0, 7.0, 15.0
    mass = np.exp(-0.5 * (cells[:, COST] - 5.0))
    flat = flattened_masses(cells, mass, 4.0)
    np.testing.assert_allclose(flat, np.array([1, 1, np.exp(-3.0)]) / (2 + np.exp(-3.0)))
    np.testing.assert_allclose(flattened_masses(cells, mass, 0.0), mass / mass.sum())


@pytest.mark.parametrize(
    ("factors", "turns", "sharp"),
    [
        ((0.99, 0.99), True, True),
        ((1.01, 0.5), True, False),
        ((0.5, 1.01), True, False),
        ((0.5, 9.0), False, True),
        ((1.01, 0.5), False, False),
    ],
)
def test_what_is_sharp_is_so_in_every_direction(factors, turns, sharp):
    place, turn = np.array(factors) * MAX_SHARP_SIGMAS
    c, s = np.cos(0.6), np.sin(0.6)
    R = np.array([[c, -s], [s, c]])
    P = np.zeros((3, 3))
    P[:2, :2] = R @ np.diag([place**2, 1e-6]) @ R.T
    P[2, 2] = turn**2
    assert is_sharp(P, turns) == sharp
