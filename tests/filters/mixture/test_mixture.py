"""The Gaussian mixture: splits that change nothing, evidence that decides."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from clt.core.geometry import relative_pose, wrap_angle
from clt.core.start import Hypothesis, InitialPose, Start
from clt.estimation.estimators import Estimator, localize_recording
from clt.filters.kalman.gaussian import solve_ekf
from clt.filters.mixture.gaussian_sum import (
    fuse_range,
    make_gaussian_sum,
    make_mixture_output,
)
from clt.filters.mixture.mixture import solve_mixture
from clt.filters.mixture.reduction import (
    make_merge_workspace,
    merge_similar,
    prune_light,
    reduce_mixture,
)
from clt.filters.mixture.splitting import heading_grid, split_gaussian, split_prior_headings
from clt.initialization.given.truth import from_truth
from clt.model.belief import Belief
from clt.model.choices import FrameSpec
from clt.model.mixture_moments import ROWS, leading_mode_probability
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from tests.filters.teams import standing_pair, team_recording
from tests.messages import failings, remarks

SETTINGS = FilterSettings()
EGO = FrameSpec("ego", ("R1",))


def pair_start(recording, sigma, shift=(0.0, 0.0, 0.0)):
    """R2 as seen from R1, believed to `sigma`, its mean off by `shift`."""
    start = from_truth(recording, (0.0, 0.0, 0.0))
    seen = relative_pose(start.poses["R1"].mean, start.poses["R2"].mean) + np.array(shift)
    poses = {
        "R1": InitialPose(np.zeros(3), np.zeros((3, 3))),
        "R2": InitialPose(seen, np.diag(np.square(sigma))),
    }
    return Start(start.stamp, poses, "R1/base_link")


def pair_problem(recording, sigma, shift=(0.0, 0.0, 0.0), view=EGO):
    return build_problem(recording, pair_start(recording, sigma, shift), SETTINGS, view)


def relative_error(recording, problem, solution):
    """Of R2's pose in R1's frame at each output, (n, 3)."""
    own = problem.outputs.robot == 0
    truth = [recording.truth[name] for name in ("R1", "R2")]
    at = [np.column_stack([t.x, t.y, t.heading])[np.isin(t.stamp, problem.outputs.stamp[own])]
          for t in truth]  # fmt: skip
    e = solution.mean[own] - relative_pose(at[0], at[1])
    e[:, 2] = wrap_angle(e[:, 2])
    return e


def gaussians_of(mean, covariance, room=50):
    """A Gaussian sum with one Gaussian over one block."""
    problem = pair_problem(team_recording(moving=2, seconds=1.0), (0.1, 0.1, 0.1))
    return make_gaussian_sum(
        Belief(np.zeros(1), mean[None], covariance[None]), problem, room, hold=False
    )


def total(gaussians):
    """Mean and covariance of all of a Gaussian sum."""
    n = gaussians.alive[0]
    w, x = np.exp(gaussians.log_weight[:n]), gaussians.mean[:n]
    d = x - w @ x
    P = np.einsum("k,kij->ij", w, gaussians.covariance[:n]) + np.einsum("k,ki,kj->ij", w, d, d)
    return w @ x, P


def wide():
    """A Gaussian over (x, y, theta) with correlations."""
    A = np.array([[0.8, 0.1, 0.0], [0.3, 0.5, 0.2], [-0.1, 0.2, 0.6]])
    return np.array([1.0, -2.0, 0.3]), A @ A.T


@pytest.mark.parametrize("width", [0.3, 0.5, 0.8])
def test_a_split_leaves_mean_and_covariance(width):
    mean, P = wide()
    gaussians = gaussians_of(mean, P)
    gaussians.J[0], gaussians.H[0] = [0, 1, 2, 0, 0, 0], [0.6, -0.2, 1.0, 0, 0, 0]
    assert split_gaussian(gaussians, 0, 0, width)
    assert gaussians.alive[0] >= 3
    after, spread = total(gaussians)
    np.testing.assert_allclose(after, mean, atol=1e-12)
    np.testing.assert_allclose(spread, P, atol=1e-12)
    h = gaussians.H[0, :3]
    each = np.einsum("i,kij,j->k", h, gaussians.covariance[: gaussians.alive[0]], h) / (h @ P @ h)
    assert np.sqrt(each).max() < 1.15 * min(width, 0.75)
    assert np.linalg.eigvalsh(gaussians.covariance[: gaussians.alive[0]]).min() > 0.0


@pytest.mark.parametrize("width", [0.3, 0.5, 0.8])
def test_a_split_leaves_the_density(width):
    gaussians = gaussians_of(np.zeros(3), np.eye(3))
    gaussians.J[0], gaussians.H[0] = 0, [1, 0, 0, 0, 0, 0]
    assert split_gaussian(gaussians, 0, 0, width)
    n = gaussians.alive[0]
    at = np.linspace(-6, 6, 2001)
    normal = lambda x, m, s: np.exp(-0.5 * ((x - m) / s) ** 2) / (s * np.sqrt(2 * np.pi))  # noqa: E731
    w, m, s = (
        np.exp(gaussians.log_weight[:n]),
        gaussians.mean[:n, 0],
        np.sqrt(gaussians.covariance[:n, 0, 0]),
    )
    mixed = (w * normal(at[:, None], m, s)).sum(axis=1)
    assert np.abs(mixed - normal(at, 0.0, 1.0)).sum() * (at[1] - at[0]) < 0.03


def test_a_split_without_room_changes_nothing():
    mean, P = wide()
    gaussians = gaussians_of(mean, P, room=2)
    gaussians.J[0], gaussians.H[0] = 0, [1, 0, 0, 0, 0, 0]
    assert not split_gaussian(gaussians, 0, 0, 0.3)
    assert gaussians.alive[0] == 1
    np.testing.assert_array_equal(gaussians.covariance[0], P)


@pytest.mark.parametrize("sigma", [0.3, 0.8, 1.5, 2.0, 50.0])
def test_headings_are_split_on_the_circle(sigma):
    place, weight, left = heading_grid(sigma, 0.2)
    assert np.sqrt(left) < 0.25
    assert abs(weight.sum() - 1.0) < 1e-12
    assert np.ptp(place) < 2 * np.pi * (1 if sigma > 1.0 else 2)
    at = np.linspace(-np.pi, np.pi, 721)[:-1]
    turns = 2 * np.pi * np.arange(-40, 41)
    fold = lambda d, s: np.exp(-0.5 * ((d[..., None] + turns) / s) ** 2).sum(axis=-1)  # noqa: E731
    mixed = (weight * fold(at[:, None] - place, np.sqrt(left))).sum(axis=1)
    wanted = fold(at, sigma)
    assert np.abs(mixed / mixed.sum() - wanted / wanted.sum()).sum() < 0.03


def test_mutual_blocks_of_a_wide_prior_stay_inverses():
    recording = team_recording(seed=1, moving=2, seconds=1.0)
    prior = pair_problem(recording, (0.3, 0.3, 2.0), view=FrameSpec("mutual", ("R1", "R2"))).prior
    belief = split_prior_headings(prior, 0.2)
    assert belief.mean.shape[0] > 10
    for x in belief.mean:
        there_and_back = relative_pose(relative_pose(x[:3], np.zeros(3)), x[3:])
        np.testing.assert_allclose(there_and_back[:2], 0.0, atol=1e-12)
        np.testing.assert_allclose(wrap_angle(there_and_back[2]), 0.0, atol=1e-12)


def test_what_came_together_merges_and_what_did_not_stays():
    mean, P = wide()
    gaussians = gaussians_of(mean, P)
    far = np.array([5.0, 0.0, 0.0])
    for k, (x, w) in enumerate([(mean, 0.4), (mean + far, 0.3), (mean + 0.1, 0.3)]):
        gaussians.mean[k], gaussians.covariance[k], gaussians.log_weight[k] = x, P, np.log(w)
    gaussians.alive[0] = 3
    before = total(gaussians)
    merge_similar(gaussians, 1, make_merge_workspace(gaussians))
    prune_light(gaussians, 1e-9)
    assert gaussians.alive[0] == 2
    np.testing.assert_allclose(np.sort(np.exp(gaussians.log_weight[:2])), [0.3, 0.7])
    for ours, theirs in zip(total(gaussians), before, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_headings_a_turn_apart_merge():
    mean, P = wide()
    gaussians = gaussians_of(mean, P)
    gaussians.mean[1], gaussians.covariance[1] = mean + np.array([0.0, 0.0, 2 * np.pi]), P
    gaussians.log_weight[:2], gaussians.alive[0] = np.log(0.5), 2
    reduce_mixture(gaussians, 1, 50, make_merge_workspace(gaussians))
    assert gaussians.alive[0] == 1
    np.testing.assert_allclose(gaussians.covariance[0], P, atol=1e-12)


def test_no_more_than_the_budget_are_kept():
    gaussians = gaussians_of(np.zeros(3), 1e-4 * np.eye(3))
    for k in range(40):
        gaussians.mean[k], gaussians.covariance[k] = k, 1e-4 * np.eye(3)
        gaussians.log_weight[k] = np.log((k + 1) / 820)
    gaussians.alive[0] = 40
    reduce_mixture(gaussians, 1, 10, make_merge_workspace(gaussians))
    assert gaussians.alive[0] == 10
    np.testing.assert_array_equal(gaussians.mean[:10, 0], np.arange(30, 40))
    assert gaussians.dropped[0] == pytest.approx(np.arange(1, 31).sum() / 820)
    assert abs(np.exp(gaussians.log_weight[:10]).sum() - 1.0) < 1e-12


def test_what_there_is_no_room_for_is_absorbed_by_its_neighbours():
    """A long chain of parts with room for a few: nothing is lost, the moments stay."""
    gaussians, parts = gaussians_of(np.zeros(3), 0.01 * np.eye(3)), 40
    weight = np.exp(-0.5 * np.linspace(-2.0, 2.0, parts) ** 2)
    gaussians.mean[:parts, 0] = 0.15 * np.arange(parts)
    gaussians.covariance[:parts] = 0.01 * np.eye(3)
    gaussians.log_weight[:parts], gaussians.alive[0] = np.log(weight / weight.sum()), parts
    before = total(gaussians)
    reduce_mixture(gaussians, 1, 6, make_merge_workspace(gaussians))
    assert gaussians.alive[0] <= 6
    assert gaussians.dropped[0] == 0.0
    for ours, theirs in zip(total(gaussians), before, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize("apart", [0.1, 3.0])
def test_a_bent_mode_is_one_and_two_places_are_two(apart):
    """Narrow parts along half a circle, and as many about another place `apart`, m."""
    angle = np.linspace(0.0, np.pi, 60)
    x = np.zeros((61, 3))
    x[:60, 0], x[:60, 1] = np.cos(angle), np.sin(angle)
    x[60] = -1.0 - apart, 0.0, 0.0
    P = np.broadcast_to(0.002 * np.eye(3), (61, 3, 3)).copy()
    log_weight = np.log(np.append(np.full(60, 0.9 / 60), 0.1))
    share = leading_mode_probability(log_weight, x, P, 61, 0, 0, np.zeros((ROWS, 3)))
    assert share == pytest.approx(1.0 if apart < 1.0 else 0.9)


@pytest.mark.parametrize("view", [EGO, FrameSpec("mutual", ("R1", "R2")), FrameSpec("world")])
def test_is_the_ekf_where_the_prior_is_narrow(view):
    recording = team_recording(seed=2, moving=2, seconds=10.0)
    start = from_truth(recording, (0.01, 0.01, 0.01))
    problem = build_problem(recording, start, SETTINGS, view)
    ours, theirs = solve_mixture(problem, SETTINGS), solve_ekf(problem, SETTINGS)
    sigma = np.sqrt(np.einsum("oii->oi", theirs.covariance))
    difference = ours.mean - theirs.mean
    difference[:, 2] = wrap_angle(difference[:, 2])
    assert np.abs(difference / sigma).max() < 0.3
    np.testing.assert_allclose(ours.covariance, theirs.covariance, atol=0.1 * sigma.max() ** 2)


def mirrored(recording):
    """R2 as it is and in the mirror of R1's heading, both equally probable."""
    start = pair_start(recording, (0.05, 0.05, 0.05))
    true = start.poses["R2"]
    image = InitialPose(true.mean * np.array([1.0, -1.0, -1.0]), true.covariance)
    both = (Hypothesis(0.5, {"R2": image}), Hypothesis(0.5, {"R2": true}))
    return replace(start, hypotheses=both)


def test_evidence_separates_the_truth_from_its_mirror_image():
    recording = team_recording(seed=1, moving=2, seconds=30.0)
    problem = build_problem(recording, mirrored(recording), SETTINGS, EGO)
    solution = solve_mixture(problem, SETTINGS)
    assert solution.share[0] == pytest.approx(0.5, abs=0.01)
    assert solution.share[-1] > 0.999
    error = relative_error(recording, problem, solution)
    assert np.hypot(*error[0, :2]) > 1.0
    assert np.hypot(*error[-50:, :2].T).max() < 0.6
    single = solve_ekf(problem, SETTINGS)
    assert np.hypot(*relative_error(recording, problem, single)[-50:, :2].T).min() > 1.0


NARRATOR = Estimator("mixture", EGO)


def localized(recording, start):
    return localize_recording(recording, start, SETTINGS, NARRATOR)


def test_says_when_the_answer_became_unique_and_that_it_is_not():
    recording = team_recording(seed=1, moving=2, seconds=30.0)
    (line,) = remarks(localized(recording, mirrored(recording)))
    assert line.startswith("the pose of R2 was unique after ")
    short = team_recording(seed=1, moving=2, seconds=1.0)
    found = localized(short, mirrored(short))
    assert remarks(found) == ()
    assert any(line.startswith("R2 is ambiguous: ") for line in failings(found))


def test_says_what_it_had_no_room_for():
    """Of a pose and its mirror image one has to go."""
    recording = team_recording(seed=1, moving=2, seconds=5.0)
    start = mirrored(recording)
    problem = build_problem(recording, start, SETTINGS, EGO)
    assert solve_mixture(problem, SETTINGS).dropped < 1e-3
    crowded = FilterSettings(mixture={"components": 1})
    few = solve_mixture(problem, crowded)
    assert 0.05 < few.dropped < 1.0
    found = localize_recording(recording, start, crowded, NARRATOR)
    assert any(f"probability {few.dropped:.2f} were dropped" in line for line in failings(found))
    early, late = cut(problem, 2_000_000_000)
    first = solve_mixture(early, crowded)
    kept = {"prior": None, "belief": first.belief, "memory": first.memory}
    assert solve_mixture(replace(late, **kept), crowded).dropped >= first.dropped > 0.05


def test_calls_no_pose_unique_that_the_ranges_contradict():
    recording = team_recording(seed=1, moving=2, seconds=10.0)
    start = mirrored(recording)
    right = start.poses["R2"]
    wrong = tuple(
        Hypothesis(share, {"R2": replace(right, mean=right.mean + np.array([off, 0.0, 0.0]))})
        for off, share in ((8.0, 0.9), (20.0, 0.1))
    )
    found = localized(recording, replace(start, hypotheses=wrong))
    assert found.diverged == ("R2",)
    assert remarks(found) == ()


def test_finds_a_robot_of_unknown_heading_and_bearing():
    recording = team_recording(seed=1, moving=2, seconds=40.0)
    problem = pair_problem(recording, (3.0, 3.0, 3.0), (2.0, -2.0, 2.5))
    solution = solve_mixture(problem, SETTINGS)
    error = relative_error(recording, problem, solution)
    assert np.hypot(*error[-50:, :2].T).max() < 0.6
    assert solution.share[-1] > 0.999


def test_goes_on_where_it_stopped():
    recording = team_recording(seed=3, moving=2, seconds=20.0)
    problem = pair_problem(recording, (0.5, 0.5, 0.5))
    whole = solve_mixture(problem, SETTINGS)
    t = 8_000_000_000 + 25_000_000
    early, late = cut(problem, t)
    first = solve_mixture(early, SETTINGS)
    kept = {"prior": None, "belief": first.belief, "memory": first.memory}
    second = solve_mixture(replace(late, **kept), SETTINGS)
    forgetful = solve_mixture(replace(late, **kept | {"memory": None}), SETTINGS)
    assert np.all(first.memory.travel != 0.0)
    assert np.any(second.memory.travel != forgetful.memory.travel)
    joined = np.concatenate([first.mean, second.mean])
    sigma = np.sqrt(np.einsum("oii->oi", whole.covariance))
    difference = joined - whole.mean
    difference[:, 2] = wrap_angle(difference[:, 2])
    assert np.abs(difference / sigma).max() < 0.1


def cut(problem, t):
    """A problem up to t (ns) and from there on."""
    r, o = problem.ranges.stamp <= t, problem.outputs.stamp <= t
    rows = lambda table, keep: type(table)(*(column[keep] for column in table))  # noqa: E731
    early = replace(
        problem, ranges=rows(problem.ranges, r), outputs=rows(problem.outputs, o), end=t
    )
    ends, first = problem.segments.end, problem.segments.first
    keep = ends > t
    counts = [np.sum(keep[a:b]) for a, b in pairwise(first)]
    segments = problem.segments._replace(
        **{n: getattr(problem.segments, n)[keep] for n in problem.segments._fields if n != "first"}
    )._replace(first=np.append(0, np.cumsum(counts)))
    late = replace(
        problem, ranges=rows(problem.ranges, ~r), outputs=rows(problem.outputs, ~o),
        segments=segments, start=t,
    )  # fmt: skip
    return early, late


def test_an_outlier_kills_no_hypothesis():
    recording = team_recording(seed=1, moving=2, seconds=2.0)
    problem = build_problem(recording, mirrored(recording), SETTINGS, EGO)
    ranges = problem.ranges.range.copy()
    ranges[5] += 5.0
    solution = solve_mixture(
        replace(problem, ranges=problem.ranges._replace(range=ranges)), SETTINGS
    )
    clean = solve_mixture(problem, SETTINGS)
    assert solution.verdict[5] == 0
    assert np.delete(solution.verdict, 5).all()
    assert abs(solution.share[-1] - clean.share[-1]) < 0.1


def test_same_numbers_on_every_run():
    recording = team_recording(seed=6, moving=3, seconds=4.0)
    start = from_truth(recording, (0.5, 0.5, 0.5))
    problem = build_problem(recording, start, SETTINGS, EGO)
    first, second = (solve_mixture(problem, SETTINGS) for _ in range(2))
    for name in ("mean", "covariance", "share", "residual"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def turn_sigma(x, P):
    """Standard deviation of the turn about the ego that the rest leaves to one block, rad."""
    N = np.array([-x[1], x[0], 1.0])
    return 1.0 / np.sqrt(N @ np.linalg.solve(P, N))


@pytest.mark.parametrize("hold", [True, False])
def test_ranges_from_a_robot_that_stands_leave_the_turn_about_it(hold):
    recording = standing_pair(3)
    problem = pair_problem(recording, (0.5, 0.5, 0.5), (0.3, -0.4, 0.2))
    gaussians = make_gaussian_sum(problem.belief, problem, 1, hold=hold)
    trace = make_mixture_output(problem.outputs, problem.ranges)
    known = turn_sigma(gaussians.mean[0], gaussians.covariance[0])
    for m in range(problem.ranges.stamp.size):
        fuse_range(
            gaussians, problem.space, problem.segments, problem.lever, problem.ranges, m, 0.0, trace
        )
    left = turn_sigma(gaussians.mean[0], gaussians.covariance[0])
    assert (left == pytest.approx(known, rel=1e-6)) == hold
    assert hold or left < 0.99 * known


def test_outputs_say_that_the_turn_leads_along_a_circle():
    """Also where one Gaussian is left: precisely ranged, it is as wide as its circle is bent."""
    recording = standing_pair(3)
    settings = FilterSettings(mixture={"components": 1})
    problem = pair_problem(recording, (0.5, 0.5, 0.5))
    solution = solve_mixture(problem, settings)
    x, P = solution.mean[-1], solution.covariance[-1]
    along = x[:2] / np.hypot(*x[:2])
    inside = solution.belief.covariance[0]
    sag = 0.75 * turn_sigma(x, inside) ** 4 * float(x[:2] @ x[:2])
    assert sag > 1e-5
    assert along @ P[:2, :2] @ along > 0.8 * sag
    assert along @ inside[:2, :2] @ along < along @ P[:2, :2] @ along
