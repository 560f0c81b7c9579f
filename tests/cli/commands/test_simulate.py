import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from clt.cli.app import app
from clt.sim.scenario import effective_toml, load_scenario

SHORT = ("simulate", "shi-sim", "--duration", "2")


@pytest.fixture
def clt(monkeypatch, tmp_path):
    """Run one command in an empty folder with nothing set in the environment."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)

    def run(*words, **environment):
        return CliRunner().invoke(app, list(words), env=environment)

    return run


def test_same_seed_same_bytes_wherever_the_log_goes(clt, tmp_path):
    assert clt(*SHORT, "-o", "a.mcap").exit_code == 0
    (tmp_path / "deep").mkdir()
    assert clt(*SHORT, "-q", "-o", "deep/b.mcap").exit_code == 0
    assert clt(*SHORT, "--force", "--json", "-o", "deep/c.mcap").exit_code == 0
    first = (tmp_path / "a.mcap").read_bytes()
    assert (tmp_path / "deep/b.mcap").read_bytes() == first
    assert (tmp_path / "deep/c.mcap").read_bytes() == first
    assert clt(*SHORT, "--seed", "2", "-o", "d.mcap").exit_code == 0
    assert (tmp_path / "d.mcap").read_bytes() != first


def test_same_bytes_on_a_processor_with_less(clt, tmp_path):
    """As if the vector units and fused multiply-add, which numpy and glibc choose by, were off."""
    words = ("simulate", "shi-sim", "--duration", "20")
    assert clt(*words, "-o", "a.mcap").exit_code == 0
    units = " ".join(np.show_config(mode="dicts")["SIMD Extensions"].get("found", []))
    glibc = "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX,-FMA,-FMA4"
    done = subprocess.run(
        [sys.executable, "-m", "clt", *words, "-o", "-"],
        env=os.environ | {"NPY_DISABLE_CPU_FEATURES": units, "GLIBC_TUNABLES": glibc},
        capture_output=True,
        check=True,
    )
    assert done.stdout == (tmp_path / "a.mcap").read_bytes()


def test_standard_output_holds_the_same_log(clt, tmp_path):
    assert clt(*SHORT, "-o", "a.mcap").exit_code == 0
    done = subprocess.run(
        [sys.executable, "-m", "clt", *SHORT, "-o", "-"], capture_output=True, check=True
    )
    assert done.stdout == (tmp_path / "a.mcap").read_bytes()
    assert done.stderr.decode().count("\n") == 1


def test_one_line_says_what_was_written(clt):
    done = clt(*SHORT, "-o", "a.mcap")
    assert done.stdout == ""
    assert done.stderr == (
        "a.mcap: shi-sim, seed 1, 2 s, 3 moving and 2 static robots; "
        "120 odometry, 400 ranges, 205 truth\n"
    )
    assert clt(*SHORT, "-q", "-o", "b.mcap").output == ""


def test_json(clt):
    done = clt(*SHORT, "-q", "--json", "-o", "a.mcap")
    assert json.loads(done.stdout) == {
        "log": "a.mcap",
        "robots": ["R1", "R2", "R3", "R4", "R5"],
        "messages": {"odometry": 120, "ranges": 400, "truth": 205},
        "diagnostics": [],
    }


def test_list(clt):
    lines = clt("simulate", "--list").stdout.splitlines()
    listed = json.loads(clt("simulate", "--list", "--json").stdout)
    assert [line.split()[0] for line in lines] == list(listed)
    assert all(line.endswith(listed[line.split()[0]]) for line in lines)
    assert {"shi-sim", "araki-five", "freeman", "li-two"} <= set(listed)


def test_show_prints_a_scenario_that_gives_the_same_data(clt, tmp_path):
    words = ("--set", "team.moving=4", "--set", "sensors.range.sigma=0.3", "--seed", "9")
    done = clt(*SHORT, *words, "--show")
    (tmp_path / "shown.toml").write_text(done.stdout)
    overrides = {"duration": 2.0, "team.moving": 4, "sensors.range.sigma": 0.3, "seed": 9}
    assert load_scenario("shown.toml") == load_scenario("shi-sim", overrides)
    assert list(tmp_path.iterdir()) == [tmp_path / "shown.toml"]
    shown = json.loads(clt(*SHORT, *words, "--show", "--json").stdout)
    assert shown["team"]["moving"] == 4


def test_run_record_and_attachment(clt, tmp_path):
    words = ("--seed", "7", "--set", "outliers.share=0.1")
    assert clt(*SHORT, *words, "-o", "a.mcap", CLT_OUTLIERS__MEAN="0.3").exit_code == 0
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        run = {record.name: record.metadata for record in reader.iter_metadata()}["clt.run"]
        (attachment,) = reader.iter_attachments()
    expected = load_scenario(
        "shi-sim", {"duration": 2.0, "seed": 7, "outliers.share": 0.1, "outliers.mean": 0.3}
    )
    assert run["command"] == "clt simulate shi-sim --seed 7 --duration 2.0 --set outliers.share=0.1"
    assert run["seed"] == "7"
    assert json.loads(run["config"]) == expected.model_dump(mode="json")
    assert attachment.name == "scenario.toml"
    assert attachment.data == effective_toml(expected).encode()


def test_precedence(clt, tmp_path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\nduration = 5\nseed = 3\n[team]\nmoving = 2\nstatic = 1\n'
    )

    def shown(*words, **environment):
        return json.loads(clt("simulate", "mine.toml", "--show", "--json", *words, **environment)
                          .stdout)  # fmt: skip

    assert shown()["seed"] == 3
    assert shown(CLT_SEED="4")["seed"] == 4
    assert shown("--set", "seed=5", CLT_SEED="4")["seed"] == 5
    assert shown("--set", "seed=5", "--seed", "6", CLT_SEED="4")["seed"] == 6
    assert shown(CLT_SENSORS__RANGE__SIGMA="0.5")["sensors"]["range"]["sigma"] == 0.5


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("shi-sm", "-o", "a.mcap"), "did you mean `shi-sim`?"),
        (("none.toml", "-o", "a.mcap"), "no such scenario file"),
        ((), "no SCENARIO given"),
        (("shi-sim",), "no output given"),
        (("shi-sim", "-o", "-", "--json"), "both want standard output"),
        (("shi-sim", "-o", "a.mcap", "--set", "durration=3"), "did you mean `duration`?"),
        (("shi-sim", "-o", "a.mcap", "--set", "duration"), "expected KEY=VALUE"),
        (("shi-sim", "-o", "a.mcap", "--duration", "-1"), "must be above 0"),
        (("shi-sim", "-o", "a.mcap", "--duration", "nan"), "finite number"),
        (("shi-sim", "-o", "a.mcap", "--set", "network.recorder=R9"), "no robot R9 in the team"),
        (("shi-sim", "-o", "a.mcap", "--set", "network.clock=1"), "did you mean `clock_sd`?"),
    ],
)
def test_wrong_usage_ends_in_one_line_and_code_2(clt, tmp_path, words, text):
    done = clt("simulate", *words)
    assert done.exit_code == 2
    assert done.stderr.startswith("clt: error: ")
    assert done.stderr.count("\n") == 1
    assert text in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_unknown_variables_are_refused(clt):
    done = clt(*SHORT, "-o", "a.mcap", CLT_SEDE="3")
    assert done.exit_code == 2
    assert "CLT_SEDE: unknown key, did you mean `CLT_SEED`?" in done.stderr


def test_a_filter_setting_in_the_environment_is_no_fault(clt):
    assert clt(*SHORT, "-o", "a.mcap", CLT_GATE="9").exit_code == 0


def test_an_existing_log_stays(clt, tmp_path):
    (tmp_path / "a.mcap").write_bytes(b"mine")
    done = clt(*SHORT, "-o", "a.mcap")
    assert done.exit_code == 1
    assert "--force" in done.stderr
    assert (tmp_path / "a.mcap").read_bytes() == b"mine"
    assert clt(*SHORT, "-o", "a.mcap", "--force").exit_code == 0
    assert (tmp_path / "a.mcap").stat().st_size > 1000


REAL = (
    "sensors.odometry.scale_sd=0.03", "sensors.odometry.bias_sd=0.03",
    "network.delay_mean=0.084", "network.delay_sd=0.071",
    "network.clock_mean=0.002", "network.clock_sd=0.009", "network.batch=0.03",
)  # fmt: skip


def test_of_the_documented_reality_only_the_overtaking_is_warned_of(clt):
    """Stamps of fast clocks, some ahead of their own arrival, are no fault."""
    words = [word for key in REAL for word in ("--set", key)]
    assert clt("simulate", "araki-five", *words, "-o", "a.mcap").exit_code == 0
    info = clt("info", "a.mcap", "--json")
    assert info.exit_code == 0
    assert {fault["kind"] for fault in json.loads(info.stdout)["faults"]} == {"backwards"}


def test_a_page_documents_that_reality():
    page = (Path(__file__).parents[3] / "docs" / "how-to" / "simulate.md").read_text()
    assert all(f"--set {key}" in page for key in REAL)
