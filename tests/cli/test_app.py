"""What holds for every command: its options, its help, the environment, the standard streams."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from clt.cli.app import COMMANDS, app
from clt.cli.lazy import load_command
from clt.estimation.estimators import FILTERPY_FILTERS, FILTERS
from clt.log.recording.load import load
from clt.log.recording.save import save
from clt.model import choices

FLAGS = ("--output", "-o", "--force", "--json", "--quiet", "-q", "--verbose", "-v", "--help", "-h")
HEAVY = (
    "numpy",
    "pydantic",
    "numba",
    "matplotlib",
    "mcap",
    "clt.cli.commands.demo",
    "clt.cli.commands.localize",
)


@pytest.fixture
def clt(monkeypatch, tmp_path):
    """Run one command in an empty folder."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)
    return lambda *words, **env: CliRunner().invoke(app, list(words), env=env)


def shell(line, folder, **environment):
    """Run a line of shell in which `clt` is the program; returns exit code and stderr."""
    line = line.replace("clt ", f'"{sys.executable}" -m clt ')
    clean = {name: text for name, text in os.environ.items() if not name.startswith("CLT_")}
    done = subprocess.run(
        ["sh", "-c", line], cwd=folder, env=clean | environment, capture_output=True, check=False
    )
    return done.returncode, done.stdout.decode(), done.stderr.decode()


def paragraphs(name):
    """The docstring of a command, its common indentation removed."""
    text = load_command(COMMANDS[name]).__doc__ or ""
    first, _, rest = text.partition("\n")
    return "\n".join([first, *(line.removeprefix("    ") for line in rest.splitlines())]).rstrip()


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_common_options(clt, name):
    done = clt(name, "--help", COLUMNS="200", NO_COLOR="1", TERM="dumb")
    assert done.exit_code == 0
    # The folder of `clt demo` is its output.
    wanted = set(FLAGS) - ({"-o", "--output"} if name == "demo" else set())
    assert wanted <= set(re.findall(r"(?<!\S)--?[a-z]+", done.stdout))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_list_of_commands_says_what_the_command_says(name):
    assert paragraphs(name).splitlines()[0] == COMMANDS[name].about


@pytest.mark.parametrize("name", COMMANDS)
def test_every_example_has_its_own_line(clt, name):
    *_, examples = paragraphs(name).split("\n\n")
    head, *lines = examples.splitlines()
    assert head == "Examples:"
    assert all(re.match(rf"  clt {name}( |$)", line) for line in lines), lines
    shown = [line.strip() for line in clt(name, "--help", COLUMNS="100").stdout.splitlines()]
    assert len(lines) > 0
    assert [line for line in lines if line.strip() not in shown] == []


def test_help_lists_every_command_and_imports_none(clt):
    listed = re.findall(r"(?m)^│ ([a-z]+) ", clt("--help").stdout)
    assert sorted(listed) == sorted(COMMANDS)
    code = f"import sys, clt.cli.app; print([n for n in {HEAVY!r} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("localise", "no such command `localise`, did you mean `localize`?; see clt --help"),
        ("qqq", "no such command `qqq`; see clt --help"),
        ("--foo", "no such option --foo; see clt --help"),
        ("evaluate --aling x", "evaluate: no such option --aling, did you mean `--align`?"),
        ("localize", "localize: LOG is missing; see clt localize --help"),
        ("localize a", "localize: -o/--output is missing; see clt localize --help"),
        ("info a b c", "info: unexpected: b c; see clt info --help"),
        ("info a --json=3", "info: --json takes no value; see clt info --help"),
        ("simulate --seed", "simulate: --seed needs a value; see clt simulate --help"),
        ("simulate --seed x", 'simulate: --seed must be a whole number, not "x"; see clt simu'),
        ("simulate --duration x", 'simulate: --duration must be a number, not "x"; see clt simu'),
        ("observability --moving 900", 'observability: --moving must be at most 200, not "900"'),
        (
            "evaluate a --align fist",
            "evaluate: --align must be none, first, anchors, se2 or se2-per-robot, not",
        ),
        ("info a \x1b[2J\n", "info: unexpected: "),
    ],
)
def test_wrong_usage_is_one_line_with_the_remedy(clt, line, said):
    done = clt(*line.split(" "))
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.startswith(f"clt: error: {said}")
    assert done.stderr.endswith("--help\n")
    assert done.stderr.rstrip("\n").isprintable()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--filter", "esfk"), "clt: error: --filter esfk: unknown, did you mean `eskf`?\n"),
        (("--frame", "eg:R1"), "clt: error: --frame eg:R1: unknown, did you mean `ego`?\n"),
        (("--init", "trut"), "clt: error: --init trut: no such method or file, did you mean"),
        (("--engine", "x"), "clt: error: --engine x: unknown; known: compiled, filterpy\n"),
        (("--set", "nose=1"), "clt: error: --set: unknown key `nose`, did you mean `noise`?\n"),
    ],
)
def test_slips_are_refused_before_anything_slow_is_imported(words, said):
    """And before the log is read, which is not there."""
    slow = ("numpy", "numba", "scipy")
    code = (
        "import sys, atexit; from clt.cli.app import app\n"
        f"atexit.register(lambda: print([n for n in {slow!r} if n in sys.modules]))\n"
        "app()"
    )
    line = [sys.executable, "-c", code, "localize", "none.mcap", "-o", "x.mcap", *words]
    done = subprocess.run(line, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "[]\n")
    assert done.stderr.startswith(said)


def test_the_names_of_filters_are_those_that_there_are():
    assert tuple(FILTERS) == choices.FILTER_NAMES
    assert tuple(FILTERPY_FILTERS) == choices.FILTERPY_FILTER_NAMES


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    ("variable", "hint"),
    [("CLT_FOO", ""), ("CLT_SEDE", ", did you mean `CLT_SEED`?")],
)
def test_every_command_refuses_unknown_variables_alike(clt, tmp_path, name, variable, hint):
    words = {
        "demo": ["new"],
        "import": ["thu", "in", "-o", "out"],
        "record": ["-o", "out"],
        "emit": ["in", "--proto", "rcl", "-o", "out"],
        "export": ["in", "--format", "tum", "-o", "out"],
    }.get(name, ["in", "-o", "out"])
    done = clt(name, *words, **{variable: "1"})
    expected = f"clt: error: environment variable {variable}: unknown key{hint}\n"
    assert (done.exit_code, done.stdout, done.stderr) == (2, "", expected)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("result")
    line = "clt simulate shi-sim --duration 3 -o - | clt localize - --init truth -o r.mcap"
    assert shell(line, folder)[0] == 0
    return folder


@pytest.mark.parametrize("command", ["evaluate r.mcap", "localize --help"])
def test_a_terminal_that_knows_only_ascii(result, command):
    code, out, err = shell(f"clt {command}", result, PYTHONIOENCODING="ascii")
    assert (code, err) == (0, "")
    assert out.count("\n") > 10
    assert out.isascii()


@pytest.mark.parametrize(
    "command",
    ["evaluate r.mcap", "info r.mcap --json", "simulate --list", "simulate shi-sim -o -", "--help"],
)
@pytest.mark.parametrize(
    ("where", "why"), [(">&-", "Bad file descriptor"), ("> /dev/full", "No space left on device")]
)
def test_a_standard_output_that_takes_nothing_is_one_line(result, command, where, why):
    code, _, err = shell(f"clt {command} {where}", result)
    assert code == 1, err
    assert re.fullmatch(rf"clt: error: standard output: {why}\n", err)


def test_a_closed_standard_output_that_is_not_needed(result):
    assert shell("clt plot r.mcap -o r.svg -q >&-", result) == (0, "", "")
    assert (result / "r.svg").stat().st_size > 1000


def test_a_closed_standard_error(result):
    code, out, _ = shell("clt evaluate r.mcap --json 2>&-", result)
    assert (code, out[:1]) == (0, "{")
    assert shell("clt info none.mcap 2>&-", result)[:2] == (1, "")


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("info", "none.mcap", "--json"), 1),
        (("evaluate", "none.mcap", "--json"), 1),
        (("settings", "nonsense", "--json"), 2),
        (("localize", "none.mcap", "-o", "out.mcap", "--filter", "none", "--json"), 2),
        (("localize", "--json"), 2),
        (("info", "--json", "a", "b"), 2),
        (("evaluate", "a", "--aling", "x", "--json"), 2),
        (("simulate", "--seed", "x", "--json"), 2),
        (("nonsense", "--json"), 2),
        (("info", ".", "--json"), 1),
    ],
)
def test_with_json_an_error_is_an_object_too(clt, words, code):
    """Its text is that of the line on standard error."""
    done = clt(*words)
    printed = json.loads(done.stdout)
    assert (done.exit_code, printed["exit_code"]) == (code, code)
    assert done.stderr == f"clt: error: {printed['error']}\n"


def test_an_error_of_an_algorithm_names_the_log(result, monkeypatch):
    """`clt observability` has nothing to analyse: the algorithm does not know any file."""
    monkeypatch.chdir(result)
    recording = load(Path("r.mcap")).recording
    with Path("bare.mcap").open("wb") as file:
        save(file, replace(recording, odometry={}, estimate={}, dead_reckoning={}), {})
    done = CliRunner().invoke(app, ["observability", "bare.mcap"])
    assert done.exit_code == 1
    assert done.stderr.startswith("clt: error: bare.mcap: neither odometry nor an estimate")
    done = CliRunner().invoke(app, ["observability", "-"], input=Path("bare.mcap").read_bytes())
    assert done.stderr.startswith("clt: error: standard input: neither odometry")
    done = CliRunner().invoke(app, ["localize", "bare.mcap", "-o", "x.mcap"])
    assert done.stderr.count("bare.mcap") == 1


def test_no_object_goes_where_the_result_was_to_go(clt):
    for words in (
        "none.mcap -o -",
        "none.mcap -o - --foo",
        "none.mcap -o- --foo",
        "--output=- a b",
    ):
        done = clt("localize", *words.split(), "--json")
        assert (done.exit_code, done.stdout) == (2, "")
    done = clt("info", "a", "b", "--", "--json")
    assert (done.exit_code, done.stdout) == (2, "")


def test_a_closed_standard_input_is_one_line(tmp_path):
    code, out, err = shell("clt info - <&-", tmp_path)
    assert (code, out) == (1, "")
    assert err == "clt: error: standard input is closed; give a log's name or a pipe\n"
