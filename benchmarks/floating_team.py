"""Consistency where fewer than two robots stand still: latest against first-estimates Jacobians.

    python benchmarks/floating_team.py [--seeds 30] [--out benchmarks/results/floating_team.md]

Fig. 3 of Shi: shi-sim with one static robot, and without ranges to static robots.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from clt.filters import world
from clt.filters.settings import FilterSettings
from clt.geometry import wrap
from clt.init.truth import from_truth
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.streams import Recording

CASES = {
    "two static": {},
    "one static": {"team.static": 1},
    "no static ranges": {"sensors.range.pairs": "moving-moving"},
}


def score(recording: Recording, jacobians: str) -> tuple[float, float, float]:
    """Mean squared position error (m^2) and heading error (rad^2), mean NEES, after 10 s."""
    settings = FilterSettings.model_validate({"jacobians": jacobians})
    posterior = world.localize(recording, from_truth(recording, settings.initial.sigma), settings)
    rows = []
    for name, poses in posterior.poses.items():
        truth = recording.truth[name]
        e = np.stack(
            [poses.x - truth.x, poses.y - truth.y, wrap(poses.heading - truth.heading)], axis=1
        )[200:]
        P = np.asarray(poses.covariance)[200:]
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
        rows.append([np.mean(np.sum(e[:, :2] ** 2, axis=1)), np.mean(e[:, 2] ** 2), nees.mean()])
    position, heading, nees = np.mean(rows, axis=0)
    return float(position), float(heading), float(nees)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        f"shi-sim, {options.seeds} seeds of 300 s (`python benchmarks/floating_team.py`):",
        "",
        "| static robots | Jacobians | position RMSE, m | heading RMSE, rad | ANEES / dimension |",
        "|---|---|---|---|---|",
    ]
    for case, overrides in CASES.items():
        for jacobians in ("latest", "first"):
            scores = [
                score(simulate(load_scenario("shi-sim", {**overrides, "seed": seed})), jacobians)
                for seed in range(1, options.seeds + 1)
            ]
            position, heading, nees = np.mean(scores, axis=0)
            lines.append(
                f"| {case} | {jacobians} | {np.sqrt(position):.3f} | {np.sqrt(heading):.4f} "
                f"| {nees / 3:.2f} |"
            )
    text = "\n".join(lines) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
