from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.importers.columns import NOTES_KEY
from clt.importers.plaza import plaza_files, read_plaza
from clt.log.recording.channels import integrate_odometry
from clt.model.odometry_gaps import odometry_gaps

REAL = Path(__file__).parents[3] / "shared" / "data" / "plaza2"


def content(turned=np.pi):
    """A circle at 2 m/s, 10 Hz, with one row left out; headings off by `turned`."""
    t = np.delete(100.0 + np.arange(101) / 10, 50)
    angle = 0.2 * (t - 100.0)
    truth = np.column_stack(
        [t, 10 * np.sin(angle), -10 * np.cos(angle), wrap_angle(angle + turned)]
    )
    dt = np.diff(t)
    return {
        "GT": truth,
        "DR": np.column_stack([t[1:], 2.0 * dt, 0.2 * dt]),
        "TD": np.array([[100.05, 2, 6, 9.5], [101.0, 2, 1, 8.5], [102.0, 2, 6, 7.5]]),
        "TL": np.array([[6.0, 1.5, 2.5], [1.0, -3.0, 4.0]]),
    }


@pytest.fixture
def mat(tmp_path):
    path = tmp_path / "Plaza9_.mat"
    savemat(path, content())
    return path


def test_team_ranges_and_truth(mat):
    recording = read_plaza(mat.parent)
    assert recording.team.names == ("mower", "B1", "B6")
    assert [robot.id for robot in recording.team.robots] == [2, 1, 6]
    assert recording.team.robots[2].position == (1.5, 2.5)
    ranges = recording.ranges
    assert ranges.target.tolist() == [2, 1, 2]
    assert ranges.stamp.tolist() == [100_050_000_000, 101_000_000_000, 102_000_000_000]
    assert ranges.raw.tolist() == [9.5, 8.5, 7.5]
    assert recording.truth["B1"].x.tolist() == [-3.0, -3.0]
    assert recording.faults == ()


@pytest.mark.parametrize("turned", [np.pi, 0.0])
def test_headings_point_forward(tmp_path, turned):
    savemat(tmp_path / "a.mat", content(turned))
    recording = read_plaza(tmp_path / "a.mat")
    truth = recording.truth["mower"]
    expected = 0.2 * (truth.stamp * 1e-9 - 100.0)
    assert wrap_angle(truth.heading - expected) == pytest.approx(0.0, abs=1e-9)
    said = json.loads(recording.run[NOTES_KEY])
    assert any("turned by pi" in note for note in said) == (turned != 0.0)


def test_increments_become_means_without_gaps(mat):
    recording = read_plaza(mat)
    odometry = recording.odometry["mower"]
    assert odometry.v == pytest.approx(2.0)
    assert odometry.omega == pytest.approx(0.2)
    assert not odometry_gaps(odometry.stamp).any()
    assert len(odometry.stamp) == 100
    assert odometry.stamp[0] == 100_100_000_000
    _, _, heading = integrate_odometry(odometry, mean=True)
    assert heading[-1] == pytest.approx(0.2 * 9.9)


def test_ranges_to_nobody_are_counted(tmp_path):
    data = content()
    data["TL"] = data["TL"][:1]
    savemat(tmp_path / "a.mat", data)
    recording = read_plaza(tmp_path / "a.mat")
    (fault,) = recording.faults
    assert (fault.kind, fault.count, fault.data_lost) == ("unknown", 1, True)


def broken(**changes):
    return {k: v for k, v in {**content(), **changes}.items() if v is not None}


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (broken(TD=None), "no `TD` in it; it has: DR, GT, TL"),
        (broken(GT=np.zeros((4, 3))), r"`GT` has the shape \(4, 3\), not \(rows, 4\)"),
        (broken(DR=content()["DR"][::-1]), "`DR`, row 2: not later than the row before"),
        (broken(GT=content()["GT"] * [-1, 1, 1, 1]), "`GT`: times are not seconds"),
        (broken(TL=np.array([[1.5, 0, 0]])), "`TL`: the first column holds no ids"),
        (broken(TL=np.array([[1, 0, 0], [1, 0, 0]])), "two beacons share one id"),
        (broken(TD=np.array([[1, 2, 6, np.nan]])), "`TD`, row 1: a value is not finite"),
        (broken(DR=content()["DR"] * [1, 1e13, 1]), "`DR`, row 1: .* or beyond 1e"),
        (broken(TD="text"), "`TD` is not numeric"),
    ],
)
def test_one_line_for_what_does_not_fit(tmp_path, data, said):
    savemat(tmp_path / "a.mat", data)
    with pytest.raises(LogError, match=said) as caught:
        read_plaza(tmp_path / "a.mat")
    assert str(tmp_path / "a.mat") in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_file_of_it(tmp_path):
    with pytest.raises(LogError, match=r"give one Plaza\*_\.mat; it has: none"):
        plaza_files(tmp_path)
    (tmp_path / "a.mat").write_bytes(b"MATLAB" * 30)
    with pytest.raises(LogError, match="not a MATLAB 5 file"):
        read_plaza(tmp_path / "a.mat")


def test_the_real_run():
    if not REAL.is_dir():
        pytest.skip("Plaza 2 is not here")
    recording = read_plaza(REAL)
    truth, odometry = recording.truth["mower"], recording.odometry["mower"]
    assert len(recording.ranges.stamp) == 1816
    assert not odometry_gaps(odometry.stamp).any()
    step = np.hypot(np.diff(truth.x), np.diff(truth.y))
    course = np.arctan2(np.diff(truth.y), np.diff(truth.x))
    off = wrap_angle(course - truth.heading[:-1])[step > 0.2]
    assert abs(np.median(off)) < 0.1
    assert np.sum(odometry.v * np.diff(odometry.stamp, prepend=3_152_000_000_000) * 1e-9) == (
        pytest.approx(np.sum(step), rel=0.01)
    )
