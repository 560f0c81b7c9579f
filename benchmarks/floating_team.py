"""Consistency where fewer than two robots stand still: latest against first-estimates Jacobians.

    python benchmarks/floating_team.py [--seeds 60] [--first 1001] [--out FILE]

Fig. 3 of Shi: shi-sim with one static robot, and without ranges to static robots. Intervals (95 %)
are those of the mean over seeds, of ratios by resampling whole seeds.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import wrap_angle
from clt.core.recording import Recording
from clt.estimation import estimators
from clt.initialization.given.truth import from_truth
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

CASES = {
    "two static": {},
    "one static": {"team.static": 1},
    "no static ranges": {"sensors.range.pairs": "moving-moving"},
}
JACOBIANS = ("latest", "first")
HEAD = (
    "| static robots | Jacobians | position RMSE, m | ratio | heading RMSE, rad "
    "| ANEES / dimension |"
)
DRAWS = 10_000
"""Of the seeds, to find the interval of a ratio."""


def score(recording: Recording, jacobians: str) -> tuple[float, float, float]:
    """Mean squared position error (m^2) and heading error (rad^2), mean NEES, after 10 s."""
    settings = FilterSettings.model_validate({"jacobians": jacobians})
    posterior = estimators.localize_recording(
        recording, from_truth(recording, settings.initial.sigma), settings
    )
    rows = []
    for name, poses in posterior.poses.items():
        truth = recording.truth[name]
        e = np.stack(
            [poses.x - truth.x, poses.y - truth.y, wrap_angle(poses.heading - truth.heading)],
            axis=1,
        )[200:]
        P = np.asarray(poses.covariance)[200:]
        nees = np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
        rows.append([np.mean(np.sum(e[:, :2] ** 2, axis=1)), np.mean(e[:, 2] ** 2), nees.mean()])
    position, heading, nees = np.mean(rows, axis=0)
    return float(position), float(heading), float(nees)


def ratio(figures: Floats) -> tuple[float, float, float]:
    """Position RMSE with first estimates over that with the latest, and its interval.

    `figures`: mean squared errors of (latest, first), shape (2, seeds).
    """
    drawn = np.random.default_rng(0).integers(figures.shape[1], size=(DRAWS, figures.shape[1]))
    latest, first = figures[:, drawn].mean(axis=2)
    low, high = np.percentile(np.sqrt(first / latest), [2.5, 97.5])
    return float(np.sqrt(figures[1].mean() / figures[0].mean())), float(low), float(high)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=60)
    parser.add_argument("--first", type=int, default=1001)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    lines = [
        f"shi-sim, 300 s, seeds {seeds[0]} to {seeds[-1]}, with 95 % intervals:",
        "",
        HEAD,
        "|---|---|---|---|---|---|",
    ]
    for case, overrides in CASES.items():
        scores = np.empty((2, len(seeds), 3))
        for k, seed in enumerate(seeds):
            recording = simulate(load_scenario("shi-sim", {**overrides, "seed": seed}))
            scores[:, k] = [score(recording, jacobians) for jacobians in JACOBIANS]
        position, low, high = ratio(scores[:, :, 0])
        for jacobians, own in zip(JACOBIANS, scores, strict=True):
            mean, margin = own.mean(axis=0), 1.96 * own.std(axis=0, ddof=1) / np.sqrt(len(seeds))
            compared = f"{position:.2f} ({low:.2f} to {high:.2f})" if jacobians == "first" else "1"
            lines.append(
                f"| {case} | {jacobians} | {np.sqrt(mean[0]):.3f} | {compared} "
                f"| {np.sqrt(mean[1]):.4f} | {mean[2] / 3:.2f} +- {margin[2] / 3:.2f} |"
            )
    text = "\n".join(lines) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
