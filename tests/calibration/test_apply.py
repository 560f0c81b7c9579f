from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clt.calibration.apply import (
    KEY,
    Calibration,
    OdometryCalibration,
    PairCalibration,
    RangeCalibration,
    apply_calibration,
    read_calibration,
)
from clt.core.errors import LogError, UsageError
from clt.core.recording import Odometry, Ranges, Recording, Robot, Team
from clt.core.settings import parse_settings

CONTRACT = """
[range]                    # every pair: range = gain * raw + offset
gain = 0.9567
offset = 0.6245
[[range.pair]]             # one pair, overrides
ends = ["R1", "R4"]
offset = 0.60
[odometry.R1]
scale = 1.1
gyro_bias = 0.02           # rad/s
"""
TEAM = Team((Robot("R0", 0, static=True), Robot("R1", 1), Robot("R4", 4)))


def recording() -> Recording:
    n = 6
    stamp = np.arange(n, dtype=np.int64)
    raw = np.linspace(1.0, 2.0, n)
    ranges = Ranges(
        stamp=stamp,
        log_time=stamp,
        source=np.array([0, 1, 0, 2, 1, 2]),
        target=np.array([1, 0, 2, 0, 2, 1]),
        range=raw + 7.0,
        raw=raw,
        sigma=np.full(n, 0.1),
        sequence=stamp,
    )
    odometry = {
        name: Odometry(
            stamp=stamp,
            log_time=stamp,
            v=np.linspace(-1.0, 1.0, n),
            omega=np.linspace(0.5, -0.5, n),
            sigma_v=np.full(n, 0.2),
            sigma_omega=np.full(n, 0.1),
        )
        for name in ("R1", "R4")
    }
    return Recording(TEAM, odometry=odometry, ranges=ranges)


def read(tmp_path: Path, text: str) -> Calibration:
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    return read_calibration(path)


def test_contract_example(tmp_path: Path) -> None:
    before = recording()
    after = apply_calibration(before, read(tmp_path, CONTRACT))
    r, raw = after.ranges, before.ranges.raw
    mutual = slice(4, 6)
    assert r.range[:4] == pytest.approx(0.9567 * raw[:4] + 0.6245, abs=1e-15)
    assert r.range[mutual] == pytest.approx(0.9567 * raw[mutual] + 0.60, abs=1e-15)
    assert np.array_equal(r.raw, raw)
    assert np.array_equal(r.sigma, before.ranges.sigma)
    assert after.odometry["R1"].v == pytest.approx(1.1 * before.odometry["R1"].v)
    assert after.odometry["R1"].sigma_v == pytest.approx(0.22)
    assert after.odometry["R1"].omega == pytest.approx(before.odometry["R1"].omega - 0.02)
    assert np.array_equal(after.odometry["R4"].v, before.odometry["R4"].v)


def test_unlisted_pairs_keep_their_range() -> None:
    before = recording()
    pair = PairCalibration(ends=("R4", "R1"), gain=2.0)
    after = apply_calibration(before, Calibration(range=RangeCalibration(pair=(pair,))))
    assert np.array_equal(after.ranges.range[:4], before.ranges.range[:4])
    assert np.array_equal(after.ranges.range[4:], 2.0 * before.ranges.raw[4:])


def test_gain_alone_means_no_offset() -> None:
    after = apply_calibration(recording(), Calibration(range=RangeCalibration(gain=0.5)))
    assert np.array_equal(after.ranges.range, 0.5 * recording().ranges.raw)


def test_odometry_alone_leaves_ranges() -> None:
    calibration = Calibration(odometry={"R1": OdometryCalibration(scale=2.0)})
    assert np.array_equal(
        apply_calibration(recording(), calibration).ranges.range, recording().ranges.range
    )


def test_empty_calibration_takes_the_earlier_odometry_back() -> None:
    before = recording()
    first = apply_calibration(before, Calibration(odometry={"R1": OdometryCalibration(scale=2.0)}))
    assert not np.array_equal(first.odometry["R1"].v, before.odometry["R1"].v)
    assert np.array_equal(
        apply_calibration(first, Calibration()).odometry["R1"].v, before.odometry["R1"].v
    )


def test_recording_without_ranges() -> None:
    after = apply_calibration(Recording(TEAM), Calibration(range=RangeCalibration(gain=0.5)))
    assert len(after.ranges.range) == 0


gains = st.floats(0.1, 10.0)
offsets = st.floats(-5.0, 5.0)
calibrations = st.builds(
    lambda gain, offset, own, scale, bias: Calibration(
        range=RangeCalibration(
            gain=gain, offset=offset, pair=(PairCalibration(ends=("R0", "R4"), offset=own),)
        ),
        odometry={"R1": OdometryCalibration(scale=scale, gyro_bias=bias)},
    ),
    gains,
    offsets,
    offsets,
    gains,
    offsets,
)


@given(calibrations, calibrations)
def test_the_last_calibration_counts(first: Calibration, second: Calibration) -> None:
    directly = apply_calibration(recording(), second)
    after = apply_calibration(apply_calibration(recording(), first), second)
    assert np.array_equal(after.ranges.range, directly.ranges.range)
    assert after.odometry["R1"].v == pytest.approx(directly.odometry["R1"].v, abs=1e-12)
    assert after.odometry["R1"].omega == pytest.approx(directly.odometry["R1"].omega, abs=1e-12)
    assert after.run == directly.run


@given(calibrations)
def test_direction_does_not_matter(calibration: Calibration) -> None:
    before = recording()
    r = before.ranges
    turned = replace(before, ranges=replace(r, source=r.target, target=r.source))
    assert np.array_equal(
        apply_calibration(before, calibration).ranges.range,
        apply_calibration(turned, calibration).ranges.range,
    )


def test_the_input_is_untouched() -> None:
    before = recording()
    apply_calibration(before, Calibration(range=RangeCalibration(gain=0.5)))
    assert np.array_equal(before.ranges.range, recording().ranges.range)
    assert before.run == {}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[rnge]\n", "`rnge`, did you mean `range`?"),
        ("[range]\ngian = 1.0\n", "`range.gian`, did you mean `gain`?"),
        ("[range]\ngain = 0.0\n", "`range.gain`"),
        ("[range]\noffset = nan\n", "`range.offset`"),
        ("[[range.pair]]\nends = ['R1']\n", "`range.pair.0.ends"),
        ("[[range.pair]]\nends = ['R1', 'R1']\n", "both ends are R1"),
        (
            "[[range.pair]]\nends = ['R1', 'R4']\n[[range.pair]]\nends = ['R4', 'R1']\n",
            "R4-R1 is listed twice",
        ),
        ("[odometry.R1]\nscal = 1.0\n", "`odometry.R1.scal`, did you mean `scale`?"),
        ("[odometry.scale]\nscal = 1.0\n", "`odometry.scale.scal`, did you mean `scale`?"),
        ("[odometry]\nR1 = 1.0\n", "`odometry.R1`"),
        ("[range\n", "not valid TOML"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert said in message
    assert "calibration.toml" in message
    assert "\n" not in message


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.toml"):
        read_calibration(tmp_path / "none.toml")


@pytest.mark.parametrize(
    "data",
    [{"odometry": {"R11": {}}}, {"range": {"pair": [{"ends": ["R0", "R11"], "gain": 1.0}]}}],
)
def test_unknown_robot(data: dict[str, object]) -> None:
    with pytest.raises(UsageError, match="unknown robot `R11`, did you mean `R1`"):
        apply_calibration(recording(), parse_settings(Calibration, data, "test"))


def test_unreadable_earlier_calibration() -> None:
    with pytest.raises(LogError, match=r"clt\.run"):
        apply_calibration(replace(recording(), run={KEY: "nonsense"}), Calibration())
