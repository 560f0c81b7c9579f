"""Ranges that fit to nothing: a few wild ones shall not hide the pose that explains all others.

Where no pose explains all ranges, poses are sought that explain most. A few ranges, drawn again and
again, lead to some poses each (random sample consensus, Fischler and Bolles 1981), from which
least squares are solved with the ranges that fit best. Those that are left out may be anywhere in
OUTLIER_SPAN_M; that says how probable each explanation is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.initialization.pairwise.branch_and_bound import pair_subset
from clt.initialization.pairwise.descents import descend_from_all_sides
from clt.initialization.pairwise.likelihood import (
    AT_DISTANCE,
    LOG_DET,
    MIN_ANTENNA_DISTANCE,
    PHI,
    THETA,
    CostWorkspace,
    PairRanges,
    attained_cost,
    evaluate_cost,
    fit_relative_pose,
    make_cost_workspace,
)
from clt.jit.compiled import compiled_noalloc

MAX_EXCESS_SIGMAS = 3.0
"""Standard deviations by which squared residuals may exceed their noise to be believed."""
RANGES_PER_OUTLIER = 5
"""One range in as many may be wild ..."""
MIN_OUTLIER_SIGMAS = 6.0
"""... and is off by at least so many standard deviations: noise that is merely larger is not."""
OUTLIER_PROBABILITY = 0.05
"""Probability that a range is wild, before all."""
OUTLIER_SPAN_M = 10.0
"""Wild ranges may be anywhere within so much, m."""
RANSAC_SAMPLES = 100
"""Samples of ranges that are drawn ..."""
RANSAC_SAMPLE_SIZE = 7
"""... and how many ranges there are in each."""
SAME_CANDIDATE_LIMITS = (0.3, 0.2)
"""Poses that differ by less (m, rad) lead to the same explanation ..."""
SAME_EXPLANATION_LIMITS = (0.15, 0.1)
"""... and explanations whose poses do are no rivals."""
TRIM_ROUNDS = 3
"""How often the ranges that fit best are chosen anew."""
MAX_CANDIDATE_POSES = 32
"""Poses from which an explanation is sought."""
SOLE_EXPLANATION_PROBABILITY = 0.99
"""Probability from which an explanation counts as the only one."""


@dataclass(frozen=True)
class Explanation:
    """A pose and the ranges that fit to it."""

    rows: Indices
    pose: Floats
    """Of robot j in the frame of robot i, (3,), m and rad."""
    cost: float
    """Squared residuals of these ranges in units of their variance."""
    log_likelihood: float
    """Of all ranges, see `fit_explanation`."""


def chi_square_limit(count: int) -> float:
    """What the squares of so many numbers, in units of their variance, may add up to."""
    return count + MAX_EXCESS_SIGMAS * float(np.sqrt(2.0 * count))


def degrees_of_freedom(n: int, turns: bool) -> int:
    """How many of n ranges are more than a pose has unknowns."""
    return n - (3 if turns else 2)


def noise_cost_limit(n: int, turns: bool) -> float:
    """What n squared residuals of a best pose (in units of their variance) may come to as noise.

    Also those of as few as a pose can follow: where they contradict each other no pose explains
    them.
    """
    left = degrees_of_freedom(n, turns)
    return chi_square_limit(left) if left > 0 else MAX_EXCESS_SIGMAS * MAX_EXCESS_SIGMAS


def without_outliers(pair: PairRanges, turns: bool, cost: float) -> tuple[PairRanges, bool] | None:
    """A pair, whose best pose costs so much, without its wild ranges, and whether that is sure.

    Not sure where other poses explain as much with other ranges; those that do with the same ones
    are another matter, see `PairHypotheses.unique`. None where some pose explains all, where one
    wild range in RANGES_PER_OUTLIER does not explain it, where they are not MIN_OUTLIER_SIGMAS, or
    too few are left to know.
    """
    n = pair.z.size
    sought = [explain_ranges(pair, pose, turns) for pose in candidate_poses(pair, turns)]
    found = [
        one for one in sought if one is not None and degrees_of_freedom(one.rows.size, turns) > 1
    ]
    whole = any(one.rows.size == n for one in found)
    found = [
        one
        for one in found
        if cost - one.cost >= MIN_OUTLIER_SIGMAS * MIN_OUTLIER_SIGMAS * (n - one.rows.size)
    ]
    if whole or len(found) == 0:
        return None
    best = max(found, key=lambda one: one.log_likelihood)
    rivals = {
        one.rows.tobytes(): one.log_likelihood
        for one in found
        if not (
            poses_within(one.pose, best.pose, SAME_EXPLANATION_LIMITS)
            or np.array_equal(one.rows, best.rows)
        )
    }
    against = float(np.exp(np.array(list(rivals.values())) - best.log_likelihood).sum())
    return pair_subset(pair, best.rows), 1.0 / (1.0 + against) >= SOLE_EXPLANATION_PROBABILITY


def candidate_poses(pair: PairRanges, turns: bool) -> list[Floats]:
    """Poses (3,) to which a few ranges lead, those first that explain most of all ranges best."""
    n = pair.z.size
    draw, kept, work = (
        np.random.default_rng(n),
        n - n // RANGES_PER_OUTLIER,
        make_cost_workspace(pair),
    )
    poses, worst = [], []
    for _ in range(RANSAC_SAMPLES if kept < n else 0):
        some = pair_subset(
            pair, np.sort(draw.choice(n, min(RANSAC_SAMPLE_SIZE, kept), replace=False))
        )
        minima = descend_from_all_sides(some, some, turns, make_cost_workspace(some))
        led = [polar_to_pose(some, theta, phi, d) for _, theta, phi, d in minima.tolist()]
        polar = np.array([pose_to_polar(pair, pose) for pose in led])
        residual = np.empty((len(led), n))
        fill_normalized_residuals(pair, polar, work, residual)
        poses += led
        worst += np.sort(residual, axis=1)[:, kept - 1].tolist()
    found: list[Floats] = []
    for k in np.argsort(worst).tolist():
        if len(found) < MAX_CANDIDATE_POSES and not any(
            poses_within(poses[k], other, SAME_CANDIDATE_LIMITS) for other in found
        ):
            found.append(poses[k])
    return found


def explain_ranges(pair: PairRanges, pose: Floats, turns: bool) -> Explanation | None:
    """The pose nearby to which as many ranges fit as can, if all but one in RANGES_PER_OUTLIER do.

    Least trimmed squares (Rousseeuw and Van Driessen 2006): the ranges that fit best give the pose,
    and that again which fit best. The others are then taken back one by one.
    """
    n = pair.z.size
    kept, work = n - n // RANGES_PER_OUTLIER, make_cost_workspace(pair)
    for _ in range(TRIM_ROUNDS):
        order = np.argsort(normalized_residuals(pair, *pose_to_polar(pair, pose), work))
        pose = fit_explanation(pair, np.sort(order[:kept]), pose, turns).pose
    best = None
    for count in range(kept, n + 1):
        found = fit_explanation(pair, np.sort(order[:count]), pose, turns)
        if found.cost > noise_cost_limit(count, turns):
            break
        best, pose = found, found.pose
    return best


def fit_explanation(pair: PairRanges, rows: Indices, pose: Floats, turns: bool) -> Explanation:
    """Least squares by some ranges of a pair from a pose on, and how probable their choice is.

    The likelihood is that of the ranges that are kept, times OUTLIER_PROBABILITY / OUTLIER_SPAN_M
    for each other one.
    """
    some = pair_subset(pair, rows)
    work, kept = make_cost_workspace(some), rows.size
    out = work.out
    fit_relative_pose(some, *pose_to_polar(some, pose), turns, work)
    cost = attained_cost(out)
    log_likelihood = -0.5 * (cost + out[LOG_DET]) + (pair.z.size - kept) * np.log(
        OUTLIER_PROBABILITY / OUTLIER_SPAN_M
    )
    log_likelihood += kept * (np.log(1.0 - OUTLIER_PROBABILITY) - 0.5 * np.log(2.0 * np.pi))
    return Explanation(
        rows, polar_to_pose(some, out[THETA], out[PHI], out[AT_DISTANCE]), cost, log_likelihood
    )


def normalized_residuals(
    pair: PairRanges, theta: float, phi: float, d: float, work: CostWorkspace
) -> Floats:
    """Residual of each range (n,) at a pose in standard deviations, each by itself."""
    residual = np.empty((1, pair.z.size))
    fill_normalized_residuals(pair, np.array([[theta, phi, d]]), work, residual)
    return np.asarray(residual[0])


@compiled_noalloc
def fill_normalized_residuals(
    pair: PairRanges, polar: Floats, work: CostWorkspace, residual: Floats
) -> None:
    """`normalized_residuals` at poses (K, 3): theta, phi (rad), distance (m); into (K, n)."""
    L, y = work.L, work.y
    for p in range(len(polar)):
        evaluate_cost(pair, polar[p, 0], polar[p, 1], polar[p, 2], 0.0, np.inf, work.none, work)
        for i in range(pair.z.size):
            # W = L L^T, L left with its diagonal inverted, and L^-1 r.
            own = 1.0 / L[i, i]
            r, variance = own * y[i, 0], own * own
            for k in range(i):
                r += L[i, k] * y[k, 0]
                variance += L[i, k] * L[i, k]
            residual[p, i] = abs(r) / math.sqrt(variance)


def pose_to_polar(pair: PairRanges, pose: Floats) -> tuple[float, float, float]:
    """Direction (rad), turn (rad) and distance (m) between the antennas at a pair's first range."""
    x, y, phi = (float(value) for value in pose)
    c, s = math.cos(phi), math.sin(phi)
    x += c * pair.b[0, 0] - s * pair.b[0, 1] - pair.a[0, 0]
    y += s * pair.b[0, 0] + c * pair.b[0, 1] - pair.a[0, 1]
    return math.atan2(y, x), phi, max(math.hypot(x, y), MIN_ANTENNA_DISTANCE)


def polar_to_pose(pair: PairRanges, theta: float, phi: float, d: float) -> Floats:
    """The pose (3,) that `pose_to_polar` describes."""
    c, s = math.cos(phi), math.sin(phi)
    x = d * math.cos(theta) - c * pair.b[0, 0] + s * pair.b[0, 1] + pair.a[0, 0]
    y = d * math.sin(theta) - s * pair.b[0, 0] - c * pair.b[0, 1] + pair.a[0, 1]
    return np.array([x, y, math.remainder(phi, math.tau)])


def poses_within(a: Floats, b: Floats, within: tuple[float, float]) -> bool:
    """Whether two poses (3,) differ by less (m, rad)."""
    turned = abs(math.remainder(a[2] - b[2], math.tau))
    return bool(math.hypot(a[0] - b[0], a[1] - b[1]) < within[0] and turned < within[1])
