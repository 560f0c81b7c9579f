"""Fuzzer of the log layer: hostile logs may be refused in one line, and nothing else may happen.

Run: python -m tests.fuzz.logs --count 1000000 --seed 1 [--jobs 2] [--first K]. That takes an hour
of one core: one case in twenty is tried in full, of the others mostly the scan (`--share 1` tries
all of all). Every finding is printed as it comes, with its number; `--first` goes on from a case.
"""

from __future__ import annotations

import argparse
import functools
import json
import multiprocessing
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from io import BytesIO
from pathlib import Path

import numpy as np

from clt.core.document import Document
from clt.core.errors import CltError
from clt.log.mcap.scan import McapScan
from clt.log.recording.load import load
from clt.log.recording.recover import salvage_log
from clt.log.recording.summary import info_dict, summarize_recording
from tests.fuzz import mutate
from tests.log.logs import (
    LZ4,
    NONE,
    ZSTD,
    odometry_message,
    pose_message,
    range_message,
    write_log,
)

SECONDS = 2.0
"""Processor time that one case may take."""
SHARE = 0.05
"""Cases that are tried in full where many are."""
BLOCK = 500
"""Cases that a process takes at once."""
MEGABYTES = 1500
"""Memory that the process may ever take."""
STREAMS = b"""
[robots.R1]
odometry = "/R1/odom"
ground_truth = "/R1/ground_truth"
[robots.R2]
static = true
[[ranges]]
topic = "/R1/uwb/range"
source = "R1"
target = "R2"
field = "range"
"""
FINITE = ("v", "omega", "range", "x", "y", "residual", "sigma", "nis")


@functools.cache
def seeds():
    """A few small logs of everything that clt reads."""
    team = (
        '[{"name": "R1", "id": 1, "antenna": [0.1, 0.0], "sigma_v": 0.1},'
        ' {"name": "R2", "id": 2, "static": true, "position": [1.0, 2.0]}]'
    )
    record = {"robots": team, "range_sigma": "0.1", "communication": '{"graph": "line"}'}
    stamps = [10**9 + k * 10**8 for k in range(6)]
    six = [0.01 * (k % 7 == 0) for k in range(36)]
    topics = {
        "/R1/odom": (
            "odometry",
            [(t, odometry_message(t, 0.5, 0.1, covariance=six)) for t in stamps],
        ),
        "/R1/uwb/range": ("range", [(t, range_message(t, 1, 2, 3.0)) for t in stamps]),
        "/R1/ground_truth": ("pose", [(t, pose_message(t, 1.0, 2.0)) for t in stamps]),
        "/R1/estimate": (
            "covariance",
            [(t, pose_message(t, 1.0, 2.0, covariance=six)) for t in stamps[:3]],
        ),
    }
    some = {name: topics[name] for name in ("/R1/odom", "/R1/uwb/range")}
    run = ("clt.run", {"seed": "1", "filter": "eskf", "config": '{"gate": 16.0}'})
    page = ("scenario.toml", "application/toml", b"duration = 1.0\n")
    return (
        write_log(topics, [("clt.team", record), run], [page], options={"compression": ZSTD}),
        write_log(some, [("clt.team", record)], options={"compression": LZ4, "chunk_size": 900}),
        write_log(some, options={"compression": NONE}),
        write_log(topics, [run], options={"use_chunking": False}),
        write_log({"/R1/uwb/range": topics["/R1/uwb/range"]}, [("clt.team", record)]),
    )


def case(seed):
    """The log of one seed."""
    draw = random.Random(seed)
    logs = seeds()
    data = draw.choice(logs)
    if draw.random() < 0.5:
        return mutate.of_bytes(draw, data, draw.choice(logs))
    data = mutate.of_meaning(draw, data)
    return mutate.of_bytes(draw, data, data) if draw.random() < 0.1 else data


def whole(path):
    examine(load(path))


def brief(path):
    examine(load(path, brief=True))


def mapped(path):
    examine(load(path, Document(Path("streams.toml"), STREAMS)))


def scanned(path, data):
    """The records alone, without a file, which is cheap."""
    scan = McapScan(BytesIO(data), str(path))
    assert sum(1 for _ in scan) >= 0
    assert all(str(path) in fault.text for fault in scan.faults.all())


def check(path, data, steps):
    """What one case does; raises for anything but a refusal in one line."""
    outcome = "read"
    if steps != [scanned]:
        path.write_bytes(data)
    for step in steps:
        try:
            step(*([path, data] if step is scanned else [path]))
        except CltError as error:
            named = str(path) in str(error) or "streams.toml" in str(error)
            if not named or len(str(error)) > 4000:
                raise AssertionError(f"no plain refusal: {error!r}") from error
            outcome = "refused"
    return outcome


def steps_of(seed, share):
    """What is tried on a case: everything on a share of them, mostly the scan alone on others."""
    draw = random.Random(f"steps {seed}")
    if draw.random() >= share:
        return draw.choices([[scanned], [whole], [brief], [saved], [mapped]], [92, 3, 2, 2, 1])[0]
    return [whole, brief, *([mapped] if draw.random() < 0.2 else []), saved]


def examine(loaded):
    """Everything that `clt info` would say, and that columns promised finite are."""
    recording = loaded.recording
    json.dumps(info_dict(loaded, summarize_recording(recording)), allow_nan=False)
    for fault in recording.faults:
        assert loaded.path in fault.text
    tables = [recording.ranges, recording.innovations]
    for tracks in (recording.odometry, recording.truth, recording.estimate):
        tables += tracks.values()
    for table in tables:
        for name, column in ({} if table is None else vars(table)).items():
            known = name in FINITE and not (name == "sigma" and table is recording.ranges)
            if known and isinstance(column, np.ndarray):
                assert np.isfinite(column).all(), f"{name} is not finite"
                assert len(column) == len(table.stamp)


def saved(path):
    """What is recovered is sound."""
    file = BytesIO()
    found = salvage_log(path, file)
    again = path.with_name("again.mcap")
    again.write_bytes(file.getvalue())
    second = BytesIO()
    twice = salvage_log(again, second)
    assert twice.messages == found.messages, "recovered twice differs"
    assert not any(fault.data_lost for fault in twice.faults), twice.faults
    if found.messages > 0:
        try:
            load(again)
        except CltError as error:
            assert str(again) in str(error)  # noqa: PT017 - the text is the point


def run(first, count, share=0.0):
    """Findings of `count` seeds from `first` on, as (seed, text), and what happened how often."""
    findings, outcomes = [], Counter()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = Path(folder) / "case.mcap"
        for seed in range(first, first + count):
            data = case(seed)
            began = time.process_time()
            try:
                outcomes[check(path, data, steps_of(seed, share))] += 1
            except Exception:  # noqa: BLE001 - findings are collected
                lines = traceback.format_exc().splitlines()
                findings.append((seed, " | ".join(line.strip() for line in lines[-5:])))
            took = time.process_time() - began
            if took > SECONDS:
                findings.append((seed, f"took {took:.1f} s"))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if peak > MEGABYTES:
        findings.append((first, f"{peak:.0f} MB of memory by seed {first + count - 1}"))
    return findings, outcomes


def of_block(block):
    return run(*block)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case of all")
    parser.add_argument("--first", type=int, help="number of the case to go on from")
    parser.add_argument("--share", type=float, default=SHARE, help="cases that are tried in full")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    begin, end = given.seed, given.seed + given.count
    begin = max(begin, begin if given.first is None else given.first)
    blocks = [(first, min(BLOCK, end - first), given.share) for first in range(begin, end, BLOCK)]
    found, done, total = 0, 0, Counter()
    with multiprocessing.Pool(given.jobs) as pool:
        for findings, outcomes in pool.imap(of_block, blocks):  # said as they come
            total += outcomes
            found += len(findings)
            done += BLOCK
            for seed, text in findings:
                print(f"{seed}: {text}", flush=True)
            if done % 10_000 == 0:
                print(f"done up to {begin + done}, {found} findings", file=sys.stderr, flush=True)
    print(f"{max(end - begin, 0)} cases from {begin} on: {dict(total)}, {found} findings")
    return 1 if found > 0 else 0


if __name__ == "__main__":
    raise SystemExit(main())
