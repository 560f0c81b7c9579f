"""What a user learns of the searches for robots that looked lost."""

from __future__ import annotations

import numpy as np

from clt.model.problem import Problem
from clt.model.solution import Solution


def found_robot_warnings(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each robot whose estimate was replaced by one that its ranges fit better."""
    return tuple(
        f"{name} was lost {times_in_words(found)}: "
        "many of its ranges contradicted the estimate, and a "
        "search found a pose that they fit"
        f"{f' ({times_in_words(vain)} in vain)' if vain > 0 else ''}"
        for name, found, vain in search_counts(problem, solution)
        if found > 0
    )


def vain_search_remarks(problem: Problem, solution: Solution) -> tuple[str, ...]:
    """One line for each robot that was searched for and whose estimate stayed."""
    return tuple(
        f"{name} looked lost {times_in_words(vain)}: "
        "many of its ranges contradicted the estimate, but a "
        "search found no pose that they fit clearly better, so the estimate stayed"
        for name, found, vain in search_counts(problem, solution)
        if found == 0 and vain > 0
    )


def search_counts(problem: Problem, solution: Solution) -> list[tuple[str, int, int]]:
    """Each block's robot, how often a search replaced its estimate, and how often not."""
    found = np.zeros_like(solution.lost) if solution.found is None else solution.found
    vain = solution.lost - found
    return list(zip(problem.robots, found.tolist(), vain.tolist(), strict=True))


def times_in_words(times: int) -> str:
    """A count as an adverb."""
    return "once" if times == 1 else f"{times} times"
