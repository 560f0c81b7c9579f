"""Recordings and scores as data frames of pandas (extra `clt[pandas]`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from clt.core.errors import CltError

if TYPE_CHECKING:
    import pandas as pd

    from clt.core.recording import Recording
    from clt.metrics.evaluation import Evaluation

FLAT_TABLES = ("odometry", "truth", "estimate", "dead_reckoning")
"""Streams of a recording that are kept by robot."""
COVARIANCE_COLUMNS = ("xx", "xy", "xh", "yy", "yh", "hh")
"""Entries of a covariance of (x, y, heading) from its upper half, m and rad, squared."""


def data_frames(recording: Recording) -> dict[str, pd.DataFrame]:
    """The streams of a recording that have data, each a data frame.

    `odometry`, `truth`, `estimate`, `dead_reckoning` have a row per sample and a column `robot`;
    `ranges` and `innovations` a row per range, ends by name. Stamps are int64 ns, all else SI
    units; covariances stand in COVARIANCE_COLUMNS. Raises CltError without pandas.
    """
    frames = _pandas()
    names = np.array(recording.team.names, dtype=object)
    found: dict[str, pd.DataFrame] = {}
    for stream in FLAT_TABLES:
        tracks: Mapping[str, Any] = getattr(recording, stream)
        parts = [
            frames.DataFrame({"robot": name, **_columns(track)}) for name, track in tracks.items()
        ]
        if len(parts) > 0:
            found[stream] = frames.concat(parts, ignore_index=True)
    for stream, table in (("ranges", recording.ranges), ("innovations", recording.innovations)):
        if table is not None and table.stamp.size > 0:
            ends = {"source": names[table.source], "target": names[table.target]}
            found[stream] = frames.DataFrame(_columns(table) | ends)
    return found


def score_frame(evaluation: Evaluation) -> pd.DataFrame:
    """The figures of an evaluation: a row per robot and for the team, of each kind of estimate.

    Columns as in the JSON of `clt evaluate`, joined by dots: `ape.rmse` (m), `heading.rmse` (rad),
    `anees`. Raises CltError without pandas.
    """
    frames = _pandas()
    rows: list[dict[str, Any]] = []
    for kind in ("estimate", "dead_reckoning"):
        side = getattr(evaluation, kind)
        scores = {"team": side.team, **side.scores}
        rows += [
            {"robot": name, "kind": kind, **_flat(score.as_dict())}
            for name, score in scores.items()
            if score is not None
        ]
    found: pd.DataFrame = frames.DataFrame(rows)
    return found


def _columns(table: Any) -> dict[str, Any]:
    """The columns of a table, a covariance as six."""
    columns: dict[str, Any] = {}
    for field in fields(table):
        value = getattr(table, field.name)
        if field.name == "covariance" and value is not None:
            upper = value[:, *np.triu_indices(3)]
            columns |= dict(zip(COVARIANCE_COLUMNS, upper.T, strict=True))
        elif isinstance(value, np.ndarray):
            columns[field.name] = value
    return columns


def _flat(document: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in document.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {}
        if not isinstance(value, Mapping | list):
            flat[prefix + key] = value
    return flat


def _pandas() -> ModuleType:
    try:
        import pandas as pd  # noqa: PLC0415 - optional
    except ImportError:
        raise CltError("data frames need pandas: pip install 'clt[pandas]'") from None
    return pd
