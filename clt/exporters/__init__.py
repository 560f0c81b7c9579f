"""A `Recording` into other people's formats. A format is one function in one file."""

from __future__ import annotations

from clt.exporters import csv_tables, npz, pyfg, tum
from clt.exporters.export import ExportFormat

EXPORT_FORMATS = {
    "tum": ExportFormat(
        "trajectories for evo, a file for each robot and stream: t x y z qx qy qz qw",
        tum.write_tum,
    ),
    "csv": ExportFormat(
        "the same as tables with a head line, covariances beside the poses",
        csv_tables.write_csv,
    ),
    "npz": ExportFormat("every column of the log as numpy arrays, in one file", npz.write_npz),
    "pyfg": ExportFormat(
        "a planar factor graph (PyFactorGraph): poses, odometry, ranges, landmarks",
        pyfg.write_pyfg,
    ),
}
"""By the name that `clt export --format` takes."""
