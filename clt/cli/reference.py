"""`--truth` and `--truth-offset`: a reference from other files than the log."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from clt.core.diagnostics import Diagnostic
    from clt.core.document import Document
    from clt.core.recording import Poses, Recording

TruthOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--truth",
        metavar="FILE",
        help="Ground truth from another log, or a TUM or CSV trajectory (ROBOT.tum, NAME=PATH), "
        "instead of the log's own; may be repeated.",
    ),
]
TruthOffsetOption = Annotated[
    str | None,
    typer.Option(
        "--truth-offset",
        metavar="S|auto",
        help="Seconds to add to the stamps of --truth; auto: estimated from the motion.",
    ),
]
AUTOMATIC = "auto"
TABLE_ENDS, TRAJECTORY_ENDS = (".csv", ".csv.gz"), (".tum", ".txt", ".tum.gz", ".txt.gz")
MAX_OFFSET_S = 1e10
"""Beyond the year 2250."""


@dataclass(frozen=True)
class ReferenceFiles:
    """Where the truth comes from, and by how much its clock is off."""

    paths: tuple[Path, ...]
    offset_ns: int | None = 0
    """None: to be estimated."""

    @property
    def files(self) -> tuple[Path, ...]:
        """The files themselves, without `NAME=`."""
        from clt.importers.named import plain_path

        return tuple(plain_path(path) for path in self.paths)


def parse_reference(truth: list[Path] | None, offset: str | None) -> ReferenceFiles | None:
    """What the options say; None without `--truth`. Raises UsageError for a wrong offset."""
    from decimal import Decimal, InvalidOperation

    from clt.core.errors import UsageError

    if not truth:
        if offset is not None:
            raise UsageError("--truth-offset shifts the stamps of --truth FILE; give that, too")
        return None
    if offset is None or offset == AUTOMATIC:
        return ReferenceFiles(tuple(truth), None if offset == AUTOMATIC else 0)
    try:
        seconds = Decimal(offset)
    except InvalidOperation:
        seconds = Decimal("NaN")
    if not seconds.is_finite() or abs(seconds) > MAX_OFFSET_S:
        raise UsageError(f"--truth-offset {offset}: give seconds, or auto")
    return ReferenceFiles(tuple(truth), int(seconds * 1_000_000_000))


def apply_reference(
    recording: Recording, given: ReferenceFiles, streams: Document | None
) -> tuple[Recording, list[Diagnostic]]:
    """The recording with the truth of other files; what was said of it.

    Raises CltError naming the file that cannot be used, or the offset that cannot be found.
    """
    from clt.core.diagnostics import Diagnostic
    from clt.core.errors import CltError
    from clt.metrics.reference import assign_reference, with_reference

    truth = assign_reference(_read(given, streams), recording)
    if given.offset_ns is not None:
        found = [] if given.offset_ns == 0 else [_offset_given(given.offset_ns)]
        return with_reference(recording, truth, given.offset_ns), found
    if any(poses.frame.endswith("/base_link") for poses in recording.estimate.values()):
        raise CltError(
            "--truth-offset auto needs estimates in the world, not relative ones: give seconds"
        )
    from clt.metrics.time_offset import estimate_time_offset

    offset = estimate_time_offset(truth, recording.estimate, recording.dead_reckoning)
    values = {"offset_s": offset.nanoseconds * 1e-9, "correlation": offset.correlation}
    said = Diagnostic("truth_offset_estimated", severity="information", values=values)
    return with_reference(recording, truth, offset.nanoseconds), [said]


def _offset_given(offset_ns: int) -> Diagnostic:
    from clt.core.diagnostics import Diagnostic

    values = {"offset_s": offset_ns * 1e-9}
    return Diagnostic("truth_offset_given", severity="information", values=values)


def _read(given: ReferenceFiles, streams: Document | None) -> dict[str, Poses]:
    """The truth in all files by robot."""
    from clt.core.errors import CltError, UsageError
    from clt.importers.csv_tables import read_csv_tables
    from clt.importers.named import plain_path
    from clt.importers.tum import read_tum
    from clt.log.recording.load import load
    from clt.metrics.reference import REFERENCE_FRAME

    found: dict[str, Poses] = {}
    for path in given.paths:
        if str(path).endswith(TABLE_ENDS + TRAJECTORY_ENDS):
            read = read_csv_tables if str(path).endswith(TABLE_ENDS) else read_tum
            tracks = {
                name: replace(poses, frame=REFERENCE_FRAME)
                for name, poses in read((path,)).truth.items()
            }
        elif plain_path(path) != path:
            raise UsageError(
                f"--truth {path}: a log names its robots itself; NAME=PATH is for trajectories"
            )
        else:
            tracks = dict(load(path, streams, frozenset({"truth"})).recording.truth)
        if len(tracks) == 0:
            raise CltError(f"{path}: no ground truth in it")
        twice = sorted(found.keys() & tracks.keys())
        if len(twice) > 0:
            raise CltError(f"{path}: a second truth of {', '.join(twice)}")
        found |= tracks
    return found
