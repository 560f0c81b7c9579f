"""The particle filters: points for few robots, narrow Gaussians for many."""

from __future__ import annotations

from clt.filters.particle.gaussian_particles import solve_gaussian_particles
from clt.filters.particle.sir import solve_sir
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution

MAX_SIR_BLOCKS = 2
"""Blocks that a few thousand points fill."""


def solve_pf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the particle filter that is set, or that suits the number of robots."""
    kind = settings.pf.kind
    if kind == "auto":
        kind = "sir" if len(problem.robots) <= MAX_SIR_BLOCKS else "gaussian"
    return (
        solve_sir(problem, settings)
        if kind == "sir"
        else solve_gaussian_particles(problem, settings)
    )
