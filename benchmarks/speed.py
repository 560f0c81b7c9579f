"""Speed of the filter and of the whole command, as ratios measured in one run.

    python benchmarks/speed.py [--runs 5] [--out benchmarks/results/speed.md]

1. `clt localize --filter eskf --init truth` as a whole warm process, on a log of five robots
   (three moving) over 300 s with all pairs at 100 Hz, beside a process in which the official
   `mcap` reader does nothing but iterate that log's messages. Runs take turns; medians.
2. EKF and UKF alone on shi-sim (300 s, 20 Hz, nine numbers) beside the same filters through
   filterpy, on the same arrays and to the same numbers: processor time, best of each.
3. The default filter alone with 50 moving robots and all 1,325 pairs at 20 Hz over 300 s.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path
from time import process_time

from processes import CLT, iterating, wall

from clt.estimation.estimators import FILTERPY_FILTERS, FILTERS
from clt.filters.kalman.gaussian import solve_eskf
from clt.initialization.given.truth import from_truth
from clt.model.problem import Problem, build_problem
from clt.model.settings import FilterSettings
from clt.model.solution import Filter
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate


def whole_process(runs: int) -> tuple[float, float]:
    """Median seconds of `clt localize` and of iterating the same log."""
    with tempfile.TemporaryDirectory() as folder:
        log, out = f"{folder}/log.mcap", f"{folder}/out.mcap"
        wall(*CLT, "simulate", "shi-sim", "--set", "sensors.range.rate=100", "-q", "-o", log)
        localize = (*CLT, "localize", log, "--filter", "eskf", "--init", "truth", "-q")
        localize = (*localize, "--force", "-o", out)
        iterate = iterating(log)
        wall(*localize)
        wall(*iterate)
        pairs = [(wall(*localize), wall(*iterate)) for _ in range(runs)]
    ours, theirs = zip(*pairs, strict=True)
    return statistics.median(ours), statistics.median(theirs)


def problem(**overrides: object) -> tuple[Problem, FilterSettings]:
    """A scenario laid out for the filter."""
    recording = simulate(load_scenario("shi-sim", overrides))
    settings = FilterSettings()
    start = from_truth(recording, settings.initial.sigma)
    return build_problem(recording, start, settings), settings


def seconds(solve: Filter, runs: int, laid_out: Problem, settings: FilterSettings) -> float:
    """Best processor time of a filter over a log, s, after a first run that compiles."""
    times = []
    for _ in range(runs + 1):
        begin = process_time()
        solve(laid_out, settings)
        times.append(process_time() - begin)
    return min(times[1:])


def beside_filterpy(name: str, runs: int) -> str:
    """A row of the table: one filter on shi-sim, ours and filterpy's."""
    laid_out, settings = problem()
    ours = seconds(FILTERS[name], 8 * runs, laid_out, settings)
    theirs = seconds(FILTERPY_FILTERS[name], 2, laid_out, settings)
    return (
        f"| {name.upper()} alone, shi-sim, 300 s | {ours * 1e3:.1f} ms | filterpy: "
        f"{theirs:.2f} s | {theirs / ours:.0f} x faster |"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    ours, theirs = whole_process(options.runs)
    large = seconds(solve_eskf, 2, *problem(**{"team.moving": 50, "sensors.truth.rate": 1}))
    text = f"""\
Medians or best times in one run on two cores (`python benchmarks/speed.py`):

| what | clt | beside | ratio |
|---|---|---|---|
| `clt localize`, warm process, 5 robots, 300 s, 100 Hz | {ours:.2f} s | iterating by mcap: \
{theirs:.2f} s | {ours / theirs:.2f} of its time |
{beside_filterpy("ekf", options.runs)}
{beside_filterpy("ukf", options.runs)}
| ESKF alone, 50 moving robots, 1325 pairs, 20 Hz, 300 s | {large:.2f} s | real time: 300 s | \
{300 / large:.0f} x faster |
"""
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
