from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest

from clt.core.errors import LogError
from clt.core.geometry import wrap_angle
from clt.importers.columns import NOTES_KEY
from clt.importers.labyrinth import labyrinth_files, read_labyrinth

REAL = Path(__file__).parents[3] / "shared" / "data" / "labyrinth_uwb"
TIMES = np.arange(1, 41) * 0.125
ANCHORS = {105: (0.0, 0.5), 107: (0.0, 2.5)}
SPEED, TURN, HALF = 0.4, 0.3, 0.08


def lines(new=False, backwards=False):
    """A circle: range2, odom2diff; and the truth apart. Standing for the first ten rows."""
    noise = (0.01, 0.0001) if new else (0.1, 0.01)
    v = np.where(np.arange(40) < 10, 0.0, -SPEED if backwards else SPEED)
    omega = np.where(np.arange(40) < 10, 0.0, TURN)
    heading = np.cumsum(omega * 0.125)
    middle = heading - omega * 0.0625
    chord = v * 0.125 * np.sinc(omega * 0.0625 / np.pi)
    x, y = np.cumsum(chord * np.cos(middle)), np.cumsum(chord * np.sin(middle))
    data, truth = [], []
    for k, t in enumerate(TIMES):
        anchor = (105, 107)[k % 2]
        end = " 0 " if new else "  "
        position = " ".join(map(str, ANCHORS[anchor]))
        data.append(f"range2 {t} {2.0 + t} {noise[0]} {position} {anchor}{end}")
        w1, w2 = v[k] - omega[k] * HALF, v[k] + omega[k] * HALF
        data.append(f"odom2diff {t} {w1} {w2} 0 {HALF} {noise[1]} {noise[1]} {noise[1]}")
        truth.append(f"{'point2' if new else 'gt2'} {t} {x[k]} {y[k]}{' 0 0 0 0' if new else ''}")
    return data, truth, heading


def write(path, *groups):
    data = "\n".join([line for group in groups for line in group] + [""]).encode()
    path.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)


@pytest.fixture
def whole(tmp_path):
    path = tmp_path / "Data_Indoor_UWB.txt.gz"
    data, truth, _ = lines()
    write(path, data, truth)
    return path


def test_streams(whole):
    recording = read_labyrinth(whole.parent)
    team = recording.team
    assert team.names == ("robot", "A105", "A107")
    assert [robot.id for robot in team.robots] == [1, 105, 107]
    assert team.robots[2].position == (0.0, 2.5)
    odometry = recording.odometry["robot"]
    assert odometry.v[10:] == pytest.approx(SPEED)
    assert odometry.omega[10:] == pytest.approx(TURN)
    assert odometry.sigma_v == pytest.approx(0.01 / np.sqrt(2))
    assert odometry.sigma_omega == pytest.approx(0.01 * np.sqrt(2) / (2 * HALF))
    ranges = recording.ranges
    assert ranges.target.tolist() == [1, 2] * 20
    assert ranges.raw == pytest.approx(2.0 + TIMES)
    assert ranges.sigma == pytest.approx(0.1)
    assert recording.faults == ()


@pytest.mark.parametrize("backwards", [False, True])
def test_true_heading_where_it_moves(tmp_path, backwards):
    data, truth, heading = lines(backwards=backwards)
    write(tmp_path / "run.txt", data, truth)
    found = read_labyrinth(tmp_path / "run.txt").truth["robot"].heading
    known = np.isfinite(found)
    assert not known[:10].any()
    assert known[12:38].all()
    assert np.cos(found[12:38] - heading[12:38]) == pytest.approx(1.0, abs=1e-3)


def test_no_heading_where_it_turns(tmp_path):
    data, truth, _ = lines()
    data = [
        line.replace(" 0 0.08 ", " 0 0.04 ") if line.startswith("odom") else line for line in data
    ]
    write(tmp_path / "run.txt", data, truth)
    assert np.isnan(read_labyrinth(tmp_path / "run.txt").truth["robot"].heading).all()


def test_the_newer_form_states_variances(tmp_path):
    data, truth, _ = lines(new=True)
    write(tmp_path / "a_Input.txt", data)
    write(tmp_path / "a_GT.txt", truth)
    recording = read_labyrinth(tmp_path)
    assert labyrinth_files(tmp_path) == (tmp_path / "a_Input.txt", tmp_path / "a_GT.txt")
    assert recording.ranges.sigma == pytest.approx(0.1)
    assert recording.odometry["robot"].sigma_v == pytest.approx(0.01 / np.sqrt(2))
    assert len(recording.truth["robot"].stamp) == 40
    assert json.loads(recording.run[NOTES_KEY])[0].startswith("the newer form")
    (tmp_path / "a_GT.txt").unlink()
    assert read_labyrinth(tmp_path).truth == {}


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("imu 1 2 3", "line 81: `imu` is none of range2, odom2diff"),
        ("range2 1.0 2.0", "line 81: no time and 5 numbers behind `range2`"),
        ("range2 -1 2 0.1 0 0.5 105", "line 81: no time"),
        ("range2 9 2 0.1 0 0.7 105", r"anchor 105 is at \(0.0, 0.7\) and at \(0.0, 0.5\)"),
        ("range2 9 2 0.1 0 0.7 1.5", "1.5 is no id of an anchor"),
        ("odom2diff 9 0 0 0 0 1 1 1", "half the track is not positive"),
    ],
)
def test_one_line_for_what_does_not_fit(tmp_path, line, said):
    data, _, _ = lines()
    write(tmp_path / "run.txt", data, [line])
    with pytest.raises(LogError, match=said) as caught:
        read_labyrinth(tmp_path / "run.txt")
    assert "\n" not in str(caught.value)


def test_what_is_no_run(tmp_path):
    with pytest.raises(LogError, match=r"one \*_Input\.txt; it has: none of its files"):
        labyrinth_files(tmp_path)
    write(tmp_path / "a_Input.txt", lines()[1])
    with pytest.raises(LogError, match="no line `range2`"):
        read_labyrinth(tmp_path)


def test_the_real_run():
    if not REAL.is_dir():
        pytest.skip("the labyrinth is not here")
    recording = read_labyrinth(REAL)
    assert len(recording.ranges.stamp) == 7273
    short = read_labyrinth(REAL / "Indoor_UWB_Input.txt")
    odometry, first = recording.odometry["robot"], short.odometry["robot"]
    same = slice(0, len(first.stamp))
    assert np.array_equal(odometry.v[same], first.v)
    assert first.sigma_omega == pytest.approx(odometry.sigma_omega[same])
    assert short.ranges.sigma == pytest.approx(recording.ranges.sigma[: len(short.ranges.sigma)])
    truth = recording.truth["robot"]
    # What the wheels turn from one straight piece to the next is what the truth turns; exchanged
    # wheels would turn the other way.
    known = np.isfinite(truth.heading)
    step = np.diff(odometry.stamp, prepend=odometry.stamp[0]) * 1e-9
    for sign, good in ((1.0, True), (-1.0, False)):
        driven = np.cumsum(sign * odometry.omega * step)
        off = np.abs(wrap_angle(np.diff(truth.heading[known] - driven[known])))
        assert (np.quantile(off, 0.99) < 0.3) == good
