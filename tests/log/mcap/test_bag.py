"""Folders of `ros2 bag record` as logs."""

from __future__ import annotations

import hashlib
import json
import shutil
import sqlite3
import tempfile
import tracemalloc
from io import BytesIO

import numpy as np
import pytest
import zstandard
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.errors import LogError
from clt.log import unfinished
from clt.log.cdr.schemas import ros2msg
from clt.log.mcap.bag import find_bag
from clt.log.mcap.opened import open_log_file
from clt.log.mcap.packed import UnpackedFile
from clt.log.recording.load import load
from tests.importers.bags import SECOND
from tests.log.logs import small_log
from tests.log.ros_bags import START, ros_bag, split, team

MAPPING = """
[robots.tb1]
odometry = "/tb1/odom"
ground_truth = "/mocap/tb1/pose"
[robots.tb2]
odometry = "/tb2/odom"
[robots.beacon]
static = true
[[ranges]]
topic = "/uwb/{source}/{target}"
"""


ENDLESS = """ALTER TABLE messages RENAME TO m; CREATE VIEW messages AS WITH RECURSIVE n(i) AS
(SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp, '' AS data
FROM n"""


@pytest.fixture(scope="module")
def topics():
    return team(2.0)


@pytest.fixture
def streams(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(MAPPING)
    return path


def same(a, b):
    assert np.array_equal(a.ranges.range, b.ranges.range)
    assert np.array_equal(a.ranges.stamp, b.ranges.stamp)
    assert np.array_equal(a.odometry["tb2"].omega, b.odometry["tb2"].omega)
    assert np.array_equal(a.truth["tb1"].x, b.truth["tb1"].x)
    assert a.faults == b.faults == ()


def test_every_storage_is_the_same_log(tmp_path, topics, streams):
    """SQLite with and without definitions, MCAP; plain, packed as a whole or by message."""
    whole = load(ros_bag(tmp_path / "db3", topics), streams)
    assert len(whole.recording.ranges.stamp) == 30
    assert whole.recording.truth["tb1"].frame == "world"
    assert whole.sha256 == hashlib.sha256((tmp_path / "db3" / "db3.db3").read_bytes()).hexdigest()
    others = [
        {"version": 8},
        {"mcap": True},
        {"compression": "file"},
        {"compression": "message"},
        {"mcap": True, "compression": "file"},
    ]
    for number, options in enumerate(others):
        folder = ros_bag(tmp_path / f"bag{number}", topics, **options)
        again = load(folder, streams)
        same(whole.recording, again.recording)
        assert {t.name: (t.type, t.count) for t in again.topics.values()} == {
            t.name: (t.type, t.count) for t in whole.topics.values()
        }
    (file,) = (tmp_path / "bag2").glob("*.zstd")
    packed = load(file, streams)
    same(whole.recording, packed.recording)
    assert packed.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_an_unpacked_database_is_gone_at_the_end_and_at_a_signal(tmp_path, topics, monkeypatch):
    (file,) = ros_bag(tmp_path / "bag", topics, compression="file").glob("*.zstd")
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    (place / ".unpacked.clt-0123abcd.db3").write_bytes(b"of a process that was killed")
    with open_log_file(file, lambda *_: True) as scanned:
        assert sum(1 for _ in scanned) > 0
        assert len(list(place.rglob("*.db3"))) == 1
        unfinished.discard()  # as `clt.cli.entry.exit_on_signal` does
        assert list(place.iterdir()) == []
    with open_log_file(file, lambda *_: True):
        pass
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("mcap", [False, True])
def test_split_recordings(tmp_path, topics, streams, mcap):
    """In the order of metadata.yaml; by number without it. One digest over all, and each file's."""
    half = START + SECOND
    early, late = (
        {
            name: (kind, [row for row in rows if (row[0] < half) == first])
            for name, (kind, rows) in topics.items()
        }
        for first in (True, False)
    )
    del early["/tb2/odom"]
    parts = [
        ros_bag(tmp_path / f"part{k}", part, mcap=mcap) for k, part in enumerate((early, late))
    ]
    folder = split(tmp_path / "run", parts)
    loaded = load(folder, streams)
    assert len(loaded.recording.ranges.stamp) == 30
    assert len(loaded.recording.odometry["tb2"].stamp) == 10
    lines = "".join(f"{loaded.files[name]}  {name}\n" for name in loaded.files)
    assert loaded.sha256 == hashlib.sha256(lines.encode()).hexdigest()
    assert [file.name for file in find_bag(folder).files] == list(loaded.files)
    (folder / "metadata.yaml").unlink()
    same(load(folder, streams).recording, loaded.recording)


def test_a_missing_or_empty_part_is_a_fault(tmp_path, topics, streams):
    parts = [ros_bag(tmp_path / f"part{k}", topics, mcap=True) for k in range(2)]
    folder = split(tmp_path / "run", parts)
    (folder / "run_1.mcap").write_bytes(b"")
    (fault,) = load(folder, streams).recording.faults
    assert (fault.kind, fault.data_lost) == ("file", True)
    assert "run_1.mcap: is empty" in fault.text
    (folder / "run_1.mcap").unlink()
    (fault,) = load(folder, streams).recording.faults
    assert "run_1.mcap: is listed in metadata.yaml, but not there" in fault.text
    (folder / "run_0.mcap").unlink()
    with pytest.raises(LogError, match=r"none of the files that metadata.yaml lists"):
        load(folder, streams)


def test_faults_name_the_file(tmp_path, topics, streams):
    parts = [ros_bag(tmp_path / f"part{k}", topics, mcap=True) for k in range(2)]
    folder = split(tmp_path / "run", parts)
    path = folder / "run_0.mcap"
    path.write_bytes(path.read_bytes()[:-200])
    faults = load(folder, streams).recording.faults
    assert any(str(path) in fault.text for fault in faults)


def test_folders_without_one_bag(tmp_path):
    with pytest.raises(LogError, match="without a bag"):
        find_bag(tmp_path)
    for name in ("a.mcap", "b_0.mcap", "b_1.mcap"):
        (tmp_path / name).write_bytes(small_log())
    with pytest.raises(LogError, match=r"several bags \(a.mcap, b_0.mcap, b_1.mcap\)"):
        load(tmp_path)
    (tmp_path / "a.mcap").unlink()
    assert len(load(tmp_path).recording.faults) > 0  # the same again: its stamps repeat
    assert [file.name for file in find_bag(tmp_path).files] == ["b_0.mcap", "b_1.mcap"]


@pytest.mark.parametrize(
    "text",
    [
        "rosbag2_bagfile_information:\n  relative_file_paths: [x/b_1.mcap, 'b_0.mcap']\n",
        '  relative_file_paths:\n    - x/b_1.mcap.zstd\n    - "b_0.mcap"\n  duration: 1\n',
    ],
)
def test_order_of_metadata(tmp_path, text):
    """Flow or block, in quotes, with the folder of early releases, packed or unpacked since."""
    for name in ("b_0.mcap", "b_1.mcap"):
        (tmp_path / name).write_bytes(small_log())
    (tmp_path / "metadata.yaml").write_text(text)
    assert [file.name for file in find_bag(tmp_path).files] == ["b_1.mcap", "b_0.mcap"]


@pytest.mark.parametrize(
    "change",
    [
        "DROP TABLE messages",
        ENDLESS,
        "DELETE FROM messages",
    ],
)
def test_hostile_databases_are_one_line(tmp_path, topics, change):
    path = ros_bag(tmp_path / "bag", topics) / "bag.db3"
    database = sqlite3.connect(path)
    database.executescript(change)
    database.close()
    with pytest.raises(LogError) as caught:
        load(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_a_type_without_definition_is_only_listed(tmp_path, topics):
    path = ros_bag(tmp_path / "bag", topics, version=8) / "bag.db3"
    with sqlite3.connect(path) as database:
        database.execute("UPDATE topics SET type = 'own_msgs/msg/Thing' WHERE name = '/rosout'")
    database.close()
    assert load(path).topics["/rosout"].type == "own_msgs/Thing"
    with pytest.raises(LogError, match="/rosout"):
        load(path, streams_of(tmp_path, '[robots.a]\nodometry = "/rosout"\n'))


def streams_of(tmp_path, text):
    path = tmp_path / "other.toml"
    path.write_text(text)
    return path


def test_packed_files_have_limits(tmp_path):
    """Zeros pack 10,000 times smaller: no log does."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    parts = [packer.compress(bytes(1 << 24)) for _ in range(20)]
    bomb = UnpackedFile(BytesIO(b"".join(parts) + packer.flush()), "zstd", "bomb")
    with pytest.raises(LogError, match="bomb: unpacks to 200 times its size"):
        bomb.copy(tmp_path / "unpacked")
    damaged = tmp_path / "d.mcap.zstd"
    packed = zstandard.ZstdCompressor().compress(small_log())
    damaged.write_bytes(packed[: len(packed) // 2] + b"\xff" * 9 + packed[len(packed) // 2 :])
    with pytest.raises(LogError, match="damaged zstd"):
        load(damaged)


def test_only_wanted_payloads_are_fetched(tmp_path, topics, streams):
    """Camera images of a bag cost no memory."""
    path = ros_bag(tmp_path / "bag", topics) / "bag.db3"
    with sqlite3.connect(path) as database:
        database.execute(
            "INSERT INTO topics SELECT 99, '/image', 'sensor_msgs/msg/Image', "
            "serialization_format, offered_qos_profiles, type_description_hash FROM topics LIMIT 1"
        )
        database.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (99, 1, zeroblob(300000000))"
        )
    database.close()
    tracemalloc.start()
    loaded = load(path, streams)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert loaded.topics["/image"].count == 1
    assert peak < 50e6


def test_commands_take_folders(tmp_path, topics, streams):
    folder = ros_bag(tmp_path / "bag", topics, mcap=True)

    def clt(*words):
        return CliRunner().invoke(app, [str(word) for word in words])

    done = clt("info", folder, "--streams", streams, "--json")
    assert done.exit_code == 0, done.output
    printed = json.loads(done.stdout)
    assert printed["ranges"] == 30
    assert list(printed["files"]) == ["bag.mcap"]
    done = clt("recover", folder, "-o", tmp_path / "saved.mcap")
    assert done.exit_code == 2
    assert str(folder / "bag.mcap") in done.stderr
    done = clt("info", folder, "-o", folder / "bag.mcap", "--force")
    assert done.exit_code == 1
    assert "is also an input" in done.stderr


def test_floats_without_definitions_are_read(tmp_path, topics, streams):
    """Bags before Iron: the standard types are shipped."""
    for kind in ("std_msgs/msg/Float32", "std_msgs/msg/Float64"):
        assert ros2msg(kind).endswith("data\n")
    folder = ros_bag(tmp_path / "bag", topics, version=8)
    with sqlite3.connect(folder / "bag.db3") as database:
        database.execute("DROP TABLE IF EXISTS message_definitions")
    database.close()
    shutil.move(folder / "bag.db3", tmp_path / "alone.db3")
    assert len(load(tmp_path / "alone.db3", streams).recording.ranges.stamp) == 30
