"""simulate -> emit -> record -> localize: as the direct log, within what each format rounds."""

from __future__ import annotations

import os
import pty
import socket
import struct
import subprocess
import sys
import time
import tty
from contextlib import chdir

import numpy as np
import pytest
from typer.testing import CliRunner

from clt.cli.app import app
from clt.log.recording.load import load
from tests.devices.streams import ended, start, until

DURATION = 6.0
SIGMA = ("--set", "noise.sigma_v=0.2", "--set", "noise.sigma_omega=0.1")
NOISE = (*SIGMA, "--set", "noise.sigma_range=0.1")
ROUNDING = {
    "rcl": (1e-9, 1e-6),
    "ndjson": (1e-6, 1e-6),
    "trek1000": (0.51e-3, None),
    "makerfabs": (0.51e-2, None),
    "dwm1001": (0.51e-2, None),
    "qorvo-cli": (0.51e-2, None),
    "vesc": (None, 2.2e-4),
    "vesc-can": (None, 2.2e-4),
}
"""Half a step of the ranges (m) and speeds (m/s) of a format; None for what it does not carry."""
ONE_ROBOT = ("dwm1001", "qorvo-cli", "vesc")


def clt(folder, *words):
    with chdir(folder):
        done = CliRunner().invoke(app, list(words))
    assert done.exit_code in {0, 3}, (words, done.output, done.exception)
    return done


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A simulated log, and its estimates."""
    folder = tmp_path_factory.mktemp("chain")
    clt(folder, "simulate", "shi-sim", "--duration", str(DURATION), "--seed", "3", "-o", "sim.mcap")
    clt(folder, "localize", "sim.mcap", "--init", "truth", *NOISE, "-o", "sim-out.mcap")
    (folder / "team.toml").write_text(
        "[robots.R1]\nstatic = true\nposition = [0.0, 0.0]\n"
        "[robots.R2]\nstatic = true\nposition = [12.0, 0.0]\n"
    )
    return folder


def source_words(text):
    """What `emit` says reads its stream back."""
    line = next(line for line in text.splitlines() if "--source" in line)
    return line.split("--source ", 1)[1].split()[0]


def by_pair(recording):
    """Ranges of every pair in the order of their stamps, ends sorted."""
    ranges, names = recording.ranges, recording.team.names
    found = {}
    for k in range(len(ranges.stamp)):
        pair = tuple(sorted((names[ranges.source[k]], names[ranges.target[k]])))
        found.setdefault(pair, []).append((ranges.range[k], ranges.stamp[k]))
    return {pair: np.array(rows).T for pair, rows in found.items()}


@pytest.mark.parametrize("proto", sorted(ROUNDING))
def test_every_format_brings_the_log_back(folder, proto):
    words = ["--robot", "R3"] if proto in ONE_ROBOT else []
    out = f"em.{proto}"
    said = clt(folder, "emit", "sim.mcap", "--proto", proto, "--rate", "0", "-o", out, *words)
    name = f"{proto}.mcap"
    clt(folder, "record", "-o", name, "--source", source_words(said.stderr))
    direct, recorded = (load(folder / one).recording for one in ("sim.mcap", name))
    of_range, of_speed = ROUNDING[proto]
    if of_range is not None:
        theirs, ours = by_pair(direct), by_pair(recorded)
        assert len(ours) >= 4
        for pair, rows in ours.items():
            most = len(rows[0])
            assert most >= 0.95 * len(theirs[pair][0]), pair
            late = len(theirs[pair][0]) - most if proto == "trek1000" else 0
            exact = theirs[pair][0][late : late + most]
            assert np.abs(rows[0] - exact).max() <= of_range, pair
    if of_speed is not None:
        assert len(recorded.odometry) == (1 if proto in ONE_ROBOT else 3)
        for robot, odometry in recorded.odometry.items():
            assert len(odometry.v) == len(direct.odometry[robot].v)
            assert np.abs(odometry.v - direct.odometry[robot].v).max() <= of_speed


def same_estimates(folder, log, most):
    """Localize a recorded log; no position differs by more from that of the direct log, m.

    What is before the first half second is left out: a first sample that came late says so then.
    """
    words = ["localize", log, "--init", "poses.toml", *NOISE, "-o", f"out-{log}", "--force"]
    poses = load(folder / "sim-out.mcap").recording.estimate
    begin = {robot: one for robot, one in poses.items() if robot in {"R3", "R4", "R5"}}
    truth = load(folder / "sim.mcap").recording.truth
    (folder / "poses.toml").write_text(
        "".join(
            f"[{robot}]\nx = {truth[robot].x[0]}\ny = {truth[robot].y[0]}\n"
            f"heading = {truth[robot].heading[0]}\nsigma = [0.01, 0.01, 0.01]\n"
            for robot in ("R3", "R4", "R5")
        )
    )
    clt(folder, *words)
    clt(
        folder,
        "localize",
        "sim.mcap",
        "--init",
        "poses.toml",
        *NOISE,
        "-o",
        "direct.mcap",
        "--force",
    )
    direct = load(folder / "direct.mcap").recording.estimate
    found = load(folder / f"out-{log}").recording.estimate
    theirs, ours = (load(folder / one).recording.odometry["R3"].stamp for one in ("sim.mcap", log))
    shift = int(np.median(ours - theirs))
    for robot in begin:
        one, other = direct[robot], found[robot]
        begun = theirs[0]
        at, since = (other.stamp - shift - begun) * 1e-9, (one.stamp - begun) * 1e-9
        inside = (at >= 0.5) & (at <= since[-1])
        assert np.count_nonzero(inside) > 0.8 * len(since)
        x = np.interp(at[inside], since, one.x)
        y = np.interp(at[inside], since, one.y)
        error = np.hypot(other.x[inside] - x, other.y[inside] - y)
        assert error.max() < most, (robot, error.max())


@pytest.mark.parametrize(("proto", "most"), [("rcl", 1e-3), ("ndjson", 1e-6)])
def test_the_same_estimates(folder, proto, most):
    said = clt(folder, "emit", "sim.mcap", "--proto", proto, "--rate", "0", "-o", f"f.{proto}")
    words = ["--source", source_words(said.stderr), "--team", "team.toml"]
    clt(folder, "record", "-o", f"same-{proto}.mcap", *words)
    same_estimates(folder, f"same-{proto}.mcap", most)


def emitter(folder, url, *words):
    """`clt emit` of the simulated log at the device's own pace."""
    command = [sys.executable, "-m", "clt", "emit", "sim.mcap", "--proto", "rcl", "-o", url, *words]
    return subprocess.Popen(
        command,
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
    )


@pytest.mark.parametrize("transport", ["udp", "tcp", "tcp-listen", "serial", "stdin"])
def test_every_transport_brings_the_same_estimates(folder, transport):
    """As it happens, but for standard input: stamps are mapped, estimates are the same."""
    log = f"{transport}.mcap"
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    url, target = {
        "udp": (f"udp:127.0.0.1:{port}", f"udp:127.0.0.1:{port}"),
        "tcp": (f"tcp:127.0.0.1:{port}", f"tcp-listen:127.0.0.1:{port}"),
        "tcp-listen": (f"tcp-listen:127.0.0.1:{port}", f"tcp:127.0.0.1:{port}"),
        "serial": (f"serial:{os.ttyname(slave)}", f"/proc/self/fd/{master}"),
        "stdin": ("-", "-"),
    }[transport]
    words = ["-o", log, "--team", "team.toml", "--force", "--count", "1560", "--duration", "60"]
    words += ["--source", f"uwb={url},proto=rcl,map=1:R1+2:R2+3:R3+4:R4+5:R5"]
    if transport == "stdin":
        device = emitter(folder, "-", "--rate", "0")
        ended(start(folder, *words, stdin=device.stdout))
    elif transport == "tcp":
        device = emitter(folder, target)
        ended(start(folder, *words))
    else:
        process = start(folder, *words)
        (folder / log).unlink(missing_ok=True)
        until((folder / log).exists, process)
        if transport == "serial":
            said = clt(
                folder,
                "emit",
                "sim.mcap",
                "--proto",
                "rcl",
                "--rate",
                "0",
                "-o",
                "s.bin",
                "--force",
            )
            del said
            device = None
            copy_at_pace(folder / "s.bin", master)
        else:
            device = emitter(folder, target)
        ended(process)
    if device is not None:
        device.communicate(timeout=60)
    os.close(master)
    os.close(slave)
    same_estimates(folder, log, 1e-3 if transport == "stdin" else 0.03)


def copy_at_pace(path, file):
    """Write the frames of `rcl` when they are due."""
    data = path.read_bytes()
    at, begin, first = 0, time.monotonic(), None
    while at < len(data):
        size = data[at + 2] + 4
        ms = struct.unpack_from("<I", data, at + 4)[0]
        first = ms if first is None else first
        wait = begin + (ms - first) * 1e-3 - time.monotonic()
        if wait > 0:
            time.sleep(wait)
        os.write(file, data[at : at + size])
        at += size


def test_raw_packets_become_ranges(tmp_path):
    clt(tmp_path, "simulate", "shi-five", "--duration", "3", "--set", "radio={}", "-o", "sim.mcap")
    clt(tmp_path, "range", "sim.mcap", "-o", "direct.mcap")
    for proto in ("lps-sniffer", "ndjson"):
        said = clt(
            tmp_path, "emit", "sim.mcap", "--proto", proto, "--rate", "0", "-o", f"em.{proto}"
        )
        clt(tmp_path, "record", "-o", f"{proto}.mcap", "--source", source_words(said.stderr))
        clt(tmp_path, "range", f"{proto}.mcap", "-o", f"{proto}-ranges.mcap")
        direct = by_pair(load(tmp_path / "direct.mcap").recording)
        ours = by_pair(load(tmp_path / f"{proto}-ranges.mcap").recording)
        assert direct.keys() == ours.keys()
        for pair, rows in direct.items():
            assert len(ours[pair][0]) == len(rows[0])
            assert np.abs(ours[pair][0] - rows[0]).max() < 0.02, pair
