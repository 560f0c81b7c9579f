"""The distributed filter with shared particles: a line with 20 iterations against all who hear all.

    python benchmarks/distributed_line.py [--seeds 100] [--particles 1000] [--out FILE]

Scene and starts are those of `distributed.py` over 60 s. Twenty iterations on a line leave the
robots' log-likelihoods different by a few ten thousandths; from there on, resampling makes of each
run another draw of the same filter. So a second run on the complete graph, with other random
numbers, stands beside. Ratios are of root mean square errors over all seeds, their standard errors
by bootstrap over the seeds. Seeds by which a robot wanders out of the arena are left out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from distributed import EGO, STARTS, VIEW, squares
from relative import relative_start
from report import publish

from clt.core.arrays import Floats
from clt.core.errors import UsageError
from clt.core.recording import Recording
from clt.estimation import estimators
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

RESAMPLES = 2000


def recorded(seed: int, *, wander: bool) -> Recording | None:
    """A log of the scene; None where a robot leaves the arena."""
    scenario = load_scenario("li-three", {"duration": 60.0, "seed": seed})
    try:
        return simulate(scenario.model_copy(update={"robots": ()}) if wander else scenario)
    except UsageError:
        return None


def errors(recording: Recording, seed: int, particles: int) -> tuple[float, float, float]:
    """Mean squared errors (m^2): complete graph, line, complete graph with other numbers."""
    start = relative_start(recording, EGO, STARTS[1], seed)
    complete: dict[str, object] = {"likelihood": "shared", "particles": particles, "seed": seed}
    line = complete | {"graph": "line", "iterations": 20}
    found = []
    for keys in (complete, line, complete | {"seed": seed + 1000}):
        settings = FilterSettings.model_validate({"dpf": keys})
        posterior = estimators.localize_recording(
            recording, start, settings, estimators.Estimator("dpf", VIEW)
        )
        found.append(float(squares(recording, posterior.poses).mean()))
    return found[0], found[1], found[2]


def ratio(other: Floats, one: Floats) -> tuple[float, float]:
    """Of the root mean squares of squared errors (seeds,), and its standard error."""
    draw = np.random.default_rng(0).integers(0, one.size, (RESAMPLES, one.size))
    spread = np.sqrt(other[draw].mean(axis=1) / one[draw].mean(axis=1))
    return float(np.sqrt(other.mean() / one.mean())), float(spread.std())


def row(scene: str, seeds: int, particles: int) -> str:
    """A line of the table."""
    logs = {k: recorded(k, wander=scene == "wandering") for k in range(1, seeds + 1)}
    made = [errors(log, k, particles) for k, log in logs.items() if log is not None]
    complete, line, again = np.array(made).T
    cells = (
        f"{value:.3f} +- {sigma:.3f}" for value, sigma in map(ratio, (line, again), [complete] * 2)
    )
    return f"| {scene} | {len(made)} | {np.sqrt(complete.mean()):.3f} | {' | '.join(cells)} |"


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--particles", type=int, default=1000)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        (
            f"`li-three` over 60 s, {options.particles:,} shared particles: RMSE of relative"
            " positions on a complete graph with one iteration, and ratios to it."
        ),
        "",
        "| drives | seeds | complete, m | line, 20 iterations / complete | other random numbers |",
        "|---|---|---|---|---|",
        *(row(scene, options.seeds, options.particles) for scene in ("circling", "wandering")),
    ]
    publish(lines, options.out)


if __name__ == "__main__":
    main()
