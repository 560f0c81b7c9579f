from __future__ import annotations

import json
import shutil
import subprocess
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from clt.core.errors import CltError
from clt.exporters import EXPORT_FORMATS
from clt.importers.tum import read_tum
from clt.metrics.evaluate import evaluate


def written(export, folder):
    for one in export.files:
        (folder / one.name).write_bytes(one.make())
    return folder


def test_names_and_numbers_come_back(tmp_path, synthetic):
    recording = synthetic(n=60)
    export = EXPORT_FORMATS["tum"].write(recording, "log")
    names = {one.name for one in export.files}
    streams = ("estimate", "dead_reckoning", "ground_truth")
    moving = {f"R{k}.{stream}.tum" for k in (1, 2, 3) for stream in streams}
    assert names == moving | {"A1.ground_truth.tum", "A2.ground_truth.tum"}
    assert set(export.frames.values()) == {"world"}
    assert all(one.rows == 60 for one in export.files)
    back = read_tum([written(export, tmp_path)])
    for kind in ("truth", "estimate", "dead_reckoning"):
        for name, poses in getattr(recording, kind).items():
            found = getattr(back, kind)[name]
            assert found.stamp.tolist() == poses.stamp.tolist()
            assert found.x.tolist() == poses.x.tolist()
            assert found.heading == pytest.approx(poses.heading, abs=1e-12)


def test_an_unknown_heading_is_a_quaternion_of_zeros(tmp_path, synthetic):
    recording = synthetic(n=20, moving=1)
    blind = replace(recording.truth["R1"], heading=np.full(20, np.nan))
    export = EXPORT_FORMATS["tum"].write(replace(recording, truth={"R1": blind}), "log")
    text = (written(export, tmp_path) / "R1.ground_truth.tum").read_text()
    assert all(line.endswith(" 0 0 0 0.0 0.0") for line in text.splitlines())
    assert np.isnan(read_tum([tmp_path]).truth["R1"].heading).all()


def test_poses_that_are_not_finite_are_left_out_and_counted(synthetic):
    recording = synthetic(n=20, moving=1)
    track = recording.estimate["R1"]
    x = track.x.copy()
    x[3] = np.nan
    export = EXPORT_FORMATS["tum"].write(
        replace(recording, estimate={"R1": replace(track, x=x)}), "log"
    )
    one = next(one for one in export.files if one.name == "R1.estimate.tum")
    assert (one.rows, one.make().count(b"\n"), b"nan" in one.make()) == (19, 19, False)
    (found,) = export.diagnostics
    assert (found.kind, found.severity, found.values["count"]) == ("poses_not_finite", "partial", 1)


def test_a_log_without_trajectories_is_refused(synthetic):
    with pytest.raises(CltError, match="no trajectory to export"):
        EXPORT_FORMATS["tum"].write(
            replace(synthetic(n=20), truth={}, estimate={}, dead_reckoning={}), "log"
        )


@pytest.mark.skipif(shutil.which("evo_ape") is None, reason="evo is not installed")
def test_evo_reads_the_files_and_finds_the_same_error(tmp_path, synthetic):
    recording = synthetic(n=200)
    folder = written(EXPORT_FORMATS["tum"].write(recording, "log"), tmp_path)
    truth, estimate = folder / "R2.ground_truth.tum", folder / "R2.estimate.tum"
    environment = {"HOME": str(tmp_path), "PATH": "/usr/bin:/bin"}
    program = {name: shutil.which(name) for name in ("evo_ape", "evo_traj")}
    traj = subprocess.run(
        [program["evo_traj"], "tum", truth, estimate, "--full_check"],
        env=environment, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert traj.stdout.count("SE(3) conform\tyes") == 2
    assert traj.stdout.count("timestamps\tok") == 2
    assert traj.stdout.count("nr. of poses\t200") == 2
    subprocess.run(
        [program["evo_ape"], "tum", truth, estimate, "--save_results", tmp_path / "ape.zip"],
        env=environment, capture_output=True, check=True,
    )  # fmt: skip
    with zipfile.ZipFile(tmp_path / "ape.zip") as archive:
        evo = json.loads(archive.read("stats.json"))
    ours = evaluate(recording).estimate.scores["R2"].ape
    assert ours.rmse == pytest.approx(evo["rmse"], abs=1e-9)
    assert ours.max == pytest.approx(evo["max"], abs=1e-9)
