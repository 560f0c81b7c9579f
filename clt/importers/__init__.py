"""Other people's formats into a `Recording`. A format is one function in one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from clt.core.recording import Recording
from clt.importers import thu, thu_capture, tiers, vub


class ImportFormat(NamedTuple):
    """One importable format."""

    about: str
    """One line for `clt import --list`."""
    files: Callable[[Path], tuple[Path, ...]]
    """What the path given on the command line stands for."""
    read: Callable[[Path], Recording]


IMPORT_FORMATS = {
    "thu": ImportFormat(
        "Tsinghua range_only_CL, run of 2019-04-18: the folder with data190313.mat and Data1.txt",
        thu.thu_files,
        thu.read_thu,
    ),
    "thu-capture": ImportFormat(
        "binary stream of the Tsinghua radios (range_only_CL, pc.txt or test.txt), plain or gzip",
        thu_capture.capture_files,
        thu_capture.read_capture,
    ),
    "tiers": ImportFormat(
        "ROS 2 bag of the TIERS lab (TurtleBot4, UWB, OptiTrack): its folder, .db3 or .db3.gz",
        tiers.tiers_files,
        tiers.read_tiers,
    ),
    "vub": ImportFormat(
        "VUB's TurtleBot4 pair (UWB, visual odometry, Vicon) as CSV: FOLDER/exp4, or one file",
        vub.vub_files,
        vub.read_vub,
    ),
}
"""By the name that `clt import` takes."""
