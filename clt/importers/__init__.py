"""Other people's formats into a `Recording`. A format is one function in one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from clt.core.recording import Recording
from clt.importers import thu, thu_capture, tiers, vub


class Format(NamedTuple):
    """One importable format."""

    about: str
    """One line for `clt import --list`."""
    files: Callable[[Path], tuple[Path, ...]]
    """What the path given on the command line stands for."""
    read: Callable[[Path], Recording]


FORMATS = {
    "thu": Format(
        "Tsinghua range_only_CL, run of 2019-04-18: the folder with data190313.mat and Data1.txt",
        thu.files,
        thu.read_thu,
    ),
    "thu-capture": Format(
        "binary stream of the Tsinghua radios (range_only_CL, pc.txt or test.txt), plain or gzip",
        thu_capture.files,
        thu_capture.read_capture,
    ),
    "tiers": Format(
        "ROS 2 bag of the TIERS lab (TurtleBot4, UWB, OptiTrack): its folder, .db3 or .db3.gz",
        tiers.files,
        tiers.read_tiers,
    ),
    "vub": Format(
        "VUB's TurtleBot4 pair (UWB, visual odometry, Vicon) as CSV: FOLDER/exp4, or one file",
        vub.files,
        vub.read_vub,
    ),
}
"""By the name that `clt import` takes."""
