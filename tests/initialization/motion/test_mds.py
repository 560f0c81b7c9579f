from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.initialization.motion.mds import classical_scaling, complete_distances


def distances(points):
    return np.hypot(*np.moveaxis(points[:, None] - points[None, :], -1, 0))


@given(st.integers(2, 12), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_exact_distances_give_the_exact_shape(n, seed):
    points = np.random.default_rng(seed).uniform(-10.0, 10.0, (n, 2))
    np.testing.assert_allclose(
        distances(classical_scaling(distances(points))), distances(points), atol=1e-6
    )


def test_points_on_a_line_stay_on_it():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [3.0, 0.0], [7.0, 0.0]])
    np.testing.assert_allclose(
        distances(classical_scaling(distances(points))), distances(points), atol=1e-6
    )


def test_a_missing_distance_is_the_shortest_way_round():
    d = distances(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [9.0, 9.0]]))
    holed = d.copy()
    holed[0, 2] = holed[2, 0] = np.nan
    filled = complete_distances(holed)
    assert filled[0, 2] == filled[2, 0] == 7.0
    keep = ~np.isnan(holed)
    np.testing.assert_array_equal(filled[keep], d[keep])


def test_nodes_that_no_path_joins_are_infinitely_far():
    d = np.full((4, 4), np.nan)
    d[0, 1] = d[1, 0] = d[2, 3] = d[3, 2] = 1.0
    np.testing.assert_array_equal(np.isinf(complete_distances(d))[0], [False, False, True, True])
