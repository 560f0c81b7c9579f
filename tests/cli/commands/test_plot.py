from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.log.recording.save import save
from tests.log.logs import odometry_message, small_log, write_log

SIGNATURE = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF", ".html": b"<!DOCTYPE html>"}


def clt(*words: object) -> Result:
    return CliRunner().invoke(app, ["plot", *map(str, words)])


def write(path: Path, recording) -> Path:
    with path.open("wb") as file:
        save(file, recording, recording.run)
    return path


def words(path: Path) -> str:
    """The texts of an SVG, which matplotlib keeps as comments beside their outlines."""
    return path.read_text()


@pytest.fixture
def log(tmp_path, synthetic) -> Path:
    return write(tmp_path / "out.mcap", synthetic(n=200))


@pytest.mark.parametrize("suffix", SIGNATURE)
def test_every_format_and_the_same_bytes_again(log, tmp_path, suffix):
    outputs = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for output in outputs:
        result = clt(log, "-o", output)
        assert result.exit_code == 0, result.output
        assert result.stdout == ""
        assert str(output) in result.stderr
    first, second = (output.read_bytes() for output in outputs)
    assert first.startswith(SIGNATURE[suffix])
    assert first == second


def test_a_page_holds_the_figures_and_the_scripts(log, tmp_path):
    """tests/report/html/ looks at what is in it."""
    output = tmp_path / "page.html"
    assert clt(log, "-o", output).exit_code == 0
    text = output.read_text()
    assert "APE rmse" in text
    assert "plotly.js v" in text
    assert "Observability along the log" in text
    assert 'id="windows-0"' in text


def test_a_page_of_several_logs(log, tmp_path, synthetic):
    other = write(tmp_path / "other.mcap", synthetic(n=100, seed=4))
    done = clt(log, other, "-o", tmp_path / "page.html", "--json")
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert data["logs"] == [{"log": str(one), "align": "none"} for one in (log, other)]
    text = (tmp_path / "page.html").read_text()
    assert "2 runs compared" in text
    assert text.count('<section class="run"') == 2


def test_a_page_without_plotly_names_the_extra(log, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    done = clt(log, "-o", tmp_path / "page.html")
    assert (done.exit_code, done.stdout) == (1, "")
    assert done.stderr.count("\n") == 1
    assert "pip install 'clt[report]'" in done.stderr
    assert not (tmp_path / "page.html").exists()


def test_refuses_to_overwrite_without_force(log, tmp_path):
    output = tmp_path / "a.png"
    output.write_bytes(b"mine")
    result = clt(log, "-o", output)
    assert result.exit_code == 1
    assert "--force" in result.stderr
    assert output.read_bytes() == b"mine"
    assert clt(log, "-o", output, "--force").exit_code == 0
    assert output.read_bytes().startswith(SIGNATURE[".png"])


def test_unknown_format_is_wrong_usage(log, tmp_path):
    result = clt(log, "-o", tmp_path / "a.gif")
    assert result.exit_code == 2
    assert ".png" in result.stderr


def test_json_names_the_file(log, tmp_path):
    result = clt(log, "-o", tmp_path / "a.svg", "--json", "--align", "se2")
    data = json.loads(result.stdout)
    assert data.pop("diagnostics") == []
    assert data == {"log": str(log), "output": str(tmp_path / "a.svg"), "align": "se2"}


@pytest.mark.parametrize("suffix", SIGNATURE)
def test_without_truth_what_was_estimated_is_drawn(tmp_path, synthetic, suffix):
    path = write(tmp_path / "a.mcap", replace(synthetic(n=50), truth={}))
    outputs = [tmp_path / f"{name}{suffix}" for name in "ab"]
    for output in outputs:
        result = clt(path, "-o", output, "--json")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["align"] is None
    assert outputs[0].read_bytes().startswith(SIGNATURE[suffix])
    assert outputs[0].read_bytes() == outputs[1].read_bytes()


def test_an_alignment_without_truth_is_refused(tmp_path, synthetic):
    path = write(tmp_path / "a.mcap", replace(synthetic(n=50), truth={}))
    result = clt(path, "-o", tmp_path / "a.png", "--align", "se2")
    assert result.exit_code == 1
    assert "no ground truth" in result.stderr
    assert not (tmp_path / "a.png").exists()


def test_nothing_to_draw_leaves_no_file(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(write_log({"/x": ("odometry", [(5, odometry_message(5, 0.0, 0.0))])}))
    result = clt(path, "-o", tmp_path / "a.png")
    assert result.exit_code == 1
    assert "nothing to draw" in result.stderr
    assert not (tmp_path / "a.png").exists()


def test_a_log_that_is_not_localized_yet(tmp_path):
    output = tmp_path / "a.svg"
    path = tmp_path / "a.mcap"
    path.write_bytes(small_log())
    assert clt(path, "-o", output).exit_code == 0
    texts = words(output)
    assert "Ranges by pair" in texts
    assert "Odometry: speed" in texts
    assert "R1-R2" in texts


def test_bare_logs_are_drawn(tmp_path, synthetic):
    """No innovations, no dead reckoning, no true heading, one robot, singular covariance."""
    recording = synthetic(n=50, moving=1)
    truth = replace(recording.truth["R1"], heading=np.full(50, np.nan))
    estimate = replace(recording.estimate["R1"], covariance=np.zeros((50, 3, 3)))
    bare = replace(
        recording,
        truth={"R1": truth},
        estimate={"R1": estimate},
        dead_reckoning={},
        innovations=None,
    )
    result = clt(write(tmp_path / "a.mcap", bare), "-o", tmp_path / "a.png")
    assert result.exit_code == 0, result.output
    assert "no heading" in result.stderr


@pytest.mark.parametrize("panel", ["map", "errors", "heading", "innovations"])
def test_a_panel_alone_as_papers_want_it(log, tmp_path, panel):
    outputs = [tmp_path / f"{name}.pdf" for name in "ab"]
    for output in outputs:
        done = clt(log, "-o", output, "--panel", panel, "--style", "paper")
        assert done.exit_code == 0, done.output
    data = outputs[0].read_bytes()
    assert data == outputs[1].read_bytes()
    assert b"/MediaBox [ 0 0 252 187.2 ]" in data  # 3.5 by 2.6 inches
    assert b"/FontFile2" in data  # an embedded TrueType font


def test_several_runs_in_one_figure(log, tmp_path, synthetic):
    other = write(tmp_path / "other.mcap", synthetic(n=100, seed=4))
    done = clt(log, other, "-o", tmp_path / "a.svg")
    assert done.exit_code == 0, done.output
    assert "Position error of the team" in words(tmp_path / "a.svg")
    assert "other.mcap: 0.0" in words(tmp_path / "a.svg")


@pytest.mark.parametrize(
    "given", [("a.html", "--panel", "map"), ("a.png", "--style", "paper")], ids=["page", "whole"]
)
def test_styles_that_do_not_fit_are_wrong_usage(log, tmp_path, given):
    done = clt(log, "-o", tmp_path / given[0], *given[1:])
    assert (done.exit_code, done.stdout) == (2, "")


def test_a_panel_needs_truth(tmp_path, synthetic):
    path = write(tmp_path / "a.mcap", replace(synthetic(n=50), truth={}))
    done = clt(path, "-o", tmp_path / "a.png", "--panel", "errors")
    assert done.exit_code == 1
    assert "nothing to score" in done.stderr
    assert not (tmp_path / "a.png").exists()
