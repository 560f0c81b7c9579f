"""The same filters through filterpy, the engine that Araki used: a cross-check and a bar for speed.

It takes most of a second to import: that waits until it is used.
"""

from __future__ import annotations

from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution


def solve_filterpy_ekf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run filterpy's extended Kalman filter on a problem; the numbers of `gaussian.solve_ekf`."""
    from clt.filters.filterpy.ekf import solve_team_ekf as solve  # noqa: PLC0415 - takes long

    return solve(problem, settings)


def solve_filterpy_ukf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run filterpy's unscented Kalman filter on a problem; the numbers of `ukf.solve_ukf`."""
    from clt.filters.filterpy.ukf import solve_team_ukf as solve  # noqa: PLC0415 - takes long

    return solve(problem, settings)
