"""What holds for every command: its options, its help, the environment, the standard streams."""

from __future__ import annotations

import os
import re
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from clt.cli.app import COMMANDS, app
from clt.cli.lazy import function

FLAGS = ("--output", "-o", "--force", "--json", "--quiet", "-q", "--verbose", "-v", "--help", "-h")
HEAVY = ("numpy", "pydantic", "numba", "matplotlib", "mcap", "clt.cli.demo", "clt.cli.localize")


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
    text = function(COMMANDS[name]).__doc__ or ""
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
    assert listed == list(COMMANDS)
    code = f"import sys, clt.cli.app; print([n for n in {HEAVY!r} if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_misspelt_command_is_refused_with_the_nearest_named(clt):
    done = clt("localise", COLUMNS="100")
    assert done.exit_code == 2
    assert "No such command 'localise'. Did you mean 'localize'?" in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize(
    ("variable", "hint"),
    [("CLT_FOO", ""), ("CLT_SEDE", ", did you mean `CLT_SEED`?")],
)
def test_every_command_refuses_unknown_variables_alike(clt, tmp_path, name, variable, hint):
    words = {"demo": ["new"], "import": ["thu", "in", "-o", "out"]}.get(name, ["in", "-o", "out"])
    done = clt(name, *words, **{variable: "1"})
    told = f"clt: error: environment variable {variable}: unknown key{hint}\n"
    assert (done.exit_code, done.stdout, done.stderr) == (2, "", told)
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
    assert re.fullmatch(rf"clt: error: (standard output: )?{why}\n", err)


def test_a_closed_standard_output_that_is_not_needed(result):
    assert shell("clt plot r.mcap -o r.svg -q >&-", result) == (0, "", "")
    assert (result / "r.svg").stat().st_size > 1000


def test_a_closed_standard_error(result):
    code, out, _ = shell("clt evaluate r.mcap --json 2>&-", result)
    assert (code, out[:1]) == (0, "{")
    assert shell("clt info none.mcap 2>&-", result)[:2] == (1, "")
