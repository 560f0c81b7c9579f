"""Araki's Tables I and II: relative poses of two and of five cars, by every filter.

    python benchmarks/araki.py [--seeds 30] [--only two|five] [--out benchmarks/results/araki.md]

The paper publishes neither its trajectories nor its initial errors, so its figures stand beside
ours only for their order of magnitude: the scenes are `araki-*`, initial errors are drawn for every
seed from the covariance that the filters are given. Distances are the norm of the position
error of T_j1, root mean square over a run, mean over the seeds; the bound is the posterior
Cramer-Rao bound for the packets that arrived. "real" adds what the scene's note calls realistic:
scale errors of 3 %, biases of 0.03 rad/s, delays of 84 +- 71 ms, clocks off by 2 +- 9 ms, batches
of 30 ms; the filters then estimate scale and bias (`noise.scale`, `noise.bias`).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from relative import RelativeScore, bound, relative_start, score_bound, score_estimate

from clt.core.recording import Recording
from clt.estimation import estimators
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import Scenario, load_scenario
from clt.sim.simulate import simulate, simulate_exact

EGO = "car1"
VIEW = FrameSpec("ego", (EGO,))
SCENES = {
    "two left turns": "araki-left-turns",
    "left turn and straight": "araki-left-straight",
    "both straight": "araki-straight",
    "semicircles": "araki-semicircles",
}
STARTS = ((0.3, 0.2), (1.0, 0.5))
FILTERS = ("ekf", "ukf", "pf", "mixture")
REAL = {
    "sensors.odometry.scale_sd": 0.03,
    "sensors.odometry.bias_sd": 0.03,
    "network.delay_mean": 0.084,
    "network.delay_sd": 0.071,
    "network.clock_mean": 0.002,
    "network.clock_sd": 0.009,
    "network.batch": 0.03,
}
IDEAL_SETTINGS = FilterSettings()
REAL_SETTINGS = FilterSettings.model_validate({"noise": {"scale": 0.03, "bias": 0.03}})
PAPER_TWO = {
    "two left turns": "0.26 / 0.26 / 0.25",
    "left turn and straight": "0.41 / 0.80 / 0.85",
    "both straight": "0.32 / 0.29 / 0.33",
    "semicircles": "0.33 / 0.29 / 0.33",
}
PAPER_FIVE = {
    "pf": ((0.31, 0.43, 0.26, 0.44), (0.22, 0.20, 0.24, 0.38)),
    "ukf": ((0.26, 0.20, 0.29, 0.32), (0.20, 0.18, 0.17, 0.16)),
    "ekf": ((0.36, 0.80, 0.64, 0.59), (0.14, 0.18, 0.29, 0.34)),
}

Scores = dict[str, list[dict[str, RelativeScore]]]
"""By filter, `bound` and `dead reckoning`: one mapping from car to score per seed."""


def arrived(perfect: Recording, recording: Recording) -> Recording:
    """The rows of a perfect log that the real one has, too."""
    ranges, seen = perfect.ranges, recording.ranges
    size = len(recording.team.robots)
    key = [(r.stamp * size + r.source) * size + r.target for r in (ranges, seen)]
    keep = np.isin(*key)
    odometry = {
        name: replace(
            stream,
            **{
                column: values[np.isin(stream.stamp, recording.odometry[name].stamp)]
                for column, values in vars(stream).items()
            },
        )
        for name, stream in perfect.odometry.items()
    }
    thinned = replace(ranges, **{column: values[keep] for column, values in vars(ranges).items()})
    return replace(perfect, odometry=odometry, ranges=thinned)


def run(
    scenario: Scenario, sigma: tuple[float, float], settings: FilterSettings, *, bounded: bool
) -> dict[str, dict[str, RelativeScore]]:
    """All filters on one log from one drawn start."""
    recording = simulate(scenario)
    start = relative_start(recording, EGO, sigma, scenario.seed)
    result = {}
    for name in FILTERS:
        poses = estimators.localize_recording(
            recording, start, settings, estimators.Estimator(name, VIEW)
        ).poses
        result[name] = {car: score_estimate(recording, poses[car], car) for car in poses}
    reckoned = estimators.dead_reckon_recording(recording, start, settings, VIEW)
    result["dead reckoning"] = {
        car: score_estimate(recording, reckoned[car], car) for car in reckoned
    }
    if bounded:
        perfect = arrived(simulate_exact(scenario), recording)
        sure = relative_start(perfect, EGO, sigma, None)
        best = bound(perfect, sure, settings, VIEW).poses
        result["bound"] = {car: score_bound(best[car]) for car in best}
    return result


def study(
    name: str,
    overrides: Mapping[str, object],
    sigma: tuple[float, float],
    settings: FilterSettings,
    seeds: int,
) -> Scores:
    """Every filter over the seeds of a scene."""
    scores: Scores = {}
    for seed in range(1, seeds + 1):
        scenario = load_scenario(name, {**overrides, "seed": seed})
        found = run(scenario, sigma, settings, bounded=len(overrides) == 0)
        for key, value in found.items():
            scores.setdefault(key, []).append(value)
    return scores


def mean(scores: Scores, key: str, what: str, cars: Sequence[str]) -> float:
    """Mean of a score over seeds and cars; NaN where there is none."""
    rows = [getattr(one[car], what) for one in scores.get(key, []) for car in cars]
    return float(np.mean(rows)) if len(rows) > 0 else float("nan")


def pair(scores: Scores, key: str, cars: Sequence[str]) -> str:
    """Distance and heading as a cell."""
    distance, heading = (mean(scores, key, what, cars) for what in ("distance", "heading"))
    return f"{distance:.3f} / {heading:.3f}"


def two_cars(seeds: int) -> list[str]:
    """Table I, and what larger initial errors do."""
    columns = ("bound", *FILTERS, "dead reckoning")
    lines = [
        (
            f"Two cars, {seeds} seeds (`python benchmarks/araki.py --only two`). Distance RMSE in "
            "m / heading RMSE in rad; the paper's distances are PF / UKF / EKF."
        ),
        "",
        f"| scene | start, m / rad | {' | '.join(columns)} | best / bound | paper |",
        "|" + "---|" * (len(columns) + 4),
    ]
    cases = [({}, sigma, IDEAL_SETTINGS) for sigma in STARTS]
    cases.append((REAL, (0.3, 0.2), REAL_SETTINGS))
    for scene, name in SCENES.items():
        for overrides, sigma, settings in cases:
            scores = study(name, overrides, sigma, settings, seeds)
            cells = [pair(scores, key, ["car2"]) if key in scores else "" for key in columns]
            best = min(mean(scores, key, "distance", ["car2"]) for key in FILTERS)
            least = mean(scores, "bound", "distance", ["car2"])
            ratio = f"{best / least:.2f}" if "bound" in scores else ""
            real = " real" if len(overrides) > 0 else ""
            lines.append(
                f"| {scene} | {sigma[0]} / {sigma[1]}{real} | {' | '.join(cells)} | {ratio} "
                f"| {PAPER_TWO[scene]} |"
            )
            print(lines[-1], flush=True)
    return lines


def five_cars(seeds: int) -> list[str]:
    """Table II."""
    cars = [f"car{k}" for k in range(2, 6)]
    lines = [
        (
            f"Five cars crossing, start 0.3 m / 0.2 rad, {seeds} seeds "
            "(`python benchmarks/araki.py --only five`). Distance RMSE in m / heading RMSE in rad."
        ),
        "",
        "| log | filter | T21 | T31 | T41 | T51 | mean |",
        "|---|---|---|---|---|---|---|",
    ]
    logs: tuple[tuple[str, dict[str, object], FilterSettings], ...] = (
        ("ideal", {}, IDEAL_SETTINGS),
        ("real", dict(REAL), REAL_SETTINGS),
        ("real, errors not estimated", dict(REAL), IDEAL_SETTINGS),
    )
    for log, overrides, settings in logs:
        scores = study("araki-five", overrides, (0.3, 0.2), settings, seeds)
        for key in scores:
            cells = [pair(scores, key, [car]) for car in cars]
            lines.append(f"| {log} | {key} | {' | '.join(cells)} | {pair(scores, key, cars)} |")
    for key, (distance, heading) in PAPER_FIVE.items():
        cells = [f"{d:.2f} / {h:.2f}" for d, h in zip(distance, heading, strict=True)]
        lines.append(
            f"| paper's | {key} | {' | '.join(cells)} | {np.mean(distance):.2f} / "
            f"{np.mean(heading):.2f} |"
        )
    return lines


def main() -> None:
    """Run the studies and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--only", choices=("two", "five"))
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    parts = [
        study_of(options.seeds)
        for name, study_of in (("two", two_cars), ("five", five_cars))
        if options.only in (None, name)
    ]
    text = "\n".join(line for part in parts for line in (*part, ""))
    print(text)
    if options.out is not None:
        options.out.write_text(text)


if __name__ == "__main__":
    main()
