"""Freeman's study of the EKF and the UKF on mutual transforms, against what is possible at all.

    python benchmarks/freeman.py [--seeds 30] [--out benchmarks/results/freeman.md]

Scenario `freeman`: 12 s, two robots that drive at random, input noise 0.22 m/s and rad/s, ranges of
0.32 m. mu_0 is off by a draw from N(0, error^2), the filters are given Sigma_0. A run has diverged
when T21 is off by more than 1 m, or its heading by more than 0.8 rad, root mean square over the
last two seconds. So much noise makes some runs of any filter stray: what counts is the distance to
the 20,000-particle filter and to the Cramer-Rao bound. The paper publishes neither its mu_0, nor
its trajectories, nor when it calls a run diverged.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from relative import RelativeScore, bound, relative_start, score_bound, score_estimate
from report import publish

from clt.estimation import estimators
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact

MUTUAL, EGO = FrameSpec("mutual", ("R1", "R2")), FrameSpec("ego", ("R1",))
SETTINGS = FilterSettings.model_validate({"pf": {"kind": "sir", "particles": 20000}})
ESTIMATORS = {
    "EKF": estimators.Estimator("ekf", MUTUAL),
    "UKF": estimators.Estimator("ukf", MUTUAL),
    "mixture": estimators.Estimator("mixture", MUTUAL),
    "PF 20,000": estimators.Estimator("pf", EGO),
}


@dataclass(frozen=True)
class Case:
    """How the filters start: standard deviations in m and rad."""

    name: str
    sigma: tuple[float, float]
    error: tuple[float, float]


CASES = (
    Case("nominal: Sigma_0 = I, error 0.05", (1.0, 1.0), (0.05, 0.05)),
    Case("poor Sigma_0 = 4 I, error 0.05", (2.0, 2.0), (0.05, 0.05)),
    Case("poor mu_0: error 1, Sigma_0 = I", (1.0, 1.0), (1.0, 1.0)),
    Case("poor mu_0: error 2 m, 1 rad, Sigma_0 the same", (2.0, 1.0), (2.0, 1.0)),
)


def run(case: Case, seeds: int) -> tuple[dict[str, list[RelativeScore]], dict[str, float]]:
    """Scores of T21 by filter, and CPU seconds of each filter for all seeds."""
    scores: dict[str, list[RelativeScore]] = {name: [] for name in (*ESTIMATORS, "bound")}
    seconds = dict.fromkeys(ESTIMATORS, 0.0)
    for seed in range(1, seeds + 1):
        scenario = load_scenario("freeman", {"seed": seed})
        recording, perfect = simulate(scenario), simulate_exact(scenario)
        start = relative_start(recording, "R1", case.sigma, seed, case.error)
        for name, estimator in ESTIMATORS.items():
            begin = process_time()
            posterior = estimators.localize_recording(recording, start, SETTINGS, estimator)
            seconds[name] += process_time() - begin
            scores[name].append(score_estimate(recording, posterior.poses["R2"], "R2"))
        # What an error of the size that was drawn leaves, given to the filter.
        sure = relative_start(perfect, "R1", case.error, None)
        best = bound(perfect, sure, SETTINGS, EGO).poses["R2"]
        scores["bound"].append(score_bound(best))
    return scores, seconds


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    recording = simulate(load_scenario("freeman", {"duration": 1.0}))  # Compiles once.
    for estimator in ESTIMATORS.values():
        start = relative_start(recording, "R1", (0.1, 0.1), 0)
        estimators.localize_recording(recording, start, SETTINGS, estimator)
    lines = [
        (
            f"{options.seeds} seeds (`python benchmarks/freeman.py`): position RMSE of T21 in m, "
            "share of diverged runs. The bound is for a filter that knows the size of the initial "
            "error."
        ),
        "",
        f"| start | {' | '.join(ESTIMATORS)} | bound |",
        "|" + "---|" * (len(ESTIMATORS) + 2),
    ]
    spent = dict.fromkeys(ESTIMATORS, 0.0)
    for case in CASES:
        scores, seconds = run(case, options.seeds)
        cells = []
        for name in ESTIMATORS:
            spent[name] += seconds[name]
            distance = np.mean([one.distance for one in scores[name]])
            share = np.mean([one.diverged for one in scores[name]])
            cells.append(f"{distance:.2f}, {share:.0%}")
        least = np.mean([one.distance for one in scores["bound"]])
        lines.append(f"| {case.name} | {' | '.join(cells)} | {least:.2f} |")
        print(lines[-1], flush=True)
    cells = [f"{spent[name] / spent['EKF']:.1f} x" for name in ESTIMATORS]
    lines.append(f"| CPU time of a run, whole call | {' | '.join(cells)} | |")
    publish(lines, options.out)


if __name__ == "__main__":
    main()
