"""Where the refinement of a layout starts: multidimensional scaling, brought into the frame."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clt.core.arrays import Floats
from clt.initialization.motion.mds import classical_scaling, complete_distances
from clt.initialization.pair_distances import PairDistances

LAYOUT_RESTARTS = 12
"""Further starts where distances are missing or contradict each other."""


def guess_layouts(pairs: PairDistances, n: int, known: Mapping[int, Floats]) -> list[Floats]:
    """Multidimensional scaling, brought into the frame; with known positions both ways round."""
    distance = np.full((n, n), np.nan)
    distance[pairs.a, pairs.b] = distance[pairs.b, pairs.a] = np.maximum(pairs.distance, 1e-3)
    for i, p in known.items():
        for j, q in known.items():
            distance[i, j] = float(np.hypot(*(p - q)))
    full = complete_distances(distance)
    far = 2.0 * float(np.max(full[np.isfinite(full)], initial=1.0))
    raw = classical_scaling(np.where(np.isfinite(full), full, far))
    if len(known) == 0:
        return [_with_axis(raw, np.zeros(2), np.array([1.0, 0.0]), 0, 1)]
    nodes = list(known)
    target = np.array([known[node] for node in nodes])
    return [_procrustes(raw * [1.0, sign], nodes, target) for sign in (1.0, -1.0)]


def _with_axis(raw: Floats, origin: Floats, along: Floats, a: int, b: int) -> Floats:
    """Turn and shift positions so that node a lies at `origin` and b towards `along`."""
    d = raw[b] - raw[a]
    length = max(float(np.hypot(*d)), 1e-9)
    c, s = d / length
    turned = (raw - raw[a]) @ np.array([[c, -s], [s, c]])
    x, y = along
    return np.asarray(origin + turned @ np.array([[x, y], [-y, x]]))


def _procrustes(raw: Floats, nodes: list[int], target: Floats) -> Floats:
    """Turn and shift positions onto the known ones, without reflection."""
    source = raw[nodes]
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    angle = np.arctan2(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), np.sum(a * b))
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray((raw - source.mean(axis=0)) @ np.array([[c, s], [-s, c]]) + target.mean(0))


def perturbed_layout(start: Floats, seed: int) -> Floats:
    """Another start, off by up to the size of the layout."""
    size = float(np.max(np.abs(start - start.mean(axis=0)), initial=1.0))
    noise = np.random.default_rng(seed).normal(size=start.shape)
    return np.asarray(start + (seed + 1) / LAYOUT_RESTARTS * size * noise)
