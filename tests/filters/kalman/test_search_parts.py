"""The search for lost robots, part by part: suspicion, evidence, rivals, trail, what is joined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clt.filters.kalman import reacquisition
from clt.filters.kalman.evidence import (
    BLOCKED_SHARE,
    EXCESS_VARIANCE_RATE,
    ISOLATED_OUTLIER_SHARE,
    MEAN_BLOCKED_S,
    MEDIAN_OUTLIER_M,
    PairBlockage,
    fill_log_densities,
    range_log_densities,
)
from clt.filters.kalman.reacquisition import (
    ReplayedBelief,
    add_heading_uncertainty,
    best_headings,
    combine_beliefs,
    join_solutions,
    run_log_densities,
    truncate_solution,
)
from clt.filters.kalman.rivals import (
    HEADINGS_TRIED,
    LOST_HEADING_SIGMA,
    LOST_POSITION_SIGMA_M,
    LostRobotLinks,
    alternative_beliefs,
    antenna_offsets,
    candidate_positions,
    fit_positions,
    link_range_errors,
    links_to_known,
    lost_robot_links,
    mirror_position,
    widen_blocks,
)
from clt.filters.kalman.suspicion import (
    NO_PARTNER,
    SEVERAL_PARTNERS,
    count_verdict,
    find_next_lost,
    new_verdict_record,
    reset_verdict_record,
    robots_that_look_lost,
)
from clt.model.belief import Belief
from clt.model.range_table import RangeTable
from clt.model.solution import Solution

pytestmark = pytest.mark.usefixtures("interpreted")
SECOND = 1_000_000_000


def table(rows, sigma=0.1):
    """Ranges (seconds, a, b, fixed x, fixed y, metres)."""
    t, a, b, x, y, d = np.array(rows, float).reshape(-1, 6).T
    n = t.size
    stamp = np.rint(t * SECOND).astype(np.int64)
    variance = np.full(n, sigma**2)
    ends = a.astype(np.int64), b.astype(np.int64)
    _, pair = np.unique(np.sort(np.stack(ends), axis=0), axis=1, return_inverse=True)
    return RangeTable(
        np.arange(n), stamp, *ends, np.column_stack([x, y]), d, variance, variance.copy(),
        pair.ravel().astype(np.int64),
    )  # fmt: skip


def test_verdicts_are_counted_and_who_disagreed_is_kept():
    record = new_verdict_record(2, 7)
    assert record.tolist() == [[7, 0, 0, NO_PARTNER, 0, 0]] * 2
    count_verdict(record, -1, 0, False)
    count_verdict(record, 0, 1, True)
    count_verdict(record, 0, -3, False)
    assert record[0].tolist() == [7, 1, 1, -3, 0, 0]
    count_verdict(record, 0, -3, False)
    assert record[0].tolist() == [7, 1, 2, -3, 0, 0]
    count_verdict(record, 0, 1, False)
    count_verdict(record, 0, -3, False)
    assert record[0].tolist() == [7, 1, 4, SEVERAL_PARTNERS, 0, 0]
    assert record[1].tolist() == [7, 0, 0, NO_PARTNER, 0, 0]


@pytest.mark.parametrize(
    ("accepted", "rejected", "partner", "lost"),
    [
        (6, 4, SEVERAL_PARTNERS, False),
        (5, 4, SEVERAL_PARTNERS, True),
        (0, 9, 2, False),
        (0, 0, NO_PARTNER, False),
    ],
)
def test_a_robot_looks_lost_where_several_contradict_it(accepted, rejected, partner, lost):
    record = np.array([[0, accepted, rejected, partner, 3, 1]])
    assert robots_that_look_lost(record).tolist() == [lost]
    reset_verdict_record(record, np.array([True]), 11)
    assert record.tolist() == [[11, 0, 0, NO_PARTNER, 3, 1]]


def test_robots_are_judged_when_a_range_comes_after_they_are_due():
    """Three ranges a second of robot 0 with two partners, all rejected; due after 2 s."""
    stamp = np.repeat(np.arange(1, 6), 2) * SECOND
    a, b = np.zeros(10, np.int64), np.tile([1, -1], 5)
    none = np.zeros(10, np.int64)
    record = new_verdict_record(2, 2 * SECOND)
    m = find_next_lost(record, a, b, stamp, none, 0, SECOND)
    assert m == 4
    assert record[0].tolist() == [2 * SECOND, 0, 4, SEVERAL_PARTNERS, 0, 0]
    # Robot 1 has one partner only: it is judged and begins again.
    assert record[1].tolist() == [4 * SECOND, 0, 0, NO_PARTNER, 0, 0]
    reset_verdict_record(record, np.array([True, False]), 9 * SECOND)
    assert find_next_lost(record, a, b, stamp, none, m, SECOND) == 10
    assert record[0, 2] == 6
    fine = new_verdict_record(2, 2 * SECOND)
    assert find_next_lost(fine, a, b, stamp, np.ones(10, np.int64), 0, SECOND) == 10
    assert fine[0].tolist() == [6 * SECOND, 0, 0, NO_PARTNER, 0, 0] or fine[0, 1] > 0


def normal(r, S):
    return np.exp(-0.5 * r * r / S) / np.sqrt(2.0 * np.pi * S)


def test_the_density_of_a_residual_by_hand():
    """A pair blocked with probability 0.3, 2 s ago, by an excess of 1 m."""
    r, S, dt, before = 1.2, 0.04, 2.0, 0.3
    known = PairBlockage(np.array([SECOND]), np.array([before]), np.array([1.0]), np.array([0.09]))
    out = np.empty(1)
    fill_log_densities(
        np.array([0]), np.array([3 * SECOND]), np.array([r]), np.array([S]), known, out
    )
    change = 1.0 - np.exp(-dt / (MEAN_BLOCKED_S * (1.0 - BLOCKED_SHARE)))
    stays = before * (1.0 - (1.0 - BLOCKED_SHARE) * change)
    comes = (1.0 - before) * BLOCKED_SHARE * change
    cauchy = MEDIAN_OUTLIER_M / (np.pi * (MEDIAN_OUTLIER_M**2 + r * r))
    v = 0.09 + EXCESS_VARIANCE_RATE * dt
    clear = (1.0 - stays - comes) * (
        (1.0 - ISOLATED_OUTLIER_SHARE) * normal(r, S) + ISOLATED_OUTLIER_SHARE * cauchy
    )
    still = stays * normal(r - 1.0, S + v)
    total = clear + comes * cauchy + still
    assert out[0] == pytest.approx(np.log(total))
    assert known.blocked[0] == pytest.approx((comes * cauchy + still) / total)
    gain = v / (S + v)
    assert known.excess[0] == pytest.approx(1.0 + gain * 0.2)
    assert known.variance[0] == pytest.approx(S * gain)
    assert known.stamp[0] == 3 * SECOND


def test_a_new_blockage_takes_its_residual_as_excess():
    known = PairBlockage(
        np.array([0]), np.array([BLOCKED_SHARE]), np.array([-5.0]), np.array([0.01])
    )
    out = np.empty(1)
    fill_log_densities(
        np.array([0]), np.array([SECOND]), np.array([4.0]), np.array([0.01]), known, out
    )
    assert (known.excess[0], known.variance[0]) == (4.0, 0.01)
    assert known.blocked[0] > 0.3


def test_ranges_count_by_what_they_are_worth_and_pairs_apart():
    rows = [(1, 0, 1, 0, 0, 3.0), (2, 1, 0, 0, 0, 3.0), (2, 0, -1, 0, 0, 3.0), (3, 0, 1, 0, 0, 3.0)]
    ranges = table(rows)
    residual, variance = np.array([4.0, 4.0, 0.0, 4.0]), np.full(4, 0.01)
    found = range_log_densities(ranges, residual, variance)
    # Both directions are one pair: what blocks it costs less and less.
    assert found[0] < found[1] - 1.0
    half = ranges._replace(weight_variance=2.0 * ranges.variance)
    np.testing.assert_allclose(range_log_densities(half, residual, variance), 0.5 * found)
    apart = [(1, 0, 1, 0, 0, 3.0), (2, 0, 2, 0, 0, 3.0)]
    other = range_log_densities(table(apart), residual[:2], variance[:2])
    assert other[1] < found[1] - 0.3


ANCHORS = np.array([[0.0, 0.0], [8.0, 0.0], [0.0, 6.0]])


def links_of(place, anchors=ANCHORS, block=0):
    n = len(anchors)
    ends = np.column_stack([np.full(n, block), -1 - np.arange(n)])
    return LostRobotLinks(ends, anchors, np.hypot(*(place - anchors).T))


def test_only_the_first_range_of_each_pair_of_a_lost_block_is_a_link():
    rows = [(1, 0, 1, 0, 0, 1.0), (2, 1, 0, 0, 0, 2.0), (3, 0, -1, 5, 6, 3.0)]
    rows += [(4, 1, -1, 5, 6, 4.0), (5, 0, 2, 0, 0, 5.0), (6, 0, -1, 5, 6, 6.0)]
    found = lost_robot_links(table(rows), np.array([0]))
    assert found.ends.tolist() == [[0, 1], [0, -1], [0, 2]]
    assert found.range.tolist() == [1.0, 3.0, 5.0]
    assert found.fixed[1].tolist() == [5.0, 6.0]
    known = links_to_known(found, 0, np.array([0, 1]))
    assert known.range.tolist() == [3.0, 5.0]
    few = links_to_known(found, 0, np.array([0, 1, 2]))
    assert few.range.tolist() == [1.0, 3.0, 5.0]


def test_positions_are_where_ranges_put_them():
    truth, at = np.array([3.0, 2.0]), np.array([[6.0, 5.0]])
    links, begin = links_of(truth), np.array([3.5, 2.5])
    found = fit_positions(at, links, np.array([0]), begin)
    assert found.places[0] == pytest.approx(truth, abs=0.1)
    assert found.error < 0.1
    wild = links._replace(range=links.range + np.array([0.0, 0.0, 5.0]))
    four = LostRobotLinks(
        np.vstack([wild.ends, [[0, -4]]]), np.vstack([ANCHORS, [[8.0, 6.0]]]),
        np.append(wild.range, np.hypot(5.0, 4.0)),
    )  # fmt: skip
    found = fit_positions(at, four, np.array([0]), begin)
    assert found.places[0] == pytest.approx(truth, abs=0.3)
    assert link_range_errors(truth[None], links) == pytest.approx(np.zeros(3), abs=1e-12)
    assert link_range_errors(truth[None], wild)[2] == pytest.approx(-5.0)


def test_a_position_is_mirrored_in_the_line_of_its_partners():
    links = links_of(np.array([3.0, 2.0]), ANCHORS[:2])
    found = mirror_position(np.array([[3.0, 2.0]]), links, 0)
    assert found == pytest.approx([3.0, -2.0])
    swapped = links._replace(ends=links.ends[:, ::-1].copy())
    assert mirror_position(np.array([[3.0, 2.0]]), swapped, 0) == pytest.approx([3.0, -2.0])


def test_two_partners_leave_two_positions_and_three_one():
    mean, lever = np.array([6.0, 5.0, 0.0]), np.zeros((1, 2))
    truth = np.array([3.0, 2.0])
    both = candidate_positions(mean, lever, links_of(truth, ANCHORS[:2]), np.array([0]))
    places = sorted(place[0].round(1).tolist() for place, _ in both)
    assert len(places) == 2
    np.testing.assert_allclose(places, [[3.0, -2.0], [3.0, 2.0]], atol=0.2)
    single = candidate_positions(mean, lever, links_of(truth), np.array([0]))
    assert single[0][0][0] == pytest.approx(truth, abs=0.1)
    errors = [error for _, error in single]
    assert errors[0] == min(errors)


def test_antennas_turn_with_their_robots():
    mean = np.array([1.0, 2.0, np.pi / 2, 3.0, 4.0, 0.0, 9.0])
    found = antenna_offsets(mean, np.array([[0.5, 0.1], [0.5, 0.1]]))
    np.testing.assert_allclose(found, [[-0.1, 0.5], [0.5, 0.1]], atol=1e-12)


def test_lost_blocks_are_known_to_so_much_only():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(7, 7))
    P = root @ root.T
    found = widen_blocks(P, np.array([1]), (0.5, 0.2))
    np.testing.assert_array_equal(found[3:6, 3:6], np.diag([0.25, 0.25, 0.2**2]))
    assert not found[3:6, [0, 1, 2, 6]].any()
    assert not found[[0, 1, 2, 6], 3:6].any()
    rest = [0, 1, 2, 6]
    np.testing.assert_array_equal(found[np.ix_(rest, rest)], P[np.ix_(rest, rest)])


def test_rivals_stand_at_the_candidates_with_all_headings():
    mean = np.array([[6.0, 5.0, 0.4, 1.0, 1.0, 0.0]])
    belief = Belief(np.zeros(1), mean, 0.01 * np.eye(6)[None])
    lever = np.array([[0.3, 0.0], [0.0, 0.0]])
    rows = [
        (1, 0, -1 - k, *p, np.hypot(*(np.array([3.0, 2.0]) - p))) for k, p in enumerate(ANCHORS)
    ]
    sets = alternative_beliefs(belief, lever, table(rows), np.array([0]))
    first = sets[0]
    assert len(first) == HEADINGS_TRIED
    turns = np.array([one.mean[0, 2] - 0.4 for one in first]) / (2.0 * np.pi / HEADINGS_TRIED)
    assert np.rint(turns).tolist() == [0, -1, 1, -2, 2, -3, 3, -4]
    for one in first:
        x, y, heading = one.mean[0, :3]
        antenna = [x + 0.3 * np.cos(heading), y + 0.3 * np.sin(heading)]
        assert antenna == pytest.approx([3.0, 2.0], abs=0.1)
        assert one.mean[0, 3:].tolist() == [1.0, 1.0, 0.0]
        assert np.sqrt(one.covariance[0, 0, 0]) >= LOST_POSITION_SIGMA_M
        assert one.covariance[0, 2, 2] == pytest.approx(LOST_HEADING_SIGMA**2)
    assert mean[0, 2] == 0.4


def solution(n, value=0.0, outputs=2):
    belief = Belief(np.zeros(1), np.full((1, 6), value), np.tile(0.01 * np.eye(6), (1, 1, 1)))
    return Solution(
        np.full((outputs, 3), value), np.tile(np.eye(3), (outputs, 1, 1)), np.full(n, value),
        np.full(n, 0.04), np.ones(n, np.int64), np.zeros(2, np.int64), belief,
    )  # fmt: skip


def test_solutions_are_cut_and_joined():
    first, second = solution(4, 1.0), solution(3, 2.0)
    cut = truncate_solution(first, 2, 1)
    assert (len(cut.mean), len(cut.covariance)) == (1, 1)
    assert (cut.residual.size, cut.variance.size, cut.verdict.size) == (2, 2, 2)
    whole = join_solutions([cut, second])
    assert whole.residual.tolist() == [1.0, 1.0, 2.0, 2.0, 2.0]
    assert whole.mean[:, 0].tolist() == [1.0, 2.0, 2.0]
    assert whole.verdict.size == whole.variance.size == 5
    assert whole.belief is second.belief
    assert join_solutions([first]) is first


def rival(headings, evidence, ends=None):
    mean = np.array([[1.0, 2.0, headings[0], 3.0, 4.0, headings[1]]])
    began = Belief(np.zeros(1), mean, np.diag(np.arange(1.0, 7.0) * (1 + headings[0]))[None])
    ends = headings if ends is None else ends
    last = np.array([[0.0, 0.0, ends[0], 0.0, 0.0, ends[1]]])
    at_end = replace(solution(2), belief=Belief(np.zeros(1), last, np.zeros((1, 6, 6))))
    return ReplayedBelief(began, at_end, np.array(evidence, float))


def test_a_beginning_takes_each_lost_block_from_its_own():
    a, b = rival((0.1, 0.2), [0, 0]).began, rival((0.5, 0.6), [0, 0]).began
    found = combine_beliefs([a, b], np.array([0, 1]))
    assert found.mean[0, [2, 5]].tolist() == [0.1, 0.6]
    np.testing.assert_array_equal(found.covariance[0, 3:, 3:], b.covariance[0, 3:, 3:])
    np.testing.assert_array_equal(found.covariance[0, :3, :3], a.covariance[0, :3, :3])
    assert a.mean[0, 5] == 0.2


def test_headings_that_fit_as_well_widen_the_heading():
    """Of robot 1 both rivals say as much; of robot 0 the first says more by log 3."""
    rivals = [rival((0.0, 0.0), [0, 0], (3.0, 0.2)), rival((1.0, 1.0), [0, 0], (-3.0, 0.6))]
    scores = np.array([[0.0, -5.0], [-np.log(3.0), -5.0]])
    found = add_heading_uncertainty(rivals[0].solution, rivals, scores, np.array([0, 1]))
    P = found.belief.covariance[0]
    off = 2.0 * np.pi - 6.0
    assert P[2, 2] == pytest.approx(0.25 * off**2)
    assert P[5, 5] == pytest.approx(0.5 * 0.4**2)
    assert np.count_nonzero(P) == 2
    nothing = np.full((2, 2), -np.inf)
    found = add_heading_uncertainty(rivals[0].solution, rivals, nothing, np.array([0, 1]))
    assert found.belief.covariance[0, 2, 2] == pytest.approx(0.5 * off**2)


def test_each_lost_block_may_have_the_heading_of_another_rival(monkeypatch):
    ranges = table([(1, 0, -1, 0, 0, 1.0), (1, 1, -1, 0, 0, 1.0)])
    rivals = [rival((0.0, 0.0), [5.0, 0.0]), rival((1.0, 1.0), [0.0, 4.0])]
    began = []

    def replay(_, mixed, *__):
        began.append(mixed)
        return rival((0.0, 1.0), [5.0, 4.0])

    monkeypatch.setattr(reacquisition, "replay_belief", replay)
    found = best_headings(rivals, (), ranges, np.array([0, 1]), None, None)
    assert began[0].mean[0, [2, 5]].tolist() == [0.0, 1.0]
    assert found.evidence.sum() == 9.0
    began.clear()
    same = [rival((0.0, 0.0), [5.0, 3.0]), rival((1.0, 1.0), [0.0, 1.0])]
    assert best_headings(same, (), ranges, np.array([0, 1]), None, None).evidence.sum() == 8.0
    assert began == []


def test_densities_that_are_no_numbers_count_against_a_run():
    ranges = table([(1, 0, -1, 0, 0, 1.0), (2, 0, -1, 0, 0, 1.0)])
    good, bad = solution(1), solution(1, np.nan)
    found = run_log_densities(ranges, [good, bad])
    assert np.isfinite(found[0])
    assert found[1] == -np.inf
