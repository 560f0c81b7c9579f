"""Commands on several logs: order, names, failures, and the same results as one by one."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.cli.many import common_code, distinct_names, words_of_one
from clt.log.recording.load import load


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Two simulated logs with one name in two folders, and a file that is none."""
    folder = tmp_path_factory.mktemp("logs")
    for seed, name in ((1, "a"), (2, "b")):
        (folder / name).mkdir()
        words = ["simulate", "shi-sim", "--duration", "3", "--seed", str(seed), "-q", "-o"]
        assert CliRunner().invoke(app, [*words, str(folder / name / "run.mcap")]).exit_code == 0
    (folder / "bad.mcap").write_bytes(b"no log at all")
    return folder


@pytest.fixture
def clt(monkeypatch, logs):
    """Run one command in the folder of the logs; returns exit code, stdout, stderr."""
    monkeypatch.chdir(logs)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


def test_a_bad_log_does_not_stop_the_others(clt, tmp_path):
    words = ("localize", "a/run.mcap", "bad.mcap", "b/run.mcap", "--init", "truth")
    code, out, err = clt(*words, "-o", tmp_path / "out", "--json")
    first, bad, last = json.loads(out)
    assert code == 3
    assert [one["log"] for one in (first, last)] == [
        str(tmp_path / "out" / "a_run.mcap"), str(tmp_path / "out" / "b_run.mcap"),
    ]  # fmt: skip
    assert bad["log"] == "bad.mcap"
    assert bad["exit_code"] == 1
    assert err.splitlines()[-1].startswith("clt: warning: bad.mcap: exit code 1: ")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "a_run.mcap", "b_run.mcap",
    ]  # fmt: skip


def test_results_are_those_of_one_by_one_whatever_the_number_of_processes(clt, tmp_path):
    names = ("b/run.mcap", "a/run.mcap")
    options = ("--init", "truth", "-q")
    assert clt("localize", *names, *options, "-o", tmp_path / "two", "--jobs", "2")[0] == 0
    for name in names:
        single = tmp_path / "single.mcap"
        assert clt("localize", name, *options, "-o", single, "--force")[0] == 0
        many = tmp_path / "two" / name.replace("/", "_")
        one, other = load(single).recording, load(many).recording
        assert one.estimate["R3"].x.tobytes() == other.estimate["R3"].x.tobytes()
        assert one.run["inputs"] == other.run["inputs"]


def test_scores_stand_in_the_order_of_the_arguments(clt, tmp_path):
    names = ("b/run.mcap", "a/run.mcap")
    assert clt("localize", *names, "--init", "truth", "-q", "-o", tmp_path / "out")[0] == 0
    results = [str(tmp_path / "out" / f"{name}_run.mcap") for name in "ba"]
    code, alone, _ = clt("evaluate", *results, "--json")
    assert code == 0
    assert [one["log"] for one in json.loads(alone)] == results
    assert clt("evaluate", *results, "--json", "--jobs", "2")[:2] == (0, alone)
    code, text, err = clt("evaluate", results[0], "bad.mcap", "--json", "--jobs", "2")
    assert code == 3
    assert "bad.mcap" in err
    assert "error" in json.loads(text)[1]


def test_init_prints_each_log_or_writes_each_file(clt, tmp_path):
    words = ("init", "a/run.mcap", "b/run.mcap", "--method", "truth")
    code, out, _ = clt(*words)
    assert code == 0
    assert [line for line in out.splitlines() if line.endswith(":")] == [
        "a/run.mcap:", "b/run.mcap:",
    ]  # fmt: skip
    assert clt(*words, "-q", "-o", tmp_path / "poses")[0] == 0
    assert sorted(path.name for path in (tmp_path / "poses").iterdir()) == [
        "a_run.toml", "b_run.toml",
    ]  # fmt: skip


def test_results_that_exist_are_kept_unless_forced(clt, tmp_path):
    words = ("init", "a/run.mcap", "b/run.mcap", "-q", "--method", "truth", "-o", tmp_path)
    (tmp_path / "a_run.toml").write_bytes(b"mine")
    code, _, err = clt(*words)
    assert code == 3
    assert "--force" in err
    assert (tmp_path / "a_run.toml").read_bytes() == b"mine"
    assert clt(*words, "--force")[0] == 0
    assert b"[R3]" in (tmp_path / "a_run.toml").read_bytes()


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("a/run.mcap", "a/run.mcap", "-o", "out"), "given twice"),
        (("a/run.mcap", "a/../a/run.mcap", "-o", "out"), "given twice"),
        (("a/run.mcap", "-", "-o", "out"), "standard input"),
        (("a/run.mcap", "b/run.mcap", "-o", "-"), "need a folder"),
        (("a/run.mcap", "b/run.mcap", "-o", "new.mcap"), "need a folder"),
        (("a/run.mcap", "b/run.mcap", "-o", "bad.mcap"), "need a folder"),
    ],
)
def test_a_wrong_call_is_refused(clt, words, text):
    code, _, err = clt("localize", *words)
    assert code == 2
    assert text in err


def test_a_wrong_option_is_wrong_usage_for_all(clt, tmp_path):
    code, _, err = clt("localize", "a/run.mcap", "b/run.mcap", "-o", tmp_path, "--filter", "esk")
    assert code == 2
    assert "did you mean `eskf`" in err


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (("/x/a.mcap", "/x/b.mcap"), ["a", "b"]),
        (("/x/a.mcap", "/y/a.mcap", "/y/b.mcap"), ["x_a", "y_a", "b"]),
        (("/1/x/a.mcap", "/2/x/a.mcap"), ["1_x_a", "2_x_a"]),
        (("/x/A.mcap", "/x/a.mcap"), ["1_A", "2_a"]),
        (("/x/a.mcap", "/x/a.db3"), ["1_a", "2_a"]),
        (("/x/a.mcap", "/y/a.mcap", "/z/x_a.mcap"), ["1_a", "2_a", "3_x_a"]),
    ],
)
def test_names_of_results_never_collide(paths, names):
    assert distinct_names([Path(path) for path in paths])[: len(names)] == names


def test_a_log_is_recorded_with_the_command_that_does_it_alone():
    words = ["localize", "a", "b", "--jobs", "3", "--init", "truth", "--jobs=2"]
    kept = words_of_one(words, [Path("a"), Path("b")], Path("b"))
    assert kept == ("localize", "b", "--init", "truth")


@pytest.mark.parametrize(
    ("codes", "code"),
    [((0, 0), 0), ((0, 3), 3), ((0, 1), 3), ((2, 2), 2), ((1, 2), 1), ((3, 3), 3)],
)
def test_the_exit_code_says_whether_anything_is_missing(codes, code):
    assert common_code(codes) == code
