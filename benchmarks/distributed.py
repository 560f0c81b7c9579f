"""Li's distributed particle filter: accuracy beside bytes, time per robot, the paper's figures.

    python benchmarks/distributed.py [--seeds 30] [--only accuracy|cost] [--table FILE] [--out DIR]

Scene: `li-three`, R1's relative poses of R2 and R3, every initial pose off by a draw from the
covariance that the filters are given. Over 60 s the drives of the scene go on in circles
("circling"), or all three wander in the arena. Distances are root mean square over both neighbours,
time and seeds. `--out` gets the pictures: error over time beside dead reckoning (the paper's
Fig. 8), time against particles (Fig. 9).
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from distributed_cost import costs, tables
from distributed_figures import draw_costs, draw_errors
from relative import relative_start, relative_truth

from clt.core.arrays import Floats
from clt.core.recording import Poses, Recording
from clt.estimation import estimators
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

EGO = "R1"
VIEW = FrameSpec("ego", (EGO,))
STARTS = ((0.1, 0.03), (0.3, 0.06), (0.5, 0.12))
STEP = 0.1
"""Outputs of the scene, s."""
SHARED: dict[str, object] = {"likelihood": "shared", "particles": 200}
CENTRAL: dict[str, dict[str, object]] = {
    "centralized, 200 particles": {"kind": "sir", "particles": 200},
    "centralized, 5,000 particles": {"kind": "sir", "particles": 5000},
}
DISTRIBUTED: dict[str, dict[str, object]] = {
    "dpf, default settings": {},
    "dpf, default, line, S = 1": {"graph": "line"},
    "dpf, default, line, S = 20": {"graph": "line", "iterations": 20},
    "dpf, shared, 200 particles (the paper's)": SHARED,
    "dpf, shared, 200, line, S = 1": SHARED | {"graph": "line"},
    "dpf, shared, 200, line, S = 5": SHARED | {"graph": "line", "iterations": 5},
    "dpf, shared, 200, line, S = 20": SHARED | {"graph": "line", "iterations": 20},
    "dpf, default, 20 % of messages lost": {"loss": 0.2},
    "own ranges only": {"iterations": 0},
}
PAPERS, DEFAULT = "dpf, shared, 200 particles (the paper's)", "dpf, default settings"


@dataclass
class Scores:
    """Of one filter over the seeds."""

    square: list[Floats] = field(default_factory=list)
    """Mean of both neighbours' squared distance errors at each output, (T,), one per seed."""
    sent: list[float] = field(default_factory=list)
    """Bytes that the busiest robot sends in a second, one per seed."""

    @property
    def rmse(self) -> float:
        """Over time and seeds, m."""
        return float(np.sqrt(np.mean(self.square)))

    @property
    def over_time(self) -> Floats:
        """Over the seeds, m, (T,)."""
        error: Floats = np.sqrt(np.mean(self.square, axis=0))
        return error


def squares(recording: Recording, estimate: Mapping[str, Poses]) -> Floats:
    """Squared distance errors of both neighbours, their mean at each output."""
    found = []
    for name, poses in estimate.items():
        truth = relative_truth(recording, EGO, name, poses.stamp)
        found.append((poses.x - truth[:, 0]) ** 2 + (poses.y - truth[:, 1]) ** 2)
    mean: Floats = np.mean(found, axis=0)
    return mean


def study(
    overrides: Mapping[str, object], sigma: tuple[float, float], seeds: int, *, wander: bool
) -> dict[str, Scores]:
    """Every filter over the seeds of a scene."""
    scores: dict[str, Scores] = {}
    for seed in range(1, seeds + 1):
        scenario = load_scenario("li-three", {**overrides, "seed": seed})
        recording = simulate(scenario.model_copy(update={"robots": ()}) if wander else scenario)
        start = relative_start(recording, EGO, sigma, seed)
        reckoned = estimators.dead_reckon_recording(recording, start, FilterSettings(), VIEW)
        own = scores.setdefault("dead reckoning", Scores())
        own.square.append(squares(recording, reckoned))
        cases = [("pf", name, own_settings) for name, own_settings in CENTRAL.items()]
        cases += [("dpf", name, own_settings) for name, own_settings in DISTRIBUTED.items()]
        for kind, name, own_settings in cases:
            settings = FilterSettings.model_validate({kind: own_settings | {"seed": seed}})
            posterior = estimators.localize_recording(
                recording, start, settings, estimators.Estimator(kind, VIEW)
            )
            own = scores.setdefault(name, Scores())
            own.square.append(squares(recording, posterior.poses))
            busiest = max((r["bytes_sent"] for r in posterior.traffic.values()), default=0)
            own.sent.append(busiest / scenario.duration)
    return scores


def accuracy(seeds: int) -> tuple[list[str], dict[str, Scores]]:
    """The table of errors, and the scores of the paper's own case."""
    short = {sigma: study({}, sigma, seeds, wander=False) for sigma in STARTS}
    long = {
        name: study({"duration": 60.0}, STARTS[1], seeds, wander=name == "wandering")
        for name in ("circling", "wandering")
    }
    columns = [f"15 s, {sigma[0]} / {sigma[1]}" for sigma in STARTS]
    columns += [f"60 s, {name}" for name in long]
    runs = [*short.values(), *long.values()]
    lines = [
        (
            f"`li-three`, {seeds} seeds, RMSE of relative positions in m; initial errors in m / rad"
            " (0.3 / 0.06 over 60 s). Bytes are those that the busiest robot sends in a second,"
            " odometry (40 bytes a sample) included, over 60 s circling."
        ),
        "",
        f"| filter | {' | '.join(columns)} | bytes/s |",
        "|" + "---|" * (len(columns) + 2),
    ]
    for name in runs[0]:
        cells = [f"{run[name].rmse:.3f}" for run in runs]
        sent = long["circling"][name].sent
        cost = f"{np.mean(sent):,.0f}" if name in DISTRIBUTED else ""
        lines.append(f"| {name} | {' | '.join(cells)} | {cost} |")
    return lines, short[STARTS[1]]


def main() -> None:
    """Run the studies, print their tables, draw their pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--only", choices=("accuracy", "cost"))
    parser.add_argument("--table", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines: list[str] = []
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
    if options.only != "cost":
        table, scores = accuracy(options.seeds)
        lines += [*table, ""]
        if options.out is not None:
            shown = {name: scores[name].over_time for name in ("dead reckoning", PAPERS, DEFAULT)}
            draw_errors(options.out / "error.png", STEP, shown)
    if options.only != "accuracy":
        measured = costs()
        lines += tables(measured)
        if options.out is not None:
            draw_costs(options.out / "time.png", measured)
    text = "\n".join(lines)
    print(text)
    if options.table is not None:
        options.table.write_text(text)


if __name__ == "__main__":
    main()
