"""Other people's formats into a `Recording`. A format is one function in one file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from clt.core.document import Document
from clt.core.recording import Recording
from clt.importers import (
    csv_tables,
    labyrinth,
    mrclam,
    plaza,
    pyfg,
    rosbag2,
    thu,
    thu_capture,
    tiers,
    tum,
    vub,
)

Paths = tuple[Path, ...]


class ImportFormat(NamedTuple):
    """One importable format."""

    about: str
    """One line for `clt import --list`."""
    files: Callable[[Paths], Paths]
    """What the paths given on the command line stand for."""
    read: Callable[[Paths, Document | None], Recording]
    """The paths, and the streams file where one is given."""
    several: bool = False
    """It takes several paths."""
    streams: bool = False
    """It takes a streams file."""


def one_path(
    about: str, files: Callable[[Path], Paths], read: Callable[[Path], Recording]
) -> ImportFormat:
    """A format whose data set is one path."""
    return ImportFormat(about, lambda paths: files(paths[0]), lambda paths, _: read(paths[0]))


IMPORT_FORMATS = {
    "csv": ImportFormat(
        "tables with a head line: ranges, odometry, ground truth, static robots; files or a folder",
        csv_tables.csv_files,
        lambda paths, _: csv_tables.read_csv_tables(paths),
        several=True,
    ),
    "labyrinth": one_path(
        "TU Chemnitz's UWB run (libRSF, Indoor_UWB): its folder, the whole run, or an *_Input.txt",
        labyrinth.labyrinth_files,
        labyrinth.read_labyrinth,
    ),
    "mrclam": one_path(
        "UTIAS MRCLAM: the folder of one data set (RobotN_*.dat, Barcodes.dat), plain or gzip",
        mrclam.mrclam_files,
        mrclam.read_mrclam,
    ),
    "plaza": one_path(
        "CMU's ranging radios on a mower: PlazaN_.mat, or its folder",
        plaza.plaza_files,
        plaza.read_plaza,
    ),
    "pyfg": one_path(
        "PyFG text graph (PyFactorGraph), planar, plain or gzip",
        pyfg.pyfg_files,
        pyfg.read_pyfg,
    ),
    "rosbag2": ImportFormat(
        "any ROS 2 bag, its topics mapped by --streams: a folder, .mcap or .db3, split or not",
        lambda paths: rosbag2.rosbag2_files(paths[0]),
        lambda paths, streams: rosbag2.read_rosbag2(paths[0], streams),
        streams=True,
    ),
    "thu": one_path(
        "Tsinghua range_only_CL, run of 2019-04-18: the folder with data190313.mat and Data1.txt",
        thu.thu_files,
        thu.read_thu,
    ),
    "thu-capture": one_path(
        "binary stream of the Tsinghua radios (range_only_CL, pc.txt or test.txt), plain or gzip",
        thu_capture.capture_files,
        thu_capture.read_capture,
    ),
    "tiers": one_path(
        "ROS 2 bag of the TIERS lab (TurtleBot4, UWB, OptiTrack): its folder, .db3 or .db3.gz",
        tiers.tiers_files,
        tiers.read_tiers,
    ),
    "tum": ImportFormat(
        "trajectories (t x y z qx qy qz qw), a file for each robot: ROBOT.tum, or NAME=PATH",
        tum.tum_files,
        lambda paths, _: tum.read_tum(paths),
        several=True,
    ),
    "vub": one_path(
        "VUB's TurtleBot4 pair (UWB, visual odometry, Vicon) as CSV: FOLDER/exp4, or one file",
        vub.vub_files,
        vub.read_vub,
    ),
}
"""By the name that `clt import` takes."""
