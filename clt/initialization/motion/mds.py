"""Classical multidimensional scaling: positions from a matrix of distances.

Shi, section "Motion-induced initialization". The result is the least-squares answer for squared
distances, up to rotation, translation and reflection: the start of a refinement, not its end.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import shortest_path

from clt.core.arrays import Floats


def complete_distances(distance: Floats) -> Floats:
    """A symmetric distance matrix (n, n) whose missing entries (NaN) are shortest paths.

    Entries stay infinite where no path joins two nodes.
    """
    graph = np.where(np.isnan(distance), 0.0, np.maximum(distance, 1e-9))
    np.fill_diagonal(graph, 0.0)
    paths = np.asarray(shortest_path(graph, directed=False), dtype=np.float64)
    filled: Floats = np.where(np.isnan(distance), paths, distance)
    np.fill_diagonal(filled, 0.0)
    return filled


def classical_scaling(distance: Floats) -> Floats:
    """Planar positions (n, 2) around their centroid from a complete distance matrix (n, n).

    B = -1/2 J D^2 J with J = I - 11^T/n; positions are its two leading eigenvectors, each times
    the square root of its eigenvalue.
    """
    squared = distance**2
    row = squared.mean(axis=1)
    gram = -0.5 * (squared - row[:, None] - row[None, :] + row.mean())
    values, vectors = np.linalg.eigh(gram)
    positions = np.zeros((distance.shape[0], 2))
    leading = np.flatnonzero(values > 0.0)[::-1][:2]
    positions[:, : leading.size] = vectors[:, leading] * np.sqrt(values[leading])
    return positions
