"""ROS 2 bags: a folder (sqlite3 or MCAP, split or not, zstd) or one file of it, as a clt log.

`--streams` maps its topics to robots, as for every command that reads a log; without it only topics
named as clt names them are read. Of what is not mapped nothing is taken over. Stamps, frames and
log times stay as they are.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from clt.core.document import Document
from clt.core.errors import LogError
from clt.core.recording import Recording
from clt.importers.columns import run_notes
from clt.log.mcap.bag import find_bag
from clt.log.recording.load import load


def rosbag2_files(path: Path) -> tuple[Path, ...]:
    """The file itself, or those of the bag in a folder. Raises LogError where there is none."""
    return find_bag(path).files if path.is_dir() else (path,)


def read_rosbag2(path: Path, streams: Document | None) -> Recording:
    """Read what `streams` maps of a bag.

    Raises:
        LogError: for a bag that cannot be read or of which nothing is mapped.
        UsageError: for a wrong streams file.
    """
    loaded = load(path, streams)
    recording = loaded.recording
    messages = (*recording.odometry, *recording.truth, *recording.ranges.stamp[:1])
    if len(messages) == 0 and len(recording.frames.stamp) == 0:
        raise LogError(
            f"{path}: no topic of it is mapped to a robot; name them with --streams FILE, "
            f"which `clt streams {path}` drafts"
        )
    left = sorted(set(loaded.topics) - loaded.used)
    notes = [f"topics: {', '.join(sorted(loaded.used))}"]
    if len(left) > 0:
        notes.append(f"{len(left)} topics were left out")
    return replace(recording, run=run_notes(notes))
