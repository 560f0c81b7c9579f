"""Outliers of ranges on shi-sim, alone and in bursts, with default settings, over many seeds.

    python benchmarks/outliers.py [--seeds 50] [--first 2001] [--out benchmarks/results/outliers.md]

The noise of every log is estimated from that log (`clt.estimation.noise`), from starts drawn from
their covariance (0.01 m, 0.01 rad) and, in the last rows, from starts of one robot that are 3 m and
1 rad off. The gate of 16 with the noise as stated stands beside.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from shi_sim import drawn, errors

from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.estimation.estimators import localize_recording
from clt.estimation.noise.estimate import estimate_noise
from clt.initialization.given.truth import from_truth
from clt.model.problem import WORLD_FRAME_SPEC
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

SIGMA = (0.01, 0.01, 0.01)
FIFTH = {"outliers.share": 0.2}
CASES = {
    "clean": {},
    "20 %, mean 1 m, alone": FIFTH,
    "20 %, mean 1 m, bursts of 3 s": {**FIFTH, "outliers.burst": 3.0},
    "20 %, mean 0.3 m, bursts of 3 s": {**FIFTH, "outliers.burst": 3.0, "outliers.mean": 0.3},
}
LOST_M = 0.5
"""A robot is lost whose error in the last third of a log is beyond this."""


def score(recording: Recording, start: Start, settings: FilterSettings) -> tuple[float, float, int]:
    """Mean square error (m^2) and ANEES per dimension over robots; searches that replaced one."""
    posterior = localize_recording(recording, start, settings)
    squares, nees = [], []
    for name, poses in posterior.poses.items():
        e, P = errors(poses, recording.truth[name]), poses.covariance
        assert P is not None
        squares.append(np.mean(e[:, 0] ** 2 + e[:, 1] ** 2))
        nees.append(np.mean(np.einsum("ni,ni->n", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])))
    found = sum(one.kind == "robot_found" for one in posterior.diagnostics)
    return float(np.mean(squares)), float(np.mean(nees)) / 3.0, found


def lost(recording: Recording, start: Start, settings: FilterSettings, name: str) -> bool:
    """Whether a robot that starts elsewhere is still there in the end."""
    poses = localize_recording(recording, start, settings).poses[name]
    e = errors(poses, recording.truth[name])
    last = e[2 * e.shape[0] // 3 :]
    return bool(np.sqrt(np.mean(last[:, 0] ** 2 + last[:, 1] ** 2)) > LOST_M)


def moved(start: Start, seed: int) -> tuple[Start, str]:
    """The start with its last robot 3 m and 1 rad elsewhere."""
    name = max(start.poses)
    draw = np.random.default_rng([seed, 7])
    angle = draw.uniform(0.0, 2.0 * np.pi)
    shift = np.array([3.0 * np.cos(angle), 3.0 * np.sin(angle), draw.choice([-1.0, 1.0])])
    pose = start.poses[name]
    wrong = InitialPose(pose.mean + shift, pose.covariance)
    return replace(start, poses={**start.poses, name: wrong}), name


def row(case: str, seeds: range) -> str:
    """One line of the table."""
    found: dict[str, list[tuple[float, float, int]]] = {"clt": [], "gate": []}
    gone = 0
    for seed in seeds:
        recording = simulate(load_scenario("shi-sim", {"seed": seed, **CASES[case]}))
        start = drawn(from_truth(recording, SIGMA), seed)
        noise = estimate_noise(recording, start, FilterSettings(), WORLD_FRAME_SPEC)
        found["clt"].append(score(recording, start, noise.settings))
        found["gate"].append(score(recording, start, FilterSettings(gate=16.0)))
        wrong, name = moved(start, seed)
        noise = estimate_noise(recording, wrong, FilterSettings(), WORLD_FRAME_SPEC)
        gone += lost(recording, wrong, noise.settings, name)
    cells = []
    for runs in found.values():
        square, honest, taken = np.array(runs).T
        mean = np.sqrt(np.mean(square))
        error = np.std(square) / np.sqrt(square.size) / (2.0 * mean)
        cells.append(f"{100 * mean:.2f} +- {100 * error:.2f} | {honest.mean():.2f}")
        cells.append(f"{int(taken.sum())}")
    return f"| {case} | {' | '.join(cells)} | {gone} of {len(seeds)} |"


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--first", type=int, default=2001)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.seeds)
    lines = [
        f"shi-sim, 300 s, seeds {seeds[0]} to {seeds[-1]}, noise from the log and a gate of 16",
        "(`python benchmarks/outliers.py`): position RMSE in cm with its standard error, ANEES per",
        "dimension (1 expected), robots that a search replaced; and how many starts of one robot",
        "that are 3 m and 1 rad off stay lost with the first.",
        "",
        "| outliers | clt, cm | ANEES | replaced | gate 16, cm | ANEES | replaced | lost |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for case in CASES:
        lines.append(row(case, seeds))
        print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
