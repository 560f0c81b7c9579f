"""What is done of a study, through kills and damage."""

from __future__ import annotations

import pytest

from clt.core.errors import CltError
from clt.studies.journal import Journal
from clt.studies.task import RunOutcome

ONE = RunOutcome(0, diverged=False, scores={"ape_rmse": 0.1 + 0.2}, seconds={"localize": 1.5})
TWO = RunOutcome(1, diverged=True, error="no odometry")


@pytest.fixture
def path(tmp_path):
    with Journal(tmp_path / "journal.jsonl") as journal:
        journal.add("a", [ONE, TWO])
        journal.add("b", [TWO])
    return tmp_path / "journal.jsonl"


def test_what_was_noted_comes_back_exactly(path):
    with Journal(path) as journal:
        assert "a" in journal
        assert "c" not in journal
        assert journal.outcomes("a") == [ONE, TWO]
        assert journal.outcomes("b") == [TWO]
        assert journal.outcomes("c") is None


@pytest.mark.parametrize("lost", range(1, 60, 7))
def test_a_line_that_a_kill_cut_short_is_dropped_and_written_again(path, lost):
    whole = path.read_bytes()
    path.write_bytes(whole[:-lost])
    with Journal(path) as journal:
        assert journal.outcomes("a") == [ONE, TWO]
        assert "b" not in journal
        journal.add("b", [TWO])
    assert path.read_bytes() == whole


def test_a_damaged_line_costs_its_own_task_alone(path):
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"\x00" + lines[0][1:] + lines[1])
    with Journal(path) as journal:
        assert "a" not in journal
        assert journal.outcomes("b") == [TWO]


def test_two_sweeps_do_not_share_a_folder(path):
    pytest.importorskip("fcntl")
    with Journal(path), pytest.raises(CltError, match="another sweep"):
        Journal(path)
