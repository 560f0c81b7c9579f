"""What an evaluation says it could not find."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.recording import Poses, Robot, Team
from clt.metrics.doubts import missing_data_warnings

TEAM = Team((Robot("R1", 1), Robot("R2", 2), Robot("R3", 3)))


def track(frame, count):
    stamp = np.arange(count)
    zero = np.zeros(count)
    return Poses(frame, stamp, stamp, zero, zero, zero)


def said(count, frame="R1/base_link", names=("R2",)):
    """Kinds and severities where R2 has so many relative truth poses of 20."""
    truth = {"R1": track("world", 20), "R2": track("world", 30)}
    estimates = {name: track(frame, 5) for name in names}
    found = missing_data_warnings(TEAM, truth, estimates, {"R2": track("world", count)})
    return [(one.kind, one.severity, one.subject) for one in found]


@pytest.mark.parametrize(
    ("count", "severity"), [(0, "partial"), (1, "warning"), (17, "warning"), (18, None), (20, None)]
)
def test_relative_truth_that_is_short_is_partial_only_where_none_is_left(count, severity):
    expected = [] if severity is None else [("short_relative_truth", severity, "R2")]
    assert said(count) == expected


def test_a_truth_without_any_target_counts_as_none():
    truth = {"R1": track("world", 20), "R2": track("world", 30)}
    (one,) = missing_data_warnings(TEAM, truth, {"R2": track("R1/base_link", 5)}, {})
    assert (one.severity, one.values["count"], one.values["total"]) == ("partial", 0, 20)


def test_robots_with_truth_but_no_estimate_are_named():
    truth = {name: track("world", 9) for name in ("R1", "R2", "R3")}
    found = missing_data_warnings(TEAM, truth, {"R2": track("world", 5)}, truth)
    assert [one.subject for one in found] == ["R1", "R3"]
    assert {one.kind for one in found} == {"no_estimate"}
    relative = missing_data_warnings(TEAM, truth, {"R2": track("R1/base_link", 5)}, truth)
    assert [one.subject for one in relative] == ["R3"]
    both = {"R1": track("R2/base_link", 5), "R2": track("R1/base_link", 5)}
    assert missing_data_warnings(TEAM, truth, both, truth) == []


def test_truth_in_several_frames_is_said():
    truth = {"R1": track("world", 9), "R2": track("map", 9), "R3": track("world", 9)}
    estimates = {name: track("world", 5) for name in truth}
    (one,) = missing_data_warnings(TEAM, truth, estimates, truth)
    assert (one.kind, one.values["frames"]) == ("several_truth_frames", "world, map")
