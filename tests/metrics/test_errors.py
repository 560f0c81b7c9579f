from __future__ import annotations

import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.metrics.associate import MatchedPoses
from clt.metrics.errors import Delta, error_statistics, heading_errors, parse_delta, relative_errors


def pair(truth, estimate, step=0.1):
    truth, estimate = np.array(truth, float), np.array(estimate, float)
    stamp = np.round(np.arange(len(truth)) * step * 1e9).astype(np.int64)
    return MatchedPoses(stamp, truth, estimate, None, len(truth), len(truth))


def test_known_statistics():
    s = error_statistics(np.array([3.0, -4.0, 0.0, np.nan, 5.0]))
    assert s is not None
    assert (s.min, s.max, s.mean, s.median) == (0.0, 5.0, 3.0, 3.5)
    assert s.rmse == pytest.approx(np.sqrt(12.5))
    assert s.std == pytest.approx(np.sqrt(3.5))
    assert s.p95 == pytest.approx(4.85)
    assert error_statistics(np.array([np.nan])) is None


def test_heading_errors_wrap():
    truth = [[0, 0, 3.1], [0, 0, -3.1], [0, 0, 0.2]]
    estimate = [[0, 0, -3.1], [0, 0, 3.1], [0, 0, 0.1]]
    wrapped = 2 * np.pi - 6.2
    assert heading_errors(pair(truth, estimate)) == pytest.approx([wrapped, -wrapped, -0.1])


def test_rpe_sees_drift_but_no_shift_or_turn_of_the_whole():
    x = np.arange(50) * 0.1
    zero = np.zeros(50)
    truth = np.column_stack([x, zero, zero])
    turned = np.column_stack([1.0 - zero, 5.0 + x, zero + np.pi / 2])
    for delta in (Delta(1.0, "s"), Delta(1.0, "m")):
        length, angle = relative_errors(pair(truth, turned), delta)
        assert len(length) == 40
        assert length == pytest.approx(0.0, abs=1e-9)
        assert angle == pytest.approx(0.0, abs=1e-9)
        length, _ = relative_errors(pair(truth, truth * [1.1, 1, 1]), delta)
        assert length == pytest.approx(0.1)


def test_rpe_needs_a_partner_and_headings():
    still = np.zeros((50, 3))
    assert len(relative_errors(pair(still, still), Delta(1.0, "m"))[0]) == 0
    assert len(relative_errors(pair(still, still), Delta(100.0, "s"))[0]) == 0
    assert len(relative_errors(pair(still[:0], still[:0]), Delta(1.0, "s"))[0]) == 0
    headless = still + np.array([0.0, 0.0, np.nan])
    assert error_statistics(relative_errors(pair(headless, still), Delta(1.0, "s"))[0]) is None


def test_rpe_skips_partners_that_a_gap_moved_away():
    rows = np.zeros((4, 3))
    matched = pair(rows, rows)
    late = MatchedPoses(np.array([0, 1, 4, 5]) * 10**9, rows, rows, None, 4, 4)
    assert len(relative_errors(late, Delta(1.0, "s"))[0]) == 2
    assert len(relative_errors(matched, Delta(0.1, "s"))[0]) == 3


@pytest.mark.parametrize(("text", "value"), [("1s", Delta(1.0, "s")), (" 2.5 m", Delta(2.5, "m"))])
def test_delta(text, value):
    assert parse_delta(text) == value


@pytest.mark.parametrize("text", ["", "1", "s", "-1s", "0m", "nans", "infm", "1km", "1h"])
def test_bad_delta(text):
    with pytest.raises(UsageError, match="seconds or metres"):
        parse_delta(text)
