from __future__ import annotations

import pytest

from clt.core.errors import CltError
from clt.log.output_folder import check_folder, write_folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_new_folder_holds_the_files(tmp_path):
    write_folder(tmp_path / "a", {"x": lambda: b"1", "y": lambda: b"2"})
    assert contents(tmp_path / "a") == {"x": b"1", "y": b"2"}


def test_what_exists_is_refused_before_anything_is_written(tmp_path):
    (tmp_path / "y").write_bytes(b"old")
    files = {"x": lambda: b"1", "y": lambda: b"2"}
    with pytest.raises(CltError, match=r"y: exists; use --force"):
        write_folder(tmp_path, files)
    assert contents(tmp_path) == {"y": b"old"}
    write_folder(tmp_path, files, force=True)
    assert contents(tmp_path) == {"x": b"1", "y": b"2"}


def test_other_files_stay(tmp_path):
    (tmp_path / "z").write_bytes(b"3")
    write_folder(tmp_path, {"x": lambda: b"1"})
    assert contents(tmp_path) == {"z": b"3", "x": b"1"}


def test_a_failure_leaves_nothing(tmp_path):
    def fail():
        raise CltError("no")

    with pytest.raises(CltError, match="no"):
        write_folder(tmp_path / "a", {"x": lambda: b"1", "y": fail})
    assert not (tmp_path / "a").exists()
    (tmp_path / "b").mkdir()
    with pytest.raises(CltError, match="no"):
        write_folder(tmp_path / "b", {"x": lambda: b"1", "y": fail})
    assert contents(tmp_path / "b") == {}


def test_wrong_targets_are_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"")
    for folder, said in (
        ("-", "name a folder"),
        (str(tmp_path / "file"), "is a file"),
        (str(tmp_path / "no" / "a"), "create it first"),
    ):
        with pytest.raises(CltError, match=said):
            check_folder(type(tmp_path)(folder), [])


def test_an_input_is_not_overwritten(tmp_path):
    (tmp_path / "x").write_bytes(b"log")
    with pytest.raises(CltError, match="also an input"):
        write_folder(tmp_path, {"x": lambda: b""}, force=True, inputs=[tmp_path / "x"])
