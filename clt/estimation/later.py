"""Filters whose modules are imported when they run: all of them take longer than running one."""

from __future__ import annotations

from importlib import import_module

from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Filter, Solution


def later(module: str, name: str) -> Filter:
    """Stand for the function `name` of a module of `clt.filters`."""

    def run(problem: Problem, settings: FilterSettings) -> Solution:
        solve: Filter = getattr(import_module(f"clt.filters.{module}"), name)
        return solve(problem, settings)

    return run
