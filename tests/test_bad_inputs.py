"""Every bad input on every command that can meet it: the exit code, one line, nothing half done."""

from __future__ import annotations

import json
import math
import os
import re
import resource
import struct
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
import zstandard
from mcap.writer import Writer
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.recording import Robot, Team
from clt.log.recording.metadata import TEAM_RECORD, encode_team
from tests.log.logs import (
    Cdr,
    odometry_message,
    pose_message,
    range_message,
    write_log,
)

SECOND = 10**9
BEGIN = 1_700_000_000 * SECOND
NAN = math.nan
CREW = Team(
    (
        Robot("R1", 1, sigma_v=0.2, sigma_omega=0.1),
        Robot("A1", 7, static=True, position=(0.0, 3.0)),
        Robot("A2", 8, static=True, position=(4.0, -1.0)),
    ),
    range_sigma=0.1,
)
LINE = "clt: error: "


def stamps(seconds, rate):
    return [BEGIN + k * SECOND // rate for k in range(1, seconds * rate + 1)]


def place(t):
    """R1 drives along x at 0.5 m/s."""
    return 0.5 * (t - BEGIN) / SECOND


def distance(t, anchor):
    x, y = CREW.robots[anchor].position
    return math.hypot(place(t) - x, y)


def measured():
    """The messages of a short drive, by topic: what `localize` reads."""
    return {
        "/R1/odom": ("odometry", [(t, odometry_message(t, 0.5, 0.0)) for t in stamps(4, 20)]),
        "/R1/uwb/range": (
            "range",
            [
                (t, range_message(t, 1, 6 + anchor, distance(t, anchor)))
                for t in stamps(4, 20)
                for anchor in (1, 2)
            ],
        ),
        "/R1/ground_truth": ("pose", [(t, pose_message(t, place(t), 0)) for t in [
            BEGIN, *stamps(4, 20)]]),
    }  # fmt: skip


COVARIANCE = [0.01 * (k in {0, 7, 14, 21, 28, 35}) for k in range(36)]


def estimated():
    """The messages of a result: what `evaluate` and `plot` read."""
    rows = [(t, pose_message(t, place(t) + 0.05, 0.02, covariance=COVARIANCE)) for t in
            stamps(4, 20)]  # fmt: skip
    innovation = [
        (t, Cdr().put("i", t // SECOND).put("I", t % SECOND).put("H", 1, 7).put("B", 1)
         .put("d", 0.05, 0.1, 0.25).done())
        for t in stamps(4, 20)
    ]  # fmt: skip
    return {
        "/R1/ground_truth": measured()["/R1/ground_truth"],
        "/R1/estimate": ("covariance", rows),
        "/R1/dead_reckoning": ("covariance", rows),
        "/clt/innovation": ("innovation", innovation),
    }


def written(topics, team=CREW, **more):
    return write_log(topics, [(TEAM_RECORD, encode_team(team))], **more)


def base(command):
    """What a command works on: a measured log, or a result."""
    return estimated() if command in {"evaluate", "plot"} else measured()


MAIN = {"localize": "/R1/odom", "info": "/R1/odom", "evaluate": "/R1/estimate",
        "plot": "/R1/estimate", "recover": "/R1/odom"}  # fmt: skip


def replaced(command, change):
    """The base with the rows of the command's main topic changed."""
    topics, topic = base(command), MAIN[command]
    kind, rows = topics[topic]
    return written({**topics, topic: (kind, change(rows))})


def sound(command):
    return written(base(command))


def truncated(command):
    data = sound(command)
    return data[: len(data) // 2]


def corrupt(command):
    data = bytearray(sound(command))
    where = [match.start() for match in re.finditer(b"zstd", bytes(data))]
    data[where[1] + 40] ^= 0xFF
    return bytes(data)


def exploding(command):
    """A chunk of 100 bytes that becomes 512 MB stands behind the header."""
    packed = zstandard.ZstdCompressor().compress(bytes(512 << 20))
    body = struct.pack("<QQQII4sQ", 0, 0, 100, 0, 4, b"zstd", len(packed)) + packed
    data = sound(command)
    header = 8 + 9 + struct.unpack_from("<Q", data, 9)[0]
    return data[:header] + struct.pack("<BQ", 6, len(body)) + body + data[header:]


def foreign(encoding, profile, schema):
    def build(_):
        path = _Buffer()
        writer = Writer(path)
        writer.start(profile=profile, library="somebody")
        number = writer.register_schema("nav_msgs/msg/Odometry", schema, b"{}")
        channel = writer.register_channel("/R1/odom", encoding, number)
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
        return bytes(path)

    return build


class _Buffer(bytearray):
    """A stream that only grows."""

    def write(self, data):
        self += data
        return len(data)

    def tell(self):
        return len(self)

    def flush(self):
        pass


def unreadable_values(command):
    """NaN and infinity in a tenth of the main topic."""
    if command in {"evaluate", "plot"}:
        spoil = lambda t, k: pose_message(  # noqa: E731
            t, (NAN, math.inf)[k % 2], 0.0, covariance=COVARIANCE
        )
    else:
        spoil = lambda t, k: odometry_message(t, (NAN, math.inf)[k % 2], 0.0)  # noqa: E731
    return replaced(
        command,
        lambda rows: [(t, spoil(t, k) if k % 10 == 3 else data) for k, (t, data) in
                      enumerate(rows)],
    )  # fmt: skip


def only_nan(command):
    if command in {"evaluate", "plot"}:
        change = lambda rows: [  # noqa: E731
            (t, pose_message(t, NAN, 0.0, covariance=COVARIANCE)) for t, _ in rows
        ]
    else:
        change = lambda rows: [(t, odometry_message(t, NAN, NAN)) for t, _ in rows]  # noqa: E731
    return replaced(command, change)


def huge_twist(command):
    return replaced(command, lambda rows: [(t, odometry_message(t, 1e300, 0.0)) for t, _ in rows])


def backwards(command):
    """Neighbouring messages swap their places in the file, not their header stamps."""
    return replaced(
        command,
        lambda rows: [(t, rows[k ^ 1][1]) for k, (t, _) in enumerate(rows)],
    )


def twice(command):
    return replaced(command, lambda rows: [row for row in rows for _ in range(2)])


def far(command):
    """One message is years late by its header."""
    t = BEGIN + 10 * 365 * 86400 * SECOND
    odometry = odometry_message(t, 0.5, 0.0)
    pose = pose_message(t, place(stamps(4, 20)[-1]), 0.0, covariance=COVARIANCE)
    message = pose if command in {"evaluate", "plot"} else odometry
    return replaced(command, lambda rows: [*rows, (t, message)])


def at_once(command):
    """Every message has the same stamp: one of them can count."""
    odometry = odometry_message(BEGIN, 0.5, 0.0)
    pose = pose_message(BEGIN, 0.0, 0.0, covariance=COVARIANCE)
    message = pose if command in {"evaluate", "plot"} else odometry
    return replaced(command, lambda rows: [(t, message) for t, _ in rows])


def constant_ranges(value):
    def build(_):
        rows = [(t, range_message(t, 1, 7, value)) for t in stamps(4, 20)]
        return written({**measured(), "/R1/uwb/range": ("range", rows)})

    return build


def far_away(command):
    """Estimates 100 million kilometres off."""
    pose = lambda t: pose_message(t, 1e11, -1e11, covariance=COVARIANCE)  # noqa: E731
    return replaced(command, lambda rows: [(t, pose(t)) for t, _ in rows])


def no_heading(command):
    """A reference that knows positions alone."""
    rows = [(t, pose_message(t, place(t), 0.0, (0, 0, 0, 0))) for t in [BEGIN, *stamps(4, 20)]]
    return written({**base(command), "/R1/ground_truth": ("pose", rows)})


def singular(value):
    """Covariances that are none."""
    bad = [value] * 36
    return lambda command: replaced(
        command, lambda rows: [(t, pose_message(t, place(t), 0.0, covariance=bad)) for t, _ in rows]
    )


def dropped(*topics):
    def build(command):
        return written({name: rows for name, rows in base(command).items() if name not in topics})

    return build


def stranger(_):
    """A third of the ranges are to a robot that is not in the team."""
    topics = measured()
    rows = [(t, range_message(t, 1, 99, 3.0)) for t in stamps(4, 20)]
    kind, ours = topics["/R1/uwb/range"]
    return written({**topics, "/R1/uwb/range": (kind, ours + rows)})


def empty_team(command):
    return written(base(command), Team(()))


def lonely(command):
    """One robot, nobody to range with."""
    topics = {name: rows for name, rows in base(command).items()
              if name not in {"/R1/uwb/range", "/clt/innovation"}}  # fmt: skip
    return written(topics, Team(CREW.robots[:1]))


def with_team(**changes):
    def build(command):
        record = dict(encode_team(CREW))
        robots = json.loads(record["robots"])
        robots[0].update(changes)
        return write_log(base(command), [(TEAM_RECORD, {**record, "robots": json.dumps(robots)})])

    return build


FOLDER = "a folder"
ALL = ("info", "localize", "evaluate", "plot", "recover")
CASES = {
    "missing": (None, dict.fromkeys(ALL, (1, "No such file"))),
    "directory": (FOLDER, dict.fromkeys(ALL, (1, "[Dd]irectory"))),
    "empty": (lambda _: b"", dict.fromkeys(ALL, (1, "is empty"))),
    "not MCAP": (lambda _: b"stamp,x,y\n1,2,3\n", dict.fromkeys(ALL, (1, "not an MCAP log"))),
    "truncated": (truncated, dict.fromkeys(ALL, (3, "byte [0-9]+: the log is cut off"))),
    "corrupt chunk": (corrupt, dict.fromkeys(ALL, (3, "chunk|byte"))),
    "exploding chunk": (exploding, dict.fromkeys(ALL, (3, "byte"))),
    "profile ros1": (
        foreign("ros1", "ros1", "ros1msg"),
        dict.fromkeys(ALL[:4], (1, "profile `ros1`")) | {"recover": (0, "")},
    ),
    "json messages": (
        foreign("json", "", "jsonschema"),
        dict.fromkeys(ALL[:4], (1, "json messages")) | {"recover": (0, "")},
    ),
    "unknown robot": (
        stranger,
        dict.fromkeys(ALL[:2], (3, "80 of 240 ranges name an unknown robot")),
    ),
    "no odometry": (dropped("/R1/odom"), {"info": (0, ""), "localize": (1, "no odometry found")}),
    "no ranges": (dropped("/R1/uwb/range"), {"info": (0, ""), "localize": (1, "no ranges found")}),
    "no truth": (
        dropped("/R1/ground_truth"),
        {
            "info": (0, ""),
            "localize": (1, "no ground truth"),
            "evaluate": (1, "ground truth"),
            "plot": (0, ""),
        },
    ),
    "no estimate": (
        dropped("/R1/estimate"),
        {"evaluate": (1, "no estimates"), "plot": (0, "")},
    ),
    "only NaN": (
        only_nan,
        {
            "info": (3, "80 of 80 messages hold NaN"),
            "localize": (1, "no odometry"),
            "evaluate": (1, "no estimate has a finite pose"),
            "plot": (1, "no estimate has a finite pose"),
        },
    ),
    "some NaN": (unreadable_values, dict.fromkeys(ALL[:4], (3, "NaN or infinite"))),
    "NaN ranges": (constant_ranges(NAN), {"info": (3, "NaN"), "localize": (1, "no ranges")}),
    "NaN covariance": (singular(NAN), dict.fromkeys(ALL[2:4], (1, "no estimate has a finite"))),
    "huge ranges": (
        constant_ranges(1e300),
        {"info": (3, "beyond 1e"), "localize": (1, "no ranges")},
    ),
    "huge twist": (huge_twist, {"info": (3, "beyond 1e"), "localize": (1, "no odometry")}),
    "negative ranges": (constant_ranges(-5.0), {"localize": (3, "R1 has diverged")}),
    "ranges of zero": (constant_ranges(0.0), {"localize": (3, "R1 has diverged")}),
    "far ranges": (constant_ranges(1e11), {"localize": (3, "R1 has diverged")}),
    "far stamp": (
        far,
        dict.fromkeys(("evaluate", "plot"), (0, ""))
        | {"info": (3, "no data for"), "localize": (3, "only the part with the most messages")},
    ),
    "one instant": (
        at_once,
        dict.fromkeys(ALL[2:4], (0, "only 1 of 81")) | {"localize": (3, "dead reckoning")},
    ),
    "far away": (far_away, dict.fromkeys(ALL[2:4], (3, "diverged"))),
    "no heading": (
        no_heading,
        dict.fromkeys(ALL[2:4], (0, "has no heading")) | {"localize": (1, "has no heading")},
    ),
    "zero covariance": (singular(0.0), dict.fromkeys(ALL[2:4], (0, "singular"))),
    "negative covariance": (singular(-1.0), dict.fromkeys(ALL[2:4], (0, "singular"))),
    "backwards": (backwards, dict.fromkeys(ALL[:4], (0, "go back in time"))),
    "duplicates": (twice, dict.fromkeys(ALL[:4], (0, "repeat a stamp"))),
    "empty team": (
        empty_team,
        dict.fromkeys(ALL[1:4], (1, "not in the team")) | {"info": (3, "team")},
    ),
    "one robot": (lonely, {"info": (0, ""), "localize": (1, "no ranges"), "evaluate": (0, "")}),
    "bad name": (with_team(name="R 1"), dict.fromkeys(ALL[:4], (1, "not a robot name"))),
    "two with one id": (with_team(id=7), dict.fromkeys(ALL[:4], (1, "share one id"))),
    "NaN antenna": (with_team(antenna=[NAN, 0.0]), dict.fromkeys(ALL[:4], (1, "antenna"))),
}
ROWS = [
    pytest.param(build, command, code, message, id=f"{name}-{command}")
    for name, (build, expected) in CASES.items()
    for command, (code, message) in expected.items()
]

TEXT_ROWS = [
    row for row in ROWS if row.values[1] in {"info", "evaluate"} and callable(row.values[0])
]


@pytest.fixture
def clt(monkeypatch, tmp_path):
    """Run one command in an empty folder; returns exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    for name in [name for name in os.environ if name.startswith("CLT_")]:
        monkeypatch.delenv(name)

    def run(*words):
        done = CliRunner().invoke(app, [str(word) for word in words])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        return done.exit_code, done.stdout, done.stderr

    return run


def words_of(command):
    return {
        "info": ("info", "in.mcap", "--json"),
        "localize": ("localize", "in.mcap", "--init", "truth", "-o", "out.mcap"),
        "evaluate": ("evaluate", "in.mcap", "--json"),
        "plot": ("plot", "in.mcap", "-o", "out.svg"),
        "recover": ("recover", "in.mcap", "-o", "out.mcap"),
    }[command]


@pytest.mark.parametrize("command", ALL)
def test_the_sound_log_is_sound(clt, tmp_path, command):
    """Else the table below would prove nothing."""
    (tmp_path / "in.mcap").write_bytes(sound(command))
    code, _, err = clt(*words_of(command))
    assert code == 0, err
    assert "warning" not in err


@pytest.mark.parametrize(("build", "command", "code", "expected"), ROWS)
def test_bad_input(clt, tmp_path, build, command, code, expected):
    path = tmp_path / "in.mcap"
    if build == FOLDER:
        path.mkdir()
    elif build is not None:
        path.write_bytes(build(command))
    found, out, err = clt(*words_of(command))
    assert found == code, err
    assert re.search(expected, err), err
    kinds = [line.split(": ")[1] for line in err.splitlines() if line.startswith("clt: ")]
    left = {name.name for name in tmp_path.iterdir()} - {"in.mcap"}
    if code == 1:
        assert kinds == ["warning"] * (len(kinds) - 1) + ["error"]
        assert err.splitlines()[-1].startswith(LINE)
        assert left == set()
        assert (json.loads(out)["exit_code"] if "--json" in words_of(command) else out) in {1, ""}
    else:
        assert kinds == ["warning"] * len(kinds)
        assert len(kinds) > 0 or expected == ""
        assert left == {word for word in words_of(command) if word.startswith("out")}
    if out != "":
        json.loads(out, parse_constant=pytest.fail)


@pytest.mark.parametrize(("build", "command", "code", "expected"), TEXT_ROWS)
def test_bad_input_as_text(clt, tmp_path, build, command, code, expected):
    """What people read holds no NaN either, and ends with the same code."""
    (tmp_path / "in.mcap").write_bytes(build(command))
    found, out, err = clt(command, "in.mcap")
    assert found == code, err
    assert re.search(r"\b(nan|inf)\b", out) is None, out
    assert (out == "") == (code == 1)


FULL = Path("/dev/full")
full = pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")


@pytest.mark.parametrize("command", ["localize", "recover", "plot"])
def test_an_output_that_exists_is_kept(clt, tmp_path, command):
    (tmp_path / "in.mcap").write_bytes(sound(command))
    out = tmp_path / words_of(command)[-1]
    out.write_bytes(b"mine")
    code, _, err = clt(*words_of(command))
    assert (code, err) == (1, f"{LINE}{out.name}: exists; use --force to overwrite it\n")
    assert out.read_bytes() == b"mine"
    code, _, err = clt(*words_of(command), "--force")
    assert code == 0
    assert out.read_bytes() != b"mine"


@pytest.mark.parametrize("command", ["localize", "recover", "plot"])
@pytest.mark.parametrize("force", [(), ("--force",)])
def test_an_input_is_never_overwritten(clt, tmp_path, command, force):
    path = tmp_path / ("in.mcap" if command != "plot" else "in.svg")
    path.write_bytes(sound(command))
    before = path.read_bytes()
    (tmp_path / f"link{path.suffix}").symlink_to(path)
    for output in (path, tmp_path / f"link{path.suffix}"):
        code, _, err = clt(command, path, "-o", output, *force)
        assert (code, err) == (1, f"{LINE}{output}: is also an input; choose another output\n")
        assert path.read_bytes() == before


@full
@pytest.mark.parametrize("command", ["localize", "recover"])
def test_a_full_disk(clt, tmp_path, command):
    (tmp_path / "in.mcap").write_bytes(sound(command))
    words = [FULL if word == "out.mcap" else word for word in words_of(command)]
    code, out, err = clt(*words)
    assert (code, out) == (1, "")
    assert err.splitlines()[-1] == f"{LINE}{FULL}: No space left on device"
    assert err.count(LINE) == 1


def test_a_disk_that_fills_up_on_the_way_keeps_nothing(tmp_path):
    """As a limit on the size of files: the log is 20 kB, 8 kB fit."""
    (tmp_path / "in.mcap").write_bytes(sound("recover"))
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (8192, 8192))
    done = subprocess.run(
        [sys.executable, "-m", "clt", "recover", "in.mcap", "-o", "out.mcap"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        preexec_fn=limit,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"{LINE}out.mcap: File too large\n"
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


@full
@pytest.mark.parametrize(
    "words",
    [
        ("info", "in.mcap"),
        ("info", "in.mcap", "--json"),
        ("evaluate", "in.mcap"),
        ("evaluate", "in.mcap", "--json"),
        ("plot", "in.mcap", "-o", "-"),
        ("localize", "in.mcap", "--init", "truth", "-o", "-"),
        ("recover", "in.mcap", "-o", "-"),
        ("simulate", "shi-sim", "--duration", "1", "-o", "-"),
    ],
)
def test_standard_output_on_a_full_disk(tmp_path, words):
    """A real process: what Python itself says about its standard output counts too."""
    (tmp_path / "in.mcap").write_bytes(sound(words[0]))
    with FULL.open("wb") as out:
        done = subprocess.run(
            [sys.executable, "-m", "clt", *words],
            cwd=tmp_path, stdout=out, stderr=subprocess.PIPE, check=False,
        )  # fmt: skip
    lines = done.stderr.decode().splitlines()
    assert done.returncode == 1, lines
    assert [line for line in lines if "Traceback" in line or "Exception" in line] == []
    assert [line for line in lines if line.startswith(LINE)] == lines[-1:]
    assert "No space left on device" in lines[-1]


def test_a_reader_that_leaves_early_is_no_traceback(tmp_path):
    (tmp_path / "in.mcap").write_bytes(sound("localize"))
    process = subprocess.Popen(
        [sys.executable, "-m", "clt", "localize", "in.mcap", "--init", "truth", "-q", "-o", "-"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    process.stdout.close()
    err = process.stderr.read()
    process.stderr.close()
    assert process.wait() == 1
    assert b"Traceback" not in err
    assert b"Exception" not in err
