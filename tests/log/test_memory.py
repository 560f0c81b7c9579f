"""A log needs little more memory than its columns."""

from __future__ import annotations

import tracemalloc
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from clt.core.document import Document
from clt.core.recording import Odometry, Poses, Ranges, Robot, Team
from clt.log.cdr import message_buffer
from clt.log.mcap.write import write_log
from clt.log.recording.channels import odometry_channel, range_channel, truth_channel
from clt.log.recording.load import load
from clt.log.recording.metadata import encode_team
from clt.log.recording.summary import info_dict, summarize_recording

N = 40_000


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Two robots, 40,000 ranges, odometry samples and poses each; 30 MB of messages."""
    team = Team((Robot("R1", 1), Robot("R2", 2)))
    stamp = 10**9 + 10**7 * np.arange(N)
    rng = np.random.default_rng(0)
    x, zero = rng.normal(size=N), np.zeros(N, np.int64)
    log_time = stamp + 10**6
    channels = [
        odometry_channel(team.robots[0], Odometry(stamp, log_time, x, x, x * 0 + 1, x * 0 + 1)),
        range_channel(
            team, 0, Ranges(stamp, log_time, zero, zero + 1, x + 9, x + 9, x * 0 + 1, zero)
        ),
        truth_channel("R1", Poses("world", stamp, log_time, x, x, x)),
    ]
    file = tmp_path_factory.mktemp("memory") / "log.mcap"
    data = BytesIO()
    write_log(data, channels, {"clt.team": encode_team(team)})
    file.write_bytes(data.getvalue())
    return file


def peak(path, **options):
    """Most memory in use while loading, and that of the columns."""
    load(path, **options)  # compiles patterns and fills caches
    tracemalloc.start()
    recording = load(path, **options).recording
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    tables = [recording.ranges, *recording.odometry.values(), *recording.truth.values()]
    arrays = [a for table in tables for a in vars(table).values() if isinstance(a, np.ndarray)]
    return most, sum(a.nbytes for a in arrays)


PATTERNS = b"""
odometry = "/{robot}/odom"
ground_truth = "/{robot}/ground_truth"
[robots.R2]
static = true
[[ranges]]
topic = "/{source}/uwb/range"
target = "R2"
"""
MAPPED = {"streams": Document(Path("streams.toml"), PATTERNS)}


@pytest.mark.parametrize("options", [{}, {"brief": True}, MAPPED])
def test_loading_needs_few_times_the_columns(path, monkeypatch, options):
    monkeypatch.setattr(message_buffer, "DECODE_BATCH_BYTES", 1 << 20)
    most, columns = peak(path, **options)
    assert columns > 4_000_000
    assert most < 3 * columns + 6 * (1 << 20)  # one batch, one chunk, the window of the source


def test_what_is_mapped_but_not_wanted_is_not_held(path, monkeypatch):
    monkeypatch.setattr(message_buffer, "DECODE_BATCH_BYTES", 1 << 20)
    most, columns = peak(path, want=frozenset({"truth"}), **MAPPED)
    assert columns < 2_500_000
    assert most < 3 * columns + 6 * (1 << 20)


def test_batches_change_nothing(path, monkeypatch):
    whole = load(path)
    monkeypatch.setattr(message_buffer, "DECODE_BATCH_BYTES", 1 << 18)
    parts = load(path)
    for name, table in vars(whole.recording).items():
        tables = table if isinstance(table, dict) else {"": table}
        others = getattr(parts.recording, name)
        others = others if isinstance(others, dict) else {"": others}
        for key, one in tables.items():
            for field, value in getattr(one, "__dict__", {}).items():
                np.testing.assert_array_equal(value, getattr(others[key], field))


def test_brief_counts_as_all_does(path):
    documents = []
    for brief in (False, True):
        loaded = load(path, brief=brief)
        documents.append(info_dict(loaded, summarize_recording(loaded.recording)))
    assert documents[0] == documents[1]
