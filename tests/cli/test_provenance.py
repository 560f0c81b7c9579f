from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from clt import __version__
from clt.cli.provenance import arguments_without_output, file_digests, run_record


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "shi-sim", "--seed", "1"],
        ["simulate", "shi-sim", "-o", "a.mcap", "--seed", "1"],
        ["simulate", "-oa.mcap", "shi-sim", "--seed", "1", "--force"],
        ["simulate", "--output=a.mcap", "shi-sim", "-q", "--seed", "1", "-v"],
        ["simulate", "shi-sim", "--seed", "1", "--output", "a.mcap", "--json"],
    ],
)
def test_essence(words: list[str]) -> None:
    assert arguments_without_output(words) == ["simulate", "shi-sim", "--seed", "1"]


def test_record(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["/any/where/clt", "localize", "my log.mcap", "-o", "x.mcap"])
    record = run_record({"my log.mcap": "ab12"}, filter="eskf", timings={"read_s": 0.5})
    assert record["command"] == "clt localize 'my log.mcap'"
    assert record["version"] == __version__
    assert json.loads(record["inputs"]) == {"my log.mcap": "ab12"}
    assert record["filter"] == "eskf"
    assert json.loads(record["timings"]) == {"read_s": 0.5}


def test_record_refuses_nan() -> None:
    with pytest.raises(ValueError, match="JSON"):
        run_record({}, value=float("nan"))


def test_digests(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"content")
    assert file_digests([path]) == {str(path): hashlib.sha256(b"content").hexdigest()}
