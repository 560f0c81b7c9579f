"""The log on its way to the disk: full disks, parts."""

from __future__ import annotations

import errno
import os

import pytest
from mcap.reader import make_reader

from clt.core.errors import CltError
from clt.devices import log_parts
from clt.devices.log_parts import LogParts, free_bytes
from clt.devices.whole_file import WholeFile
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
        parts.write(one, time, time, bytes(52))
    other = parts.channel("/R2/uwb/range", RANGE)
    parts.write(other, 305, 305, bytes(52))
    parts.finish()
    assert [path.name for path in parts.paths] == [f"o_00{k}.mcap" for k in range(4)]
    assert [count(path) for path in parts.paths] == [10, 10, 10, 2]
    with parts.paths[2].open("rb") as file:
        reader = make_reader(file)
        assert {record.name: record.metadata for record in reader.iter_metadata()} == {
            "clt.run": {"a": "b"}, "clt.team": {"robots": "1"},
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
