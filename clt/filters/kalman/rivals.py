"""Other beliefs about robots that look lost: positions that fit their ranges, in all headings."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.model.belief import Belief
from clt.model.range_table import RangeTable

HEADINGS_TRIED = 8
"""How many headings are tried, evenly spaced from that which is believed."""
LOST_POSITION_SIGMA_M, LOST_HEADING_SIGMA = 0.5, np.pi / HEADINGS_TRIED
"""Standard deviations of a rival's x and y (m, at least) and heading (rad)."""
OUTLIER_SCALE_M = 0.3
"""Range errors beyond this count less and less in a position, m."""
MIN_POSITION_DISTANCE_M = 1.0
"""Positions that are closer than this are one, m."""
MAX_MIRRORED_ROBOTS, MAX_POSITION_SETS = 4, 3
"""Up to so many robots are mirrored one by one, not only all at once; sets of positions tried."""


class LostRobotLinks(NamedTuple):
    """The first range of each pair of which one end is lost."""

    ends: Indices
    """Blocks, negative for a fixed end, shape (m, 2)."""
    fixed: Floats
    """Position of the fixed end, shape (m, 2), m."""
    range: Floats
    """m."""


def lost_robot_links(ranges: RangeTable, lost: Indices) -> LostRobotLinks:
    """The first range of each pair that the `lost` blocks have."""
    use = np.flatnonzero(np.isin(ranges.a, lost) | np.isin(ranges.b, lost))
    ends = np.stack([ranges.a[use], ranges.b[use]], axis=1)
    _, first = np.unique(np.sort(ends, axis=1), axis=0, return_index=True)
    rows = use[np.sort(first)]
    return LostRobotLinks(
        np.stack([ranges.a[rows], ranges.b[rows]], axis=1), ranges.anchor[rows], ranges.range[rows]
    )


def alternative_beliefs(
    belief: Belief, lever: Floats, ranges: RangeTable, lost: Indices
) -> list[list[Belief]]:
    """For each set of positions that the `lost` blocks (L,) may have: a belief for each heading.

    The k-th belief turns all of them by the same angle; headings near those believed come first.
    """
    links, mean = lost_robot_links(ranges, lost), belief.mean[0]
    turns = [(k + 1) // 2 * (-1) ** k * 2.0 * np.pi / HEADINGS_TRIED for k in range(HEADINGS_TRIED)]
    made = []
    for places, error in candidate_positions(mean, lever, links, lost):
        P = widen_blocks(
            belief.covariance[0], lost, (max(LOST_POSITION_SIGMA_M, error), LOST_HEADING_SIGMA)
        )
        begun = []
        for turn in turns:
            x = mean.copy()
            x[3 * lost], x[3 * lost + 1] = places.T
            x[3 * lost + 2] += turn
            x[: 3 * lever.shape[0]].reshape(-1, 3)[lost, :2] -= antenna_offsets(x, lever)[lost]
            begun.append(Belief(np.zeros(1), x[None], P[None]))
        made.append(begun)
    return made


def widen_blocks(P: Floats, lost: Indices, sigma: tuple[float, float]) -> Floats:
    """A covariance (N, N) that knows the `lost` blocks to `sigma` (m, rad) only."""
    P = P.copy()
    for first in 3 * lost:
        own = slice(first, first + 3)
        P[own, :] = P[:, own] = 0.0
        P[own, own] = np.diag([sigma[0] ** 2, sigma[0] ** 2, sigma[1] ** 2])
    return P


def candidate_positions(
    mean: Floats, lever: Floats, links: LostRobotLinks, lost: Indices
) -> list[tuple[Floats, float]]:
    """Where the `lost` blocks may be, (L, 2), the best first, and how far ranges miss that, m.

    Each block by itself is where its ranges put it from the believed position on, or from the
    mirror image of that in the line through its partners; from there all are fitted together.
    """
    at = mean[: 3 * lever.shape[0]].reshape(-1, 3)[:, :2] + antenna_offsets(mean, lever)
    places = []
    for i in lost:
        own = links_to_known(links, i, lost)
        near = fit_positions(at, own, np.array([i]), at[i])
        moved = at.copy()
        moved[i] = near.places[0]
        places.append((near.places[0], mirror_position(moved, own, i)))
    if lost.size <= MAX_MIRRORED_ROBOTS:
        begins = [np.array(begin) for begin in product(*places)]
    else:
        begins = [np.array(begin) for begin in zip(*places, strict=True)]
    fits = sorted(
        (fit_positions(at, links, lost, begin) for begin in begins), key=lambda each: each.cost
    )
    kept: list[PositionFit] = []
    for each in fits:
        if all(
            np.abs(each.places - other.places).max() > MIN_POSITION_DISTANCE_M for other in kept
        ):
            kept.append(each)
    return [(each.places, each.error) for each in kept[:MAX_POSITION_SETS]]


class PositionFit(NamedTuple):
    """Positions that fit ranges."""

    places: Floats
    """(L, 2), m."""
    error: float
    """Median of what ranges miss, m."""
    cost: float


def fit_positions(at: Floats, links: LostRobotLinks, lost: Indices, begin: Floats) -> PositionFit:
    """The `lost` (L,) of the antennas `at` (B, 2) moved to where ranges put them, from a beginning.

    What ranges leave open stays near the believed position. Outliers count little.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415 - slow, and seldom needed

    old = at[lost].ravel()
    spread = max(
        float(np.max(np.abs(link_range_errors(at, links)), initial=0.0)), LOST_POSITION_SIGMA_M
    )

    def errors(free: Floats) -> Floats:
        moved = at.copy()
        moved[lost] = free.reshape(-1, 2)
        return np.concatenate(
            [link_range_errors(moved, links), OUTLIER_SCALE_M / spread * (free - old)]
        )

    found = least_squares(errors, begin.ravel(), loss="cauchy", f_scale=OUTLIER_SCALE_M)
    error = float(np.median(np.abs(found.fun[: links.range.size])))
    return PositionFit(found.x.reshape(-1, 2), error, float(found.cost))


def links_to_known(links: LostRobotLinks, i: int, lost: Indices) -> LostRobotLinks:
    """The links of block i with partners that are not lost; all of its links if those are few."""
    own = np.any(links.ends == i, axis=1)
    known = own & (np.sum(np.isin(links.ends, lost), axis=1) == 1)
    rows = known if np.sum(known) > 1 else own
    return LostRobotLinks._make(column[rows] for column in links)


def antenna_offsets(mean: Floats, lever: Floats) -> Floats:
    """From the pose of each block in a state (N,) to its antenna, in its frame, (B, 2), m."""
    theta = mean[2 : 3 * lever.shape[0] : 3]
    c, s = np.cos(theta), np.sin(theta)
    turned: Floats = np.stack([c, -s, s, c], axis=1).reshape(-1, 2, 2) @ lever[:, :, None]
    return turned[:, :, 0]


def link_end_positions(places: Floats, links: LostRobotLinks, end: int) -> Floats:
    """Where that `end` (0 or 1) of each link is, shape (m, 2), m."""
    i = links.ends[:, end]
    at: Floats = np.where(i[:, None] < 0, links.fixed, places[np.maximum(i, 0)])
    return at


def link_range_errors(places: Floats, links: LostRobotLinks) -> Floats:
    """By how much each range is shorter than the distance, m."""
    line = link_end_positions(places, links, 0) - link_end_positions(places, links, 1)
    length: Floats = np.hypot(line[:, 0], line[:, 1])
    return length - links.range


def mirror_position(places: Floats, links: LostRobotLinks, i: int) -> Floats:
    """Block i's antenna mirrored in the line that fits its partners best, (2,), m."""
    others = [link_end_positions(places, links, 1 - end)[links.ends[:, end] == i] for end in (0, 1)]
    points = np.concatenate(others)
    middle = points.mean(axis=0)
    along = np.linalg.svd(points - middle)[2][0]
    arm = places[i] - middle
    image: Floats = middle + 2.0 * (arm @ along) * along - arm
    return image
