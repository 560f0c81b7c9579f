"""Damaged files of every text format: a recording that can be saved, or one line."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.importers import IMPORT_FORMATS
from clt.log.recording.save import save
from tests.importers import test_csv_tables, test_labyrinth, test_pyfg, test_tum

MUTATIONS = 60
WORDS = (
    b"nan",
    b"inf",
    b"-1",
    b"1e400",
    b"1e11",
    b"99999999999",
    b"0",
    b"",
    b"\xff",
    b"x",
    b"\x00",
    b"A0",
    b"R1",
    b"1e13",
    b"-0.0",
)


def pyfg_file(folder: Path) -> Path:
    return test_pyfg.written(folder, test_pyfg.graph())


def labyrinth_file(folder: Path) -> Path:
    data, truth, _ = test_labyrinth.lines()
    test_labyrinth.write(folder / "run.txt", data, truth)
    return folder / "run.txt"


def tum_file(folder: Path) -> Path:
    (folder / "R1.tum").write_text(test_tum.LINES)
    return folder / "R1.tum"


def csv_file(folder: Path) -> Path:
    (folder / "ranges.csv").write_text(test_csv_tables.RANGES)
    return folder / "ranges.csv"


def static_file(folder: Path) -> Path:
    (folder / "static.csv").write_text(test_csv_tables.STATIC)
    return folder / "static.csv"


def truth_file(folder: Path) -> Path:
    (folder / "truth.csv").write_text(test_csv_tables.TRUTH)
    return folder / "truth.csv"


def mutated(data: bytes, random: np.random.Generator) -> bytes:
    """Some bytes or words exchanged, lines lost, doubled or moved."""
    for _ in range(random.integers(1, 4)):
        kind = random.integers(5)
        if kind == 0 and len(data) > 0:
            at = int(random.integers(len(data)))
            data = data[:at] + bytes([random.integers(256)]) + data[at + 1 :]
        elif kind == 1:
            data = data[: random.integers(len(data) + 1)]
        elif kind == 2:
            lines = data.split(b"\n")
            a, b = random.integers(len(lines), size=2)
            lines[a], lines[b] = lines[b], lines[a]
            data = b"\n".join(lines)
        else:
            sign = b"," if b"," in data and random.integers(2) else b" "
            words = data.split(sign)
            words[random.integers(len(words))] = WORDS[random.integers(len(WORDS))]
            data = sign.join(words)
    return data


def check(recording: Recording) -> None:
    """What was read can be written: finite, sorted, known robots."""
    save(io.BytesIO(), recording, dict(recording.run))
    for stream in (*recording.odometry.values(), *recording.truth.values(), recording.ranges):
        assert np.all(np.diff(stream.stamp) >= 0)


@pytest.mark.parametrize(
    ("name", "make"),
    [
        ("pyfg", pyfg_file),
        ("labyrinth", labyrinth_file),
        ("tum", tum_file),
        ("csv", csv_file),
        ("csv", static_file),
        ("csv", truth_file),
    ],
)
def test_a_recording_or_one_line(tmp_path: Path, name: str, make: Callable[[Path], Path]) -> None:
    random = np.random.default_rng(5)
    path = make(tmp_path)
    data = path.read_bytes()
    refused = []
    for _ in range(MUTATIONS):
        path.write_bytes(mutated(data, random))
        try:
            check(IMPORT_FORMATS[name].read((path,), None))
        except CltError as error:
            refused.append(str(error))
    assert len(refused) > 0
    assert [text for text in refused if "\n" in text or str(path) not in text] == []
