"""Cells and texts of reports that depend on what is there."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console

from clt.cli.reports.evaluate_report import print_team_table
from clt.cli.reports.observability_report import rank_text, robot_windows_text, sigma_text
from clt.metrics.evaluate import evaluate
from clt.observability.windows.windows import RobotWindows


def team_table(evaluations):
    """Rows of the printed table as lists of cells."""
    console = Console(file=io.StringIO(), width=200)
    print_team_table(console, evaluations)
    lines = console.file.getvalue().splitlines()
    return [line.split() for line in lines if ".mcap" in line]


def test_the_table_of_several_logs_shows_dead_reckoning_or_a_dash(synthetic):
    whole = synthetic()
    without = replace(whole, dead_reckoning={})
    rows = team_table({"a.mcap": evaluate(whole), "b.mcap": evaluate(without)})
    assert [row[0] for row in rows] == ["a.mcap", "b.mcap"]
    head, dead = evaluate(whole).estimate.team, evaluate(whole).dead_reckoning.team
    assert float(rows[0][2]) == pytest.approx(head.ape.rmse, rel=0.05)
    assert float(rows[0][5]) == pytest.approx(dead.ape.rmse, rel=0.05)
    assert rows[1][5] == "-"
    assert rows[1][2:5] == rows[0][2:5]


def seen(rank, position, heading, words):
    return RobotWindows(
        "R1", np.array(rank), np.array(position), np.array(heading),
        np.zeros((len(rank), 3)), tuple(words),
    )  # fmt: skip


def test_a_rank_that_varies_is_printed_from_low_to_high():
    one = seen([3, 1, 2], [0.1, 0.3, np.inf], [0.02, 0.04, 0.03], ["x", "y", "y"])
    assert rank_text(one) == "1 .. 3"
    text = robot_windows_text(one)
    assert text.split("; ") == [
        "rank 1 .. 3 of 3",
        "position 0.2 m (worst unknown)",
        "heading 0.03 rad (worst 0.04)",
        "weakest: y",
    ]
    same = seen([2, 2], [0.1, 0.1], [np.nan, np.nan], ["x", "x"])
    assert robot_windows_text(same) == "rank 2 of 2; position 0.1 m (worst 0.1); weakest: x"


def test_sigmas_of_which_none_is_known():
    assert sigma_text(np.array([np.inf, np.inf]), "m") == "unknown"
