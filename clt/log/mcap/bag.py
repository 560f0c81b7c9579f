"""The files of a folder that `ros2 bag record` made, in the order of their recording."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from clt.core.errors import LogError
from clt.log.recording.roles import natural_key

METADATA_FILE = "metadata.yaml"
BAG_FILE_PATTERN = re.compile(r"(?P<bag>.+?)(?:_\d+)?\.(?:mcap|db3)(?:\.zstd|\.zst|\.gz)?")
"""`BAG_0.mcap` and, of a split recording, `BAG_1.mcap` and so on; plain or packed."""
YAML_KEY_PATTERN = re.compile(r"\s*(?P<key>\w+):\s*(?P<value>.*?)\s*")
YAML_ITEM_PATTERN = re.compile(r"\s*-\s+(?P<value>.+?)\s*")
MAX_METADATA_BYTES = 16 << 20
"""Bytes of a metadata.yaml that are read; real ones have some kilobytes."""


@dataclass(frozen=True)
class Bag:
    """A folder as one log."""

    files: tuple[Path, ...]
    missing: tuple[str, ...] = ()
    """Names that metadata.yaml lists and that are not there."""


def find_bag(folder: Path) -> Bag:
    """The files that metadata.yaml lists, else those of the one bag in the folder by number.

    Raises LogError for a folder without a bag, with several, or one packed message by message in
    another storage than SQLite.
    """
    try:
        present = {file.name: file for file in folder.iterdir() if file.is_file()}
        lines = _lines(present[METADATA_FILE]) if METADATA_FILE in present else []
    except OSError as error:
        raise LogError(f"{folder}: {error.strerror or error}") from None
    named = list(_listed_files(lines))
    if _yaml_value(lines, "compression_mode").lower() == "message":
        storage = _yaml_value(lines, "storage_identifier")
        if storage != "sqlite3":
            how = "its messages are packed one by one; unpack them: ros2 bag convert"
            raise LogError(f"{folder}: {how}")
    if len(named) == 0:
        return Bag(_numbered_files(folder, present))
    found = [_find_file(name, present) for name in named]
    missing = tuple(name for name, file in zip(named, found, strict=True) if file is None)
    files = tuple(file for file in found if file is not None)
    if len(files) == 0:
        raise LogError(
            f"{folder}: none of the files that {METADATA_FILE} lists is in it: {missing[0]}"
        )
    return Bag(files, missing)


def _lines(path: Path) -> list[str]:
    with path.open("rb") as file:
        return file.read(MAX_METADATA_BYTES).decode("utf-8", "replace").splitlines()


def _yaml_value(lines: list[str], key: str) -> str:
    """The text behind `key:`, without quotes; empty where there is none."""
    for line in lines:
        match = YAML_KEY_PATTERN.fullmatch(line)
        if match is not None and match["key"] == key:
            return _unquoted(match["value"])
    return ""


def _listed_files(lines: list[str]) -> Iterator[str]:
    """The entries of `relative_file_paths`, a block or a flow sequence, as bare file names."""
    inside = False
    for line in lines:
        match = YAML_KEY_PATTERN.fullmatch(line)
        if match is not None and match["key"] == "relative_file_paths":
            flow = match["value"].removeprefix("[").removesuffix("]")
            yield from (_bare_file_name(entry) for entry in flow.split(",") if entry.strip() != "")
            inside = True
        elif inside:
            item = YAML_ITEM_PATTERN.fullmatch(line)
            if item is None:
                return
            yield _bare_file_name(item["value"])


def _unquoted(text: str) -> str:
    return text.strip().strip("'\"")


def _bare_file_name(entry: str) -> str:
    """Early releases list `BAG/BAG_0.db3`; a bag's files stand in its own folder."""
    return Path(_unquoted(entry)).name


def _find_file(name: str, present: dict[str, Path]) -> Path | None:
    """The file of that name, or the same packed or unpacked since."""
    plain = re.sub(r"\.(?:zstd|zst|gz)$", "", name)
    names = (name, *(plain + suffix for suffix in ("", ".zstd", ".zst", ".gz")))
    return next((present[other] for other in names if other in present), None)


def _numbered_files(folder: Path, present: dict[str, Path]) -> tuple[Path, ...]:
    found = {
        name: match for name in present if (match := BAG_FILE_PATTERN.fullmatch(name)) is not None
    }
    names = sorted(found, key=natural_key)
    if len({match["bag"] for match in found.values()}) > 1:
        some = ", ".join(names[:8])
        raise LogError(f"{folder}: several bags ({some}); give the file of one of them")
    if len(names) == 0:
        raise LogError(
            f"{folder}: a directory without a bag: no .mcap, .db3 or {METADATA_FILE} in it; "
            "`clt import --list` names other formats"
        )
    return tuple(present[name] for name in names)
