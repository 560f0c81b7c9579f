from __future__ import annotations

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from clt.core.recording import Innovations, Robot, Team
from clt.metrics.pairs import all_nis, pair_nis, significance_marks
from clt.metrics.residuals import pair_residuals

TEAM = Team((Robot("A", 1), Robot("B", 2), Robot("C", 3)))


def innovations(residual, sigma=0.1, rejected=()):
    """A-B and B-C in turn."""
    n = len(residual)
    sigmas = np.full(n, sigma)
    accepted = np.ones(n, np.bool_)
    accepted[list(rejected)] = False
    ends = np.arange(n) % 2
    with np.errstate(over="ignore"):
        nis = (residual / sigmas) ** 2
    return Innovations(np.arange(n), ends, ends + 1, residual, sigmas, nis, accepted)


def white(n=4000, sigma=0.1):
    return sigma * np.random.default_rng(5).normal(size=n)


def test_figures_by_hand():
    found = pair_nis(innovations(np.array([0.1, 9.0, 0.3, 9.0, 0.2, 9.0])), TEAM)["A-B"]
    assert (found.count, found.rejected) == (3, 0.0)
    assert found.mean == pytest.approx(0.2)
    assert found.std == pytest.approx(np.std([0.1, 0.3, 0.2]))
    # Centred -0.1, 0.1, 0.0: products -0.01 and 0 over squares 0.02.
    assert found.autocorrelation == pytest.approx(-0.5)
    assert found.nis == pytest.approx((1.0 + 9.0 + 4.0) / 3.0)


def test_white_residuals_show_nothing():
    for seed in range(20):
        values = 0.1 * np.random.default_rng(seed).normal(size=2000)
        pairs = pair_nis(innovations(values), TEAM)
        assert all(pair.significant == () for pair in pairs.values()), seed


def test_errors_that_stay_alike_for_a_while_show_no_mean_and_no_variance():
    """AR(1) with rho = 0.9, of the deviation that the filter states: 19 of them are worth one."""
    marked = {"mean": 0, "nis": 0, "autocorrelation": 0}
    for seed in range(20):
        rng = np.random.default_rng(seed)
        values = 0.1 * rng.normal(size=(1000, 2))
        for k in range(1, 1000):
            values[k] = 0.9 * values[k - 1] + np.sqrt(1.0 - 0.81) * values[k]
        table = innovations(values.ravel())
        for pair in [*pair_nis(table, TEAM).values(), all_nis(table)]:
            for name in pair.significant:
                marked[name] += 1
        off = pair_nis(innovations(values.ravel() + 0.2), TEAM)
        assert all("mean" in pair.significant for pair in off.values())
    assert marked["mean"] + marked["nis"] <= 1
    assert marked["autocorrelation"] >= 40


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda e: e + 0.03, "mean"),
        (lambda e: 1.2 * e, "nis"),
        (lambda e: (e + 0.5 * np.roll(e, 2)) / np.sqrt(1.25), "autocorrelation"),
    ],
)
def test_what_is_not_chance_is_marked(change, expected):
    for pair in pair_nis(innovations(change(white())), TEAM).values():
        assert expected in pair.significant


@pytest.mark.parametrize(
    ("worth", "mean", "nis"), [((1.0, 1e-4), 1, 0), ((1e-4, 1.0), 0, 1), ((1.0, 1.0), 1, 1)]
)
def test_mean_and_squares_are_worth_what_each_of_them_is(worth, mean, nis):
    table = pair_residuals(
        np.zeros(4000, np.int64), 1.3 * white() + 0.03, np.full(4000, 0.1), np.ones(4000, np.bool_)
    )
    marks = significance_marks(table, np.zeros(1, np.int64), tuple(np.array([w]) for w in worth))
    assert (marks["mean"], marks["nis"]) == ([mean], [nis])


def test_rejected_ranges_are_marked_and_not_counted():
    values = white(400)
    values[::8] = 50.0
    found = pair_nis(innovations(values, rejected=range(0, 400, 8)), TEAM)
    assert found["A-B"].rejected == 0.25
    assert "rejected" in found["A-B"].significant
    assert abs(found["A-B"].mean) < 0.05
    assert found["B-C"].significant == ()


def test_numbers_that_are_none_reach_no_figure():
    values = white(40)
    values[[0, 3]] = np.nan, 1e300
    table = innovations(values)
    for made in (table, innovations(np.array([0.1])), replace(table, sigma=np.zeros(40))):
        found = {**pair_nis(made, TEAM), "all": all_nis(made)}
        json.dumps({name: asdict(pair) for name, pair in found.items()}, allow_nan=False)


def test_no_rows_no_pairs():
    none = np.empty(0)
    keys = np.empty(0, np.int64)
    assert pair_residuals(keys, none, none, np.empty(0, np.bool_)).pair.size == 0
    assert all_nis(innovations(none)) is None
