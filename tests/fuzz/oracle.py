"""What every command promises, whatever it is given."""

from __future__ import annotations

import json
import math
import re
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.errors import CltError
from clt.log.recording.load import load

SLOWEST = 10.0
"""Seconds of processor time that a command on a small log may take."""
BARE = re.compile(r"(?<![\w.-])-?(?:nan|inf|NaN|Infinity)(?![\w-])")


def run(words: list[str], result: Path | None = None, **environment: str) -> list[str]:
    """Run a command in this process; what it does that none may do."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = CliRunner().invoke(app, words, env=environment)
    wrong = []
    seconds = time.process_time() - begin
    if seconds > SLOWEST and "compiling the filter" not in done.stderr:
        wrong.append(f"takes {seconds:.0f} s")
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        frames = traceback.extract_tb(done.exception.__traceback__)
        ours = [frame for frame in frames if "/clt/" in frame.filename] or frames
        place = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return [*wrong, f"{type(done.exception).__name__} in {place}: {done.exception}"[:300]]
    if done.exit_code not in {0, 1, 2, 3}:
        wrong.append(f"exit code {done.exit_code}")
    errors = [line for line in done.stderr.splitlines() if line.startswith("clt: error: ")]
    if done.exit_code in {1, 2} and len(errors) != 1:
        wrong.append(f"exit code {done.exit_code} with {len(errors)} lines of error")
    if done.exit_code == 3 and done.stderr == "":
        wrong.append("exit code 3 without a word")
    if not done.stderr.replace("\n", "").isprintable():
        wrong.append("control characters on standard error")
    if done.exit_code in {0, 3}:
        wrong += numbers(done.stdout, "--json" in words, result)
    return wrong


def numbers(text: str, as_json: bool, result: Path | None) -> list[str]:
    """What is not finite in the output and the result of a command that is done."""
    wrong = []
    if as_json and text != "":
        try:
            json.loads(text, parse_constant=refuse)
        except ValueError as error:
            wrong.append(f"JSON: {error}")
    elif BARE.search(text) is not None:
        wrong.append(f"says {BARE.search(text)}")
    if result is not None and result.suffix == ".mcap" and result.exists():
        try:
            recording = load(result).recording
        except CltError as error:
            return [*wrong, f"the result cannot be read: {error}"]
        for name, poses in {**recording.estimate, **recording.dead_reckoning}.items():
            columns: list[Any] = [poses.x, poses.y, poses.heading]
            if poses.covariance is not None:
                columns.append(poses.covariance)
            if not all(math.isfinite(value) for column in columns for value in column.ravel()):
                wrong.append(f"the result of {name} is not finite")
    return wrong


def refuse(constant: str) -> None:
    """NaN and infinities are no JSON."""
    raise ValueError(constant)
