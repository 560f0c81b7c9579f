from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from clt.cli.app import app
from clt.log.recording.load import load

FILES = ["result.mcap", "result.png", "shi-sim.mcap"]


def clt(*words: object) -> Result:
    return CliRunner().invoke(app, list(map(str, words)))


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    return folder, clt("demo", folder)


def test_files(ran: tuple[Path, Result]) -> None:
    folder, result = ran
    assert result.exit_code == 0, result.stderr
    assert sorted(path.name for path in folder.iterdir()) == FILES
    assert (folder / "result.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")


def test_says_where_and_how_well(ran: tuple[Path, Result]) -> None:
    folder, result = ran
    last = result.stdout.splitlines()[-3:]
    assert [Path(line.split()[-1]).name for line in last] == [FILES[2], FILES[0], FILES[1]]
    for name in FILES:
        assert str(folder / name) in result.stdout
    for robot in ("R3", "R4", "R5"):
        assert robot in result.stdout


def test_its_command_does_the_same(ran: tuple[Path, Result], tmp_path: Path) -> None:
    """The first command that the demo shows, typed by hand, simulates the same."""
    folder, result = ran
    shown = next(line for line in result.stdout.splitlines() if line.startswith("$ clt simulate"))
    again = tmp_path / "again.mcap"
    words = shown.replace(str(folder / "shi-sim.mcap"), str(again)).split()[2:]
    assert clt(*words).exit_code == 0
    first, second = (load(path).recording for path in (folder / "shi-sim.mcap", again))
    assert len(first.ranges.raw) > 1000
    assert np.array_equal(first.ranges.raw, second.ranges.raw)
    assert first.run["seed"] == second.run["seed"] == "1"


def test_the_result_records_the_command_that_is_shown(ran: tuple[Path, Result]) -> None:
    folder, result = ran
    shown = next(line for line in result.stdout.splitlines() if line.startswith("$ clt localize"))
    recorded = load(folder / "result.mcap").recording.run["command"]
    assert recorded == shown.removeprefix("$ ").removesuffix(f" -o {folder / 'result.mcap'}")


def test_json_and_nothing_else(ran: tuple[Path, Result], tmp_path: Path) -> None:
    folder, said = ran
    result = clt("demo", tmp_path, "--json", "-q")
    assert (result.exit_code, result.stderr) == (0, "")
    printed = json.loads(result.stdout)
    assert [Path(path).name for path in printed["files"].values()] == [FILES[2], FILES[0], FILES[1]]
    shown = [line[2:] for line in said.stdout.splitlines() if line.startswith("$ ")]
    assert printed["commands"] == [line.replace(str(folder), str(tmp_path)) for line in shown]
    assert printed["evaluation"]["team"]["estimate"]["ape"]["rmse"] < 0.1


def test_existing_files_are_kept(ran: tuple[Path, Result]) -> None:
    folder, _ = ran
    before = (folder / "result.png").stat().st_mtime_ns
    refused = clt("demo", folder)
    assert refused.exit_code == 1
    assert "use --force" in refused.stderr
    assert (folder / "result.png").stat().st_mtime_ns == before


def test_directory_that_is_a_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("")
    result = clt("demo", path)
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1
