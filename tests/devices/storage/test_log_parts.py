"""The log on its way to the disk: full disks, parts."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest
from mcap.reader import make_reader

from clt.core.errors import CltError
from clt.devices.storage import log_parts
from clt.devices.storage.log_parts import LogParts, existing_parts, free_bytes
from clt.devices.storage.whole_file import WholeFile
from clt.log.mcap.live_writer import DiskFullError

RANGE = "clt_msgs/msg/Range"


def count(path):
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())


class SmallDisk(WholeFile):
    """Takes so many bytes."""

    most = 0

    def write(self, data):
        room = self.most - os.lseek(self._file, 0, os.SEEK_CUR)
        if room < len(data):
            super().write(bytes(data[: max(room, 0)]))
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(data)


@pytest.mark.parametrize("most", [4_000, 6_000, 9_000, 20_000])
def test_a_full_disk_costs_chunks_at_the_end(tmp_path, monkeypatch, most):
    monkeypatch.setattr(SmallDisk, "most", most)
    monkeypatch.setattr(log_parts, "WholeFile", SmallDisk)
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {"a": "b"}})
    channel = parts.channel("/R1/uwb/range", RANGE)
    written = []

    def write_on():
        for k in range(100):
            for _ in range(10):
                parts.write(channel, k, k, os.urandom(52))
                written.append(k)
            parts.flush()

    with pytest.raises(DiskFullError):
        write_on()
    parts.close_full()
    kept = count(tmp_path / "o.mcap")
    assert kept % 10 == 0
    assert len(written) - kept <= 60  # chunks of ten; the summary needs room, too
    assert (tmp_path / "o.mcap").stat().st_size <= most
    with (tmp_path / "o.mcap").open("rb") as file:
        statistics = make_reader(file).get_summary().statistics
    assert statistics.message_count == kept


def test_a_log_of_many_small_chunks_makes_room_for_its_long_summary(tmp_path, monkeypatch):
    monkeypatch.setattr(SmallDisk, "most", 200_000)
    monkeypatch.setattr(log_parts, "WholeFile", SmallDisk)
    parts = LogParts(tmp_path / "o.mcap", {})
    channel = parts.channel("/R1/uwb/range", RANGE)

    def write_on():
        for k in range(5000):
            parts.write(channel, k, k, bytes(52))
            parts.flush()

    with pytest.raises(DiskFullError):
        write_on()
    parts.close_full()
    assert count(tmp_path / "o.mcap") > 300


def test_a_part_begins_after_its_time_and_repeats_what_readers_need(tmp_path):
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {"a": "b"}}, split_ns=100)
    one = parts.channel("/R1/uwb/range", RANGE)
    parts.metadata("clt.team", {"robots": "1"})
    for time in range(0, 301, 10):
        if parts.is_part_due(time):
            parts.next_part(time, "clt.carried", {"at": str(time)})
        parts.write(one, time, time, bytes(52))
    other = parts.channel("/R2/uwb/range", RANGE)
    parts.write(other, 305, 305, bytes(52))
    parts.finish()
    assert [path.name for path in parts.paths] == [f"o_00{k}.mcap" for k in range(4)]
    assert [count(path) for path in parts.paths] == [10, 10, 10, 2]
    with parts.paths[2].open("rb") as file:
        reader = make_reader(file)
        assert {record.name: record.metadata for record in reader.iter_metadata()} == {
            "clt.carried": {"at": "200"}, "clt.run": {"a": "b"}, "clt.team": {"robots": "1"},
        }  # fmt: skip
    assert parts.size == sum(path.stat().st_size for path in parts.paths)


def test_a_log_that_exists_or_has_no_folder(tmp_path):
    (tmp_path / "o.mcap").write_bytes(b"mine")
    with pytest.raises(CltError, match="exists; use --force"):
        LogParts(tmp_path / "o.mcap", {})
    with pytest.raises(CltError, match="No such file"):
        LogParts(tmp_path / "none" / "o.mcap", {})


def test_the_room_on_a_disk(tmp_path):
    assert free_bytes(tmp_path / "o.mcap") > 0
    assert free_bytes(tmp_path / "none" / "o.mcap") is None
    assert free_bytes(Path("/dev/null")) is None
    assert free_bytes(Path("-")) is None


class SharedDisk(WholeFile):
    """All files together take so many bytes; none can be created on it once it is `closed`."""

    room = 0
    closed = False

    def __init__(self, path, *, force):
        if SharedDisk.closed:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().__init__(path, force=force)

    def write(self, data):
        taken = min(SharedDisk.room, len(data))
        super().write(bytes(data[:taken]))
        SharedDisk.room -= taken
        if taken < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")
        return len(data)

    def truncate(self):
        end = os.lseek(self._file, 0, os.SEEK_END)
        os.lseek(self._file, 0, os.SEEK_SET)
        here = self.position
        SharedDisk.room += end - here
        os.ftruncate(self._file, here)
        os.lseek(self._file, here, os.SEEK_SET)

    def seek(self, position):
        self.position = position
        return super().seek(position)


@pytest.mark.parametrize("room", [*range(0, 3000, 150), "closed"])
def test_a_disk_that_is_full_when_a_part_begins(tmp_path, monkeypatch, room):
    """The part before is ended in order, and no beginning of the next one is left."""
    monkeypatch.setattr(SharedDisk, "closed", False)
    monkeypatch.setattr(SharedDisk, "room", 1 << 30)
    monkeypatch.setattr(log_parts, "WholeFile", SharedDisk)
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {"a": "b" * 200}}, split_ns=100)
    channel = parts.channel("/R1/uwb/range", RANGE)
    for time in range(100):
        for _ in range(10):
            parts.write(channel, time, time, os.urandom(52))
        if time % 10 == 9:
            parts.flush()
    SharedDisk.closed = room == "closed"
    SharedDisk.room = 10_000 if room == "closed" else room

    def write_on():
        for time in range(100, 10_000, 10):
            if parts.is_part_due(time):
                parts.next_part(time, "clt.carried", {})
            parts.write(channel, time, time, os.urandom(52))
            parts.flush()

    with pytest.raises(DiskFullError):
        write_on()
    parts.close_full()
    left = sorted(tmp_path.iterdir())
    assert left == parts.paths
    assert count(left[0]) >= 900
    for path in left[1:]:
        count(path)


def test_a_part_that_cannot_begin_ends_the_one_before(tmp_path):
    parts = LogParts(tmp_path / "o.mcap", {}, split_ns=100)
    channel = parts.channel("/R1/uwb/range", RANGE)
    parts.write(channel, 0, 0, bytes(52))
    (tmp_path / "o_001.mcap").write_bytes(b"mine")
    with pytest.raises(CltError, match="exists"):
        parts.next_part(100, "clt.carried", {})
    assert count(tmp_path / "o_000.mcap") == 1
    assert (tmp_path / "o_001.mcap").read_bytes() == b"mine"


def test_a_part_holds_more_than_its_beginning(tmp_path):
    """However small parts are asked to be, half of what is written is messages."""
    parts = LogParts(tmp_path / "o.mcap", {"clt.run": {"a": "b" * 3000}}, split_bytes=1)
    channel = parts.channel("/R1/uwb/range", RANGE)
    for time in range(2000):
        if parts.is_part_due(time):
            parts.next_part(time, "clt.carried", {})
        parts.write(channel, time, time, os.urandom(52))
    parts.finish()
    counts = [count(path) for path in parts.paths]
    assert sum(counts) == 2000
    assert 2 <= len(counts) <= 60


def test_the_parts_of_a_name(tmp_path):
    for name in (
        "o_000.mcap",
        "o_001.mcap",
        "o_1000.mcap",
        "o_01.mcap",
        "o_2026-01.mcap",
        "o.mcap",
    ):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "o_002.csv").write_bytes(b"")
    found = [path.name for path in existing_parts(tmp_path / "o.mcap")]
    assert found == ["o_000.mcap", "o_001.mcap", "o_1000.mcap"]
    assert existing_parts(tmp_path / "none" / "o.mcap") == []
