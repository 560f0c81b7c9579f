"""`clt info` and `clt recover` as whole commands."""

from __future__ import annotations

import json
import time
from io import BytesIO

import pytest
from mcap.reader import make_reader
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.recording import Robot, Team
from clt.log.recording.metadata import TEAM_RECORD, encode_team
from tests.log.logs import odometry_message, range_message, small_log, write_log
from tests.machine import times_slower

SECOND = 10**9


@pytest.fixture
def clt():
    """Run a command; returns exit code, stdout, stderr."""

    def run(*words, stdin=None):
        done = CliRunner().invoke(app, [str(word) for word in words], input=stdin)
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(small_log())
    return path


def damaged(path):
    data = bytearray(small_log())
    data[data.index(b"zstd") + 20] ^= 0xFF
    path.write_bytes(data)
    return path


def messages(data):
    """All messages by the official reader, checksums and all."""
    reader = make_reader(BytesIO(data), validate_crcs=True)
    return [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]


def test_json_is_one_object(clt, log):
    code, out, err = clt("info", log, "--json")
    printed = json.loads(out)
    assert (code, err) == (0, "")
    assert printed["log"] == str(log)
    assert printed["library"] == "tests"
    assert printed["duration"] == pytest.approx(1.99)
    assert printed["ranges"] == 200
    assert printed["truth"] is True
    assert printed["estimate"] is False
    assert printed["faults"] == []
    assert printed["pairs"] == [
        {
            "source": "R1",
            "target": "R2",
            "count": 200,
            "rate": pytest.approx(100.0),
            "longest_gap": pytest.approx(0.01),
            "gaps": 0,
        }
    ]
    assert printed["robots"]["R1"]["odometry"]["rate"] == pytest.approx(20.0)
    assert printed["robots"]["R1"]["truth"]["count"] == 10
    assert printed["robots"]["R2"]["truth"] is None
    assert {topic["name"]: topic["count"] for topic in printed["topics"]}["/R2/odom"] == 40


def test_text_names_robots_pairs_and_gaps(clt, tmp_path):
    stamps = [SECOND * k // 10 for k in range(100) if not 40 < k < 60]
    team = Team((Robot("R1", 1), Robot("A1", 9, static=True, position=(1.5, 2.0))))
    path = tmp_path / "gap.mcap"
    path.write_bytes(
        write_log(
            {
                "/R1/uwb/range": ("range", [(t, range_message(t, 1, 9, 2.0)) for t in stamps]),
                "/R1/odom": ("odometry", [(t, odometry_message(t, 1.0, 0.0)) for t in stamps]),
            },
            [
                (TEAM_RECORD, encode_team(team)),
                ("clt.run", {"command": "clt simulate", "seed": "7"}),
            ],
        )
    )
    code, out, err = clt("info", path)
    assert (code, err) == (0, "")
    assert "9.9 s" in out
    assert "1 moving and 1 static robots" in out
    assert "static at (1.5, 2) m" in out
    assert "R1 -> A1" in out
    assert "81 at 8.1 Hz, 1 gaps up to 2 s" in out
    assert "truth: none" in out
    assert "command: clt simulate" in out
    assert "no faults" in out


def test_a_foreign_log_shows_its_topics(clt, tmp_path):
    path = tmp_path / "x.mcap"
    path.write_bytes(write_log({"/vicon": ("odometry", [(1, odometry_message(1, 0.0, 0.0))])}))
    code, out, err = clt("info", path)
    assert code == 0
    assert "/vicon" in out
    assert "nav_msgs/Odometry" in out
    assert "--streams" in err
    streams = tmp_path / "s.toml"
    streams.write_text('[robots.tb]\nodometry = "/vicon"\n')
    code, out, err = clt("info", path, "--streams", streams, "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["robots"]["tb"]["odometry"]["count"] == 1


def test_lost_data_is_exit_code_3(clt, tmp_path):
    path = damaged(tmp_path / "x.mcap")
    code, out, err = clt("info", path, "--json", "-q")
    assert code == 3
    (fault,) = json.loads(out)["faults"]
    assert fault["kind"] == "chunk"
    assert fault["data_lost"] is True
    assert err == f"clt: warning: {fault['text']}\n"
    (found,) = json.loads(out)["diagnostics"]
    assert (found["kind"], found["severity"], found["text"]) == ("chunk", "partial", fault["text"])


def test_standard_input(clt, log):
    code, out, _ = clt("info", "-", "--json", stdin=log.read_bytes())
    assert code == 0
    assert json.loads(out)["log"] == "standard input"


@pytest.mark.parametrize("data", [b"", b"not a log at all"])
def test_what_is_no_log_is_one_line_and_exit_code_1(clt, tmp_path, data):
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    for words in (["info", path], ["recover", path, "-o", tmp_path / "y.mcap"]):
        code, out, err = clt(*words)
        assert (code, out) == (1, "")
        assert err.startswith(f"clt: error: {path}: is ")
        assert err.count("\n") == 1
    assert not (tmp_path / "y.mcap").exists()


def test_a_missing_log(clt, tmp_path):
    code, _, err = clt("info", tmp_path / "none.mcap")
    assert code == 1
    assert err == f"clt: error: {tmp_path / 'none.mcap'}: No such file or directory\n"


def test_a_third_of_a_million_messages_within_a_second(clt, tmp_path):
    """Ten times faster than that is usual; CPU time, since machines differ in company."""
    rows = [
        (k * 10**6, range_message(k * 10**6, 1 + k % 5, 1 + (k + 1) % 5, 3.0))
        for k in range(330_000)
    ]
    path = tmp_path / "big.mcap"
    path.write_bytes(write_log({"/R1/uwb/range": ("range", rows)}, options={"chunk_size": 1 << 20}))
    began = time.process_time()
    code, out, _ = clt("info", path, "--json")
    assert time.process_time() - began < 5.0 * times_slower()
    assert code == 0
    assert json.loads(out)["ranges"] == 330_000


def test_recover_saves_all_but_the_damage(clt, tmp_path):
    path, saved = damaged(tmp_path / "x.mcap"), tmp_path / "saved.mcap"
    code, out, err = clt("recover", path, "-o", saved)
    assert (code, out) == (3, "")
    assert "chunk skipped" in err
    assert "some data is lost" in err
    whole, kept = messages(small_log()), messages(saved.read_bytes())
    assert 0.8 * len(whole) < len(kept) < len(whole)
    assert set(kept) < set(whole)
    assert clt("info", saved)[0] == 0


def test_recover_of_a_cut_log(clt, tmp_path):
    path, saved = tmp_path / "x.mcap", tmp_path / "saved.mcap"
    path.write_bytes(small_log()[: len(small_log()) // 2])
    code, out, _ = clt("recover", path, "-o", saved, "--json")
    printed = json.loads(out)
    assert code == 3
    assert [fault["kind"] for fault in printed["faults"]] == ["truncated"]
    assert [one["kind"] for one in printed["diagnostics"]] == ["truncated"]
    assert printed["messages"] == len(messages(saved.read_bytes())) > 100


def test_recover_of_a_sound_log_keeps_everything(clt, tmp_path):
    """Attachments with their times, metadata, foreign encodings; through standard output."""
    data = write_log(
        {"/R1/odom": ("odometry", [(5, odometry_message(5, 0.0, 0.0))])},
        [("clt.run", {"a": "b"})],
        [("n", "text/plain", b"document")],
        profile="",
    )
    path = tmp_path / "x.mcap"
    path.write_bytes(data)
    done = CliRunner().invoke(app, ["recover", str(path), "-o", "-"])
    assert done.exit_code == 0
    assert messages(done.stdout_bytes) == messages(data)
    reader = make_reader(BytesIO(done.stdout_bytes))
    assert reader.get_header().profile == ""
    assert reader.get_header().library == "tests"
    assert [item.data for item in reader.iter_attachments()] == [b"document"]
    assert [item.metadata for item in reader.iter_metadata()] == [{"a": "b"}]
    assert "nothing lost" in done.stderr


def test_recover_overwrites_only_by_force(clt, log, tmp_path):
    saved = tmp_path / "saved.mcap"
    saved.write_bytes(b"mine")
    code, _, err = clt("recover", log, "-o", saved)
    assert code == 1
    assert "--force" in err
    assert saved.read_bytes() == b"mine"
    assert clt("recover", log, "-o", saved, "--force")[0] == 0
    assert messages(saved.read_bytes()) == messages(small_log())
    assert clt("recover", log, "-o", log, "--force")[0] == 1
    assert log.read_bytes() == small_log()
