"""The latest stretch of a run, cut and resumed without a trace."""

from __future__ import annotations

import numpy as np
import pytest

from clt.filters.kalman.gaussian import solve_eskf_without_search
from clt.filters.kalman.trail import (
    cut_problem,
    history_before,
    history_since,
    make_history_part,
    resume_problem,
    without_outputs,
)
from clt.initialization.given.truth import from_truth
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from tests.filters.teams import team_recording

SETTINGS = FilterSettings()
SECOND = 1_000_000_000


@pytest.fixture(scope="module")
def whole():
    """Two robots for 4 s."""
    recording = team_recording(moving=2, seconds=4.0)
    return build_problem(recording, from_truth(recording, (0.1, 0.1, 0.1)), SETTINGS)


def solved(problem):
    return solve_eskf_without_search(problem, SETTINGS)


def test_a_part_holds_what_is_from_its_start_until_before_its_end(whole):
    begin = whole.start + SECOND
    end = int(whole.ranges.stamp[np.searchsorted(whole.ranges.stamp, whole.start + 2 * SECOND)])
    part = cut_problem(whole, begin, end)
    assert (part.start, part.end) == (begin, end)
    inside = (whole.ranges.stamp >= begin) & (whole.ranges.stamp < end)
    np.testing.assert_array_equal(part.ranges.range, whole.ranges.range[inside])
    wanted = (whole.outputs.stamp >= begin) & (whole.outputs.stamp < end)
    np.testing.assert_array_equal(part.outputs.stamp, whole.outputs.stamp[wanted])
    assert part.segments.end.min() > begin
    assert cut_problem(whole, begin).end == whole.end
    assert cut_problem(whole, begin).ranges.stamp[-1] == whole.ranges.stamp[-1]
    none = without_outputs(part)
    assert none.outputs.stamp.size == none.outputs.robot.size == 0
    assert none.ranges.range.size == part.ranges.range.size


def test_a_run_goes_on_from_a_cut_as_if_it_had_never_stopped(whole):
    middle = whole.start + 2 * SECOND + SECOND // 3
    full, first = solved(whole), solved(cut_problem(whole, whole.start, middle))
    second = solved(resume_problem(cut_problem(whole, middle), first))
    np.testing.assert_allclose(second.belief.mean, full.belief.mean, atol=1e-6)
    np.testing.assert_allclose(second.belief.covariance, full.belief.covariance, atol=1e-6)
    joined = np.concatenate([first.residual, second.residual])
    np.testing.assert_allclose(joined, full.residual, atol=1e-6)


def test_a_history_begins_at_a_time_with_what_was_believed_then(whole):
    trail = (make_history_part(whole, solved(whole)),)
    since = whole.start + SECOND
    (later,) = history_since(trail, since, SETTINGS, lambda problem, _: solved(problem))
    assert later.problem.start == since
    assert later.problem.prior is None
    n = later.problem.ranges.stamp.size
    np.testing.assert_array_equal(later.residual, trail[0].residual[-n:])
    np.testing.assert_array_equal(later.variance, trail[0].variance[-n:])
    np.testing.assert_allclose(solved(later.problem).residual, later.residual, atol=1e-6)
    (kept,) = history_since(trail, whole.start - SECOND, SETTINGS, None)
    assert kept is trail[0]


def test_a_history_leaves_out_what_ended_before(whole):
    cut = whole.start + 2 * SECOND
    first = cut_problem(whole, whole.start, cut)
    second = resume_problem(cut_problem(whole, cut), solved(first))
    trail = (
        make_history_part(first, solved(first)),
        make_history_part(second, solved(second)),
    )
    assert history_since(trail, cut, SETTINGS, None) == trail[1:]
    end = cut + SECOND
    before = history_before(trail, end)
    assert [part.problem.end for part in before] == [cut, end]
    assert all(part.problem.outputs.stamp.size == 0 for part in before)
    assert before[1].residual.size == before[1].problem.ranges.stamp.size
    assert before[1].problem.ranges.stamp.max() < end
    np.testing.assert_array_equal(before[1].residual, trail[1].residual[: before[1].residual.size])
