"""What is known of the searches for robots that looked lost."""

from __future__ import annotations

import numpy as np

from clt.core.diagnostics import Diagnostic
from clt.model.problem import Problem
from clt.model.solution import Solution


def found_robot_warnings(problem: Problem, solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each robot whose estimate was replaced by one that its ranges fit better."""
    return tuple(
        Diagnostic("robot_found", name, "partial", {"times": found, "in_vain": vain})
        for name, found, vain in search_counts(problem, solution)
        if found > 0
    )


def vain_search_remarks(problem: Problem, solution: Solution) -> tuple[Diagnostic, ...]:
    """One for each robot that was searched for and whose estimate stayed."""
    return tuple(
        Diagnostic("search_in_vain", name, "information", {"times": vain})
        for name, found, vain in search_counts(problem, solution)
        if found == 0 and vain > 0
    )


def search_counts(problem: Problem, solution: Solution) -> list[tuple[str, int, int]]:
    """Each block's robot, how often a search replaced its estimate, and how often not."""
    found = np.zeros_like(solution.lost) if solution.found is None else solution.found
    vain = solution.lost - found
    return list(zip(problem.robots, found.tolist(), vain.tolist(), strict=True))
