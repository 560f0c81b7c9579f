from __future__ import annotations

from dataclasses import replace
from io import BytesIO

import numpy as np
import pandas as pd
import pytest

from clt.exporters import EXPORT_FORMATS
from clt.exporters.csv_tables import COVARIANCE_COLUMNS
from clt.importers.csv_tables import read_csv_tables


def files_of(recording):
    return {one.name: one.make() for one in EXPORT_FORMATS["csv"].write(recording, "log").files}


def test_pandas_reads_every_number(synthetic):
    recording = synthetic(n=40)
    files = files_of(recording)
    assert {name.removesuffix(".csv") for name in files} == {
        one.name.removesuffix(".tum") for one in EXPORT_FORMATS["tum"].write(recording, "").files
    }
    track = recording.estimate["R2"]
    table = pd.read_csv(BytesIO(files["R2.estimate.csv"]), dtype={"time": str})
    assert list(table) == ["time", "x", "y", "heading", *COVARIANCE_COLUMNS]
    stamp = [int(text.replace(".", "")) for text in table["time"]]
    assert stamp == track.stamp.tolist()
    assert table["x"].tolist() == track.x.tolist()
    assert table["heading"].tolist() == track.heading.tolist()
    for name, (i, j) in COVARIANCE_COLUMNS.items():
        assert table[name].tolist() == track.covariance[:, i, j].tolist()


def test_a_reference_has_no_covariance_and_an_unknown_heading_an_empty_cell(synthetic):
    recording = synthetic(n=10, moving=1)
    blind = replace(recording.truth["R1"], heading=np.full(10, np.nan))
    text = files_of(replace(recording, truth={"R1": blind}))["R1.ground_truth.csv"]
    table = pd.read_csv(BytesIO(text))
    assert list(table) == ["time", "x", "y", "heading"]
    assert table["heading"].isna().all()
    assert b"nan" not in text


def test_our_importer_reads_the_folder(tmp_path, synthetic):
    recording = synthetic(n=30)
    for name, data in files_of(recording).items():
        (tmp_path / name).write_bytes(data)
    back = read_csv_tables([tmp_path])
    assert back.estimate["R3"].heading == pytest.approx(recording.estimate["R3"].heading)
    assert back.truth["R1"].stamp.tolist() == recording.truth["R1"].stamp.tolist()
    assert list(back.dead_reckoning) == list(recording.dead_reckoning)
