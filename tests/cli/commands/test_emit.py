from __future__ import annotations

import json
import re

import pytest
import typer
from typer.testing import CliRunner

from clt.cli.app import app
from clt.devices.decoders.table import make_decoder
from clt.devices.encoders.table import ENCODERS


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("emit") / "log.mcap"
    assert run("simulate", "shi-sim", "-o", path, "--duration", 1).exit_code == 0
    return path


def run(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def test_help_names_every_protocol():
    command = typer.main.get_command(app).load("emit")
    text = next(one.help for one in command.params if one.name == "proto")
    assert set(re.findall(r"[a-z][\w-]+", text)) - {"or"} == set(ENCODERS)


def test_a_file(log, tmp_path):
    path = tmp_path / "rcl.bin"
    done = run("emit", log, "--proto", "rcl", "-o", path)
    assert done.exit_code == 0, done.output
    source = f"uwb=file:{path},proto=rcl,map=1:R1+2:R2+3:R3+4:R4+5:R5"
    assert f"read back with: clt record -o LOG --source {source}" in done.stderr
    assert "not in the stream, as rcl reports none: samples 105 of truth" in done.stderr
    decoder = make_decoder("rcl", {}, "uwb")
    assert len(decoder.feed(path.read_bytes())) == 20 * 13
    again = run("emit", log, "--proto", "rcl", "-o", path)
    assert again.exit_code == 1
    assert "exists; use --force" in again.stderr
    assert run("emit", log, "--proto", "rcl", "-o", path, "--force", "-q").stderr == ""


def test_standard_output_holds_the_stream_alone(log):
    done = run("emit", log, "--proto", "ndjson", "-o", "-", "--rate", 0, "-q")
    assert (done.exit_code, done.stderr) == (0, "")
    kinds = [json.loads(line)["type"] for line in done.stdout.splitlines()]
    assert {one: kinds.count(one) for one in set(kinds)} == {"odom": 60, "range": 200, "pose": 105}


def test_what_cannot_be_carried_is_counted(log, tmp_path):
    path = tmp_path / "trek.txt"
    done = run("emit", log, "--proto", "trek1000", "-o", path, "--json")
    assert done.exit_code == 3
    found = json.loads(done.stdout)
    assert found["left_out"] == {"not_carried_pair": 60}
    assert found["map"] == {"a0": "R1", "a1": "R2", "t0": "R3", "t1": "R4", "t2": "R5"}
    assert found["samples"] == {"ranges": 200}
    assert found["bytes"] == path.stat().st_size
    assert [one["kind"] for one in found["diagnostics"]] == ["not_reported", "left_out"]
    line = "trek1000 cannot carry 60 ranges between two tags or two anchors: left out"
    assert found["warnings"] == [line]
    assert f"clt: warning: {line}" in done.stderr


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--proto", "rlc", "-o", "x"], 2, "--proto rlc: unknown, did you mean `rcl`?"),
        (["--proto", "vesc", "-o", "x"], 2, "--proto vesc: a stream of one robot; add --robot"),
        (["--proto", "vesc", "--robot", "R9", "-o", "x"], 2, "did you mean `R"),
        (["--proto", "rcl", "--robot", "R3", "-o", "x"], 2, "a rcl stream holds all robots"),
        (["--proto", "rcl", "-o", "x", "--rate", "-1"], 2, "--rate -1: give a number from 0"),
        (["--proto", "rcl", "-o", "tcp:h"], 2, "tcp:h: no port; write tcp:HOST:PORT"),
        (["--proto", "rcl", "-o", "upd:h:1"], 2, "-o upd:h:1: unknown scheme, did you mean `udp`"),
        (["--proto", "rcl", "-o", "-", "--json"], 2, "both want standard output"),
        (["--proto", "lps-sniffer", "-o", "x"], 1, "no packets, which is what lps-sniffer carr"),
        (["--proto", "rcl", "-o", "no/x"], 1, "no/x: no directory no; create it first"),
        (["--proto", "rcl", "-o", "serial:/dev/no"], 1, "cannot be opened: No such file"),
    ],
)
def test_one_line(log, words, code, text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = run("emit", log, *words, "-q")
    assert done.exit_code == code
    assert text in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
