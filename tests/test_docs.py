"""Every command of README.md and of the pages under docs/ does what its page says.

Each page's ```sh blocks run in order in a folder of their own, in which `bag` is a ROS 2 bag of a
small team. A line ends with exit code 0 unless it is followed by `# exit code N`. Blocks behind
`<!-- not run: REASON -->` are only held against the options that the commands have.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import shlex
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest
import typer
from typer.testing import CliRunner

from clt.cli.app import COMMANDS, app
from tests.log.ros_bags import ros_bag, team

ROOT = Path(__file__).parents[1]
GENERATED = {"commands.md", "settings.md", "files.md", "topics.md", "messages.md"}
PAGES = [
    ROOT / "README.md",
    *(
        page
        for page in sorted((ROOT / "docs").rglob("*.md"))
        if "_build" not in page.parts and page.name not in GENERATED
    ),
]
BLOCK = re.compile(
    r"(?ms)^(?P<mark><!-- not run: [^>\n]+ -->\n)?```(?P<kind>\w+)\n(?P<text>.*?)^```"
)
FILE = re.compile(r"(?ms)^```toml\n# (?P<name>[\w.-]+\.toml)\n(?P<text>.*?)^```")
"""A file that the commands of a page read: its name stands in the first line."""
EXIT_CODE = re.compile(r"#.*\bexit code (\d+)")
TARGETS = set(re.findall(r"(?m)^(\w+):", (ROOT / "Makefile").read_text()))


class Line(NamedTuple):
    """One line of a shell."""

    words: list[str]
    code: int
    run: bool


def lines_of(page):
    """The command lines of a page in order; of consoles those behind the prompt."""
    found = []
    for block in BLOCK.finditer(page.read_text()):
        text = block["text"].replace("\\\n", " ")
        if block["kind"] == "console":
            text = "\n".join(line[2:] for line in text.splitlines() if line.startswith("$ "))
        elif block["kind"] != "sh":
            continue
        for line in filter(None, map(str.strip, text.splitlines())):
            code = EXIT_CODE.search(line)
            words = shlex.split(line, comments=True)
            found.append(Line(words, int(code[1]) if code else 0, block["mark"] is None))
    return found


def split_at(words, sign):
    """The words between signs."""
    parts = [[]]
    for word in words:
        if word == sign:
            parts.append([])
        else:
            parts[-1].append(word)
    return parts


@functools.cache
def options_of(name):
    """Every spelling of every option of a command."""
    command = typer.main.get_command(app).load(name)
    spelt = {word for one in command.params for word in (*one.opts, *one.secondary_opts)}
    return spelt | {"-h", "--help"}


def check_options(words):
    """Raise AssertionError for a command or an option that is not there."""
    if words[1].startswith("-") or words[1].isupper():
        return
    assert words[1] in COMMANDS, words
    known = options_of(words[1])
    for word in words[2:]:
        if word in {"|", "||"}:
            break
        if re.match(r"--?[a-z]", word):
            assert word.partition("=")[0] in known, words


def run_clt(words, stdin):
    """Run one command in this process."""
    done = CliRunner().invoke(app, words[1:], input=stdin)
    return done.exit_code, done.stdout_bytes, done.output


def run_line(line):
    """Run one line: `clt`, alone or in a pipe, or what makes its inputs."""
    if line.words[0] == "head":
        subprocess.run(shlex.join(line.words).replace("'>'", ">"), shell=True, check=True)
        return
    data = None
    for words in split_at(line.words, "|"):
        code, data, said = run_clt(words, data)
        assert code == line.code, f"{shlex.join(line.words)}: exit code {code}\n{said}"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder to work in, with nothing set in the environment."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)
    return tmp_path


def is_command(line):
    """Whether a line is one that pages may have run; others are checked in another way."""
    return line.run and line.words[0] in {"clt", "head"}


RUN = [page for page in PAGES if any(map(is_command, lines_of(page)))]


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, folder):
    lines = [line for line in lines_of(page) if is_command(line)]
    if any("bag" in line.words for line in lines):
        ros_bag(folder / "bag", team(20.0), mcap=True)
    for file in FILE.finditer(page.read_text()):
        (folder / file["name"]).write_text(file["text"])
    for line in lines:
        run_line(line)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_other_line_is_known(page):
    for line in lines_of(page):
        first = line.words[0]
        if first == "clt":
            check_options(line.words)
        elif first == "make":
            assert line.words[1] in TARGETS, line
        elif first == "python":
            assert (ROOT / line.words[1]).is_file(), line
        else:
            assert first in {"head", "pip"} or not line.run, line


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_and_files_named_in_the_text_exist(page):
    text = BLOCK.sub("", page.read_text())
    for command in re.findall(r"`(clt [^`]+)`", text):
        check_options(command.split())
    for path in re.findall(r"`((?:benchmarks|tests|clt|schemas)/[\w./]+)", text):
        assert (ROOT / path.rstrip("./")).exists() or len(list(ROOT.glob(f"{path}*"))) > 0, path


def test_pages_run_and_pages_are_marked():
    """The collection finds what it is for."""
    lines = [line for page in PAGES for line in lines_of(page)]
    ran = {line.words[1] for line in lines if is_command(line) and line.words[0] == "clt"}
    assert set(COMMANDS) - ran <= {"demo", "compile"}  # tests/cli/ runs these
    assert sum(not line.run for line in lines) >= 5
    assert len(RUN) >= 12


def test_every_table_of_the_benchmarks_is_shown_with_its_command():
    text = (ROOT / "docs" / "benchmarks.md").read_text()
    for table in (ROOT / "benchmarks" / "results").glob("*.md"):
        shown = rf"```sh\npython benchmarks/{table.stem}\.py[^\n]*\n```[^`]*"
        assert re.search(rf"{shown}```{{include}} [./]*benchmarks/results/{table.name}", text), (
            table
        )


def test_every_page_is_in_the_contents():
    index = (ROOT / "docs" / "index.md").read_text()
    listed = {
        line for block in re.findall(r"(?s)```{toctree}(.*?)```", index) for line in block.split()
    }
    pages = {str(page.relative_to(ROOT / "docs").with_suffix("")) for page in PAGES[1:]}
    assert pages - {"index"} <= listed
    assert {f"reference/{Path(name).stem}" for name in GENERATED} <= listed


def test_links_of_the_readme_lead_somewhere():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 150
    for target in re.findall(r"\]\(([^)#]+)", text):
        assert (ROOT / target).exists(), target


@pytest.fixture(scope="module")
def reference():
    """The script that writes the reference."""
    place = ROOT / "docs" / "reference" / "generate.py"
    spec = importlib.util.spec_from_file_location("generate", place)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_reference_holds_every_option_and_every_key(reference):
    commands, settings = reference.commands_page(), reference.settings_page()
    for name in COMMANDS:
        section = commands.partition(f"## `clt {name}`")[2].partition("\n## ")[0]
        for option in options_of(name) - {"-h", "--help"}:
            if option.startswith("-"):
                assert re.search(rf"`{option}[ `]", section), (name, option)
    for key in ("noise.sigma_range", "mixture.components", "sensors.range.sigma", "network.loss"):
        assert f"| `{key}` |" in settings


def test_no_key_of_the_reference_is_without_a_line(reference):
    assert set(reference.PAGES) == GENERATED
    for page in (reference.settings_page(), reference.files_page(), reference.topics_page()):
        rows = [line for line in page.splitlines() if line.startswith("| `")]
        assert len(rows) > 5
        assert [row for row in rows if row.endswith(("| - |", "|  |"))] == []
