"""Ranges that fit to nothing: a few wild ones shall not hide the pose that explains all others.

Where no pose explains all ranges, poses are sought that explain most. A few ranges, drawn again and
again, lead to some poses each (random sample consensus, Fischler and Bolles 1981), from which
least squares are solved with the ranges that fit best. Those that are left out may be anywhere in
SPAN; that tells how probable each explanation is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clt.core.recording import Floats, Indices
from clt.initialization.pairwise.branch_and_bound import chosen, descents
from clt.initialization.pairwise.likelihood import (
    AT,
    LOG_DET,
    NEAREST,
    PHI,
    THETA,
    Pair,
    attained,
    descend,
    weigh,
)
from clt.initialization.pairwise.taylor_bounds import Work, work_for
from clt.jit.compiled import kernel

MISFIT = 3.0
"""Standard deviations by which squared residuals may exceed their noise to be believed."""
WILD = 5
"""One range in as many may be wild ..."""
OFF = 6.0
"""... and is off by at least so many standard deviations: noise that is merely larger is not."""
RARE = 0.05
"""Probability that a range is wild, before all."""
SPAN = 10.0
"""Wild ranges may be anywhere within so much, m."""
DRAWS = 100
"""Samples of ranges that are drawn ..."""
SAMPLE = 7
"""... and how many ranges there are in each."""
SAME = (0.3, 0.2)
"""Poses that differ by less (m, rad) lead to the same explanation ..."""
CLOSE = (0.15, 0.1)
"""... and explanations whose poses do are no rivals."""
TRIMS = 3
"""How often the ranges that fit best are chosen anew."""
MOST = 32
"""Poses from which an explanation is sought."""
SURE = 0.99
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
    """Of all ranges, see `solved`."""


def bound(count: int) -> float:
    """What the squares of so many numbers, in units of their variance, may add up to."""
    return count + MISFIT * float(np.sqrt(2.0 * count))


def spare(n: int, turns: bool) -> int:
    """How many of n ranges are more than a pose has unknowns."""
    return n - (3 if turns else 2)


def noise(n: int, turns: bool) -> float:
    """What n squared residuals of a best pose (in units of their variance) may come to as noise.

    Also those of as few as a pose can follow: where they contradict each other no pose explains
    them.
    """
    left = spare(n, turns)
    return bound(left) if left > 0 else MISFIT * MISFIT


def without_wild(pair: Pair, turns: bool, cost: float) -> tuple[Pair, bool] | None:
    """A pair, whose best pose costs so much, without its wild ranges, and whether that is sure.

    Not sure where other poses explain as much with other ranges; those that do with the same ones
    are another matter, see `Hypotheses.unique`. None where some pose explains all, where one wild
    range in WILD does not explain it, where they are not OFF, or too few are left to tell.
    """
    n = pair.z.size
    sought = [explained(pair, pose, turns) for pose in candidates(pair, turns)]
    found = [one for one in sought if one is not None and spare(one.rows.size, turns) > 1]
    whole = any(one.rows.size == n for one in found)
    found = [one for one in found if cost - one.cost >= OFF * OFF * (n - one.rows.size)]
    if whole or len(found) == 0:
        return None
    best = max(found, key=lambda one: one.log_likelihood)
    rivals = {
        one.rows.tobytes(): one.log_likelihood
        for one in found
        if not (alike(one.pose, best.pose, CLOSE) or np.array_equal(one.rows, best.rows))
    }
    against = float(np.exp(np.array(list(rivals.values())) - best.log_likelihood).sum())
    return chosen(pair, best.rows), 1.0 / (1.0 + against) >= SURE


def candidates(pair: Pair, turns: bool) -> list[Floats]:
    """Poses (3,) to which a few ranges lead, those first that explain most of all ranges best."""
    n = pair.z.size
    draw, kept, work = np.random.default_rng(n), n - n // WILD, work_for(pair)
    poses, worst = [], []
    for _ in range(DRAWS if kept < n else 0):
        some = chosen(pair, np.sort(draw.choice(n, min(SAMPLE, kept), replace=False)))
        for _, theta, phi, d in descents(some, some, turns, work_for(some)).tolist():
            pose = pose_of(some, theta, phi, d)
            poses.append(pose)
            worst.append(np.sort(misfits(pair, *polar(pair, pose), work))[kept - 1])
    found: list[Floats] = []
    for k in np.argsort(worst).tolist():
        if len(found) < MOST and not any(alike(poses[k], other, SAME) for other in found):
            found.append(poses[k])
    return found


def explained(pair: Pair, pose: Floats, turns: bool) -> Explanation | None:
    """The pose nearby to which as many ranges fit as can, if all but one in WILD do.

    Least trimmed squares (Rousseeuw and Van Driessen 2006): the ranges that fit best tell the pose,
    and that again which fit best. The others are then taken back one by one.
    """
    n = pair.z.size
    kept, work = n - n // WILD, work_for(pair)
    for _ in range(TRIMS):
        order = np.argsort(misfits(pair, *polar(pair, pose), work))
        pose = solved(pair, np.sort(order[:kept]), pose, turns).pose
    best = None
    for count in range(kept, n + 1):
        found = solved(pair, np.sort(order[:count]), pose, turns)
        if found.cost > noise(count, turns):
            break
        best, pose = found, found.pose
    return best


def solved(pair: Pair, rows: Indices, pose: Floats, turns: bool) -> Explanation:
    """Least squares by some ranges of a pair from a pose on, and how probable their choice is.

    The likelihood is that of the ranges that are kept, times RARE / SPAN for each other one.
    """
    some = chosen(pair, rows)
    work, kept = work_for(some), rows.size
    out = work.out
    descend(some, *polar(some, pose), turns, work.L, work.y, out)
    cost = attained(out)
    log_likelihood = -0.5 * (cost + out[LOG_DET]) + (pair.z.size - kept) * np.log(RARE / SPAN)
    log_likelihood += kept * (np.log(1.0 - RARE) - 0.5 * np.log(2.0 * np.pi))
    return Explanation(rows, pose_of(some, out[THETA], out[PHI], out[AT]), cost, log_likelihood)


@kernel
def misfits(pair: Pair, theta: float, phi: float, d: float, work: Work) -> Floats:
    """Residual of each range (n,) at a pose in standard deviations, each by itself."""
    n = pair.z.size
    L, y, none = work.L, work.y, np.zeros(n)
    weigh(pair, theta, phi, d, 0.0, np.inf, none, L, y, work.out)
    misfit = np.empty(n)
    for i in range(n):
        # W = L L^T, L left with its diagonal inverted, and L^-1 r.
        own = 1.0 / L[i, i]
        r, variance = own * y[i, 0], own * own
        for k in range(i):
            r += L[i, k] * y[k, 0]
            variance += L[i, k] * L[i, k]
        misfit[i] = abs(r) / math.sqrt(variance)
    return misfit


def polar(pair: Pair, pose: Floats) -> tuple[float, float, float]:
    """Direction (rad), turn (rad) and distance (m) between the antennas at a pair's first range."""
    x, y, phi = (float(value) for value in pose)
    c, s = math.cos(phi), math.sin(phi)
    x += c * pair.b[0, 0] - s * pair.b[0, 1] - pair.a[0, 0]
    y += s * pair.b[0, 0] + c * pair.b[0, 1] - pair.a[0, 1]
    return math.atan2(y, x), phi, max(math.hypot(x, y), NEAREST)


def pose_of(pair: Pair, theta: float, phi: float, d: float) -> Floats:
    """The pose (3,) that `polar` tells of."""
    c, s = math.cos(phi), math.sin(phi)
    x = d * math.cos(theta) - c * pair.b[0, 0] + s * pair.b[0, 1] + pair.a[0, 0]
    y = d * math.sin(theta) - s * pair.b[0, 0] - c * pair.b[0, 1] + pair.a[0, 1]
    return np.array([x, y, math.remainder(phi, math.tau)])


def alike(a: Floats, b: Floats, within: tuple[float, float]) -> bool:
    """Whether two poses (3,) differ by less (m, rad)."""
    turned = abs(math.remainder(a[2] - b[2], math.tau))
    return bool(math.hypot(a[0] - b[0], a[1] - b[1]) < within[0] and turned < within[1])
