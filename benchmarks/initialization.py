"""Initialization from motion: layout against its bound, headings from nothing, whole runs.

    python benchmarks/initialization.py [--thu FOLDER] [--out benchmarks/results/initialization.md]

FOLDER holds the Tsinghua run of 18 April 2019 (`clt import thu`). Nothing here starts from the
truth; errors are against the exact truth of the simulation, in whose frame the two static robots
of shi-three and shi-five span the x axis.
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from clt.calibration.apply import apply_calibration, read_calibration
from clt.cli.common import read_filter_settings
from clt.core.arrays import Floats
from clt.core.geometry import wrap_angle
from clt.core.recording import WORLD_FRAME, Poses, Recording
from clt.estimation.pipeline import estimate
from clt.importers.thu import read_thu
from clt.initialization.motion.layout import estimate_layout
from clt.initialization.motion.motion import from_motion
from clt.initialization.pair_distances import PairDistances
from clt.initialization.status import Initialization
from clt.metrics.evaluate import evaluate
from clt.metrics.evaluation import EvaluateOptions
from clt.model.settings import FilterSettings
from clt.ranging.recover import range_packets
from clt.sim.motion import drive_paths
from clt.sim.scenario import Scenario, load_scenario
from clt.sim.simulate import simulate, simulate_exact
from clt.sim.team import team_members

HERE = Path(__file__).parent
DEFAULTS = FilterSettings()


def layout_table(runs: int) -> list[str]:
    """Position error of a layout from a second of ranges, relative to its bound."""
    rows = ["| robots | RMS error, m | bound, m | ratio | worst, m |", "|---|---|---|---|---|"]
    for n in (4, 5, 10):
        rng = np.random.default_rng(n)
        a, b = np.triu_indices(n, 1)
        sigma = np.full(a.size, 0.01)
        squared, bound, worst = 0.0, 0.0, 0.0
        for _ in range(runs):
            points = spread_out(n, rng)
            whole = np.hypot(*(points[a] - points[b]).T)
            measured = whole + sigma * rng.normal(size=a.size)
            found = estimate_layout(PairDistances(a, b, measured, sigma), n, {})
            error = found.position - points
            squared += float(np.sum(error**2)) / n / runs
            bound += (
                float(
                    np.trace(estimate_layout(PairDistances(a, b, whole, sigma), n, {}).covariance)
                )
                / n
                / runs
            )
            worst = max(worst, float(np.max(np.hypot(*error.T))))
        rms, least = squared**0.5, bound**0.5
        rows.append(f"| {n} | {rms:.4f} | {least:.4f} | {rms / least:.3f} | {worst:.3f} |")
    return rows


def spread_out(n: int, rng: np.random.Generator) -> Floats:
    """Robots in 12 m x 12 m, the first two 12 m apart on the x axis, the others off it by 1 m.

    On the axis itself a robot's y has no bound that any method could reach: it is a square root.
    """
    points = rng.uniform((0.0, 1.0), 12.0, (n, 2))
    points[:2] = [[0.0, 0.0], [12.0, 0.0]]
    return points


def starts(scenario: Scenario) -> dict[str, Floats]:
    """True poses (3,) at the start."""
    return {
        name: np.array([path.x[0], path.y[0], path.heading[0]])
        for name, path in drive_paths(scenario, team_members(scenario)).items()
    }


def start_errors(scenario: Scenario, found: Initialization) -> tuple[list[Floats], list[float]]:
    """Errors (x, y, heading) and NEES per dimension of every robot; NaN for one not initialized."""
    errors, nees = [], []
    for name, true in starts(scenario).items():
        robot = found.robots[name]
        if robot.status != "ok" or robot.pose is None:
            errors.append(np.full(3, np.nan))
            continue
        e = np.append(robot.pose.mean[:2] - true[:2], wrap_angle(robot.pose.mean[2:] - true[2:]))
        errors.append(e)
        nees.append(float(e @ np.linalg.solve(robot.pose.covariance, e)) / 3.0)
    return errors, nees


def right(error: Floats) -> bool:
    """The pose is the true one, not a mirror image or another mode."""
    return bool(np.hypot(error[0], error[1]) < 0.3 and abs(error[2]) < 0.3)


def heading_table(seeds: int) -> list[str]:
    """Robots that drive at once, headings uniform in +-pi, no standstill and no straight drive."""
    rows = ["| log | starts | right | RMS heading, rad | ANEES/dim |", "|---|---|---|---|---|"]
    for seconds in (4.0, 20.0):
        errors: list[Floats] = []
        scores: list[float] = []
        for seed in range(1, seeds + 1):
            scenario = load_scenario("shi-sim", {"seed": seed, "duration": seconds})
            found = from_motion(replace(simulate(scenario), truth={}), DEFAULTS)
            e, nees = start_errors(scenario, found)
            errors += e
            scores += nees
        good = [e for e in errors if right(e)]
        rms = float(np.sqrt(np.mean([e[2] ** 2 for e in good])))
        rows.append(
            f"| {seconds:g} s | {len(errors)} | {len(good)} | {rms:.3f} | {np.mean(scores):.2f} |"
        )
    return rows


SOURCES: dict[str, dict[str, object]] = {"ranges": {}, "raw packets": {"radio": {}}}


def measured(scenario: Scenario) -> Recording:
    """A log of ranges without truth."""
    recording = replace(simulate(scenario), truth={})
    return recording if scenario.radio is None else range_packets(recording).recording


def start_table(logs: int) -> list[str]:
    """How honest the covariance of the start is: mean over logs, with its standard error.

    All robots of a log share the error of one baseline, so logs count, not robots.
    """
    rows = [
        "| scenario | from | logs | right | ANEES/dim | RMS position, m | RMS heading, rad |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, source in itertools.product(("shi-three", "shi-five"), SOURCES):
        errors: list[Floats] = []
        means: list[float] = []
        for seed in range(1, logs + 1):
            keys = {"duration": 40.0, "seed": seed, **SOURCES[source]}
            scenario = load_scenario(name, keys)
            found = from_motion(measured(scenario), DEFAULTS)
            e, nees = start_errors(scenario, found)
            errors += e
            means.append(float(np.mean(nees)))
        x, y, heading = np.sqrt(np.nanmean(np.square(errors), axis=0))
        spread = float(np.std(means, ddof=1)) / logs**0.5
        rows.append(
            f"| {name} | {source} | {logs} | {sum(right(e) for e in errors)} of {len(errors)} | "
            f"{np.mean(means):.2f} +- {spread:.2f} | {np.hypot(x, y):.4f} | {heading:.4f} |"
        )
    return rows


def run_errors(scenario: Scenario) -> tuple[list[bool], list[float], float, float]:
    """One log: robots right at the start, NEES there; position, heading RMSE over the run."""
    recording = measured(scenario)
    found = from_motion(recording, DEFAULTS)
    errors, nees = start_errors(scenario, found)
    made = estimate(recording, found.start, DEFAULTS).recording
    team = evaluate(
        replace(made, truth=simulate_exact(scenario).truth), EvaluateOptions(align="none")
    )
    score = team.as_dict("")["team"]["estimate"]
    return [right(e) for e in errors], nees, score["ape"]["rmse"], score["heading"]["rmse"]


def run_table(seeds: int) -> list[str]:
    """The paper's experiments, from ranges and from raw packets."""
    columns = ("scenario", "from", "seeds", "right at the start", "ANEES/dim there",
               "position RMSE, m", "worst seed", "heading RMSE, rad", "worst seed")  # fmt: skip
    rows = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    for name, source in itertools.product(("shi-three", "shi-five"), SOURCES):
        keys = {"sensors.truth.rate": 20.0, **SOURCES[source]}
        runs = [
            run_errors(load_scenario(name, {**keys, "seed": seed})) for seed in range(1, seeds + 1)
        ]
        good = [one for run in runs for one in run[0]]
        nees = np.mean([one for run in runs for one in run[1]])
        position, heading = (np.array([run[k] for run in runs]) for k in (2, 3))
        rows.append(
            f"| {name} | {source} | {seeds} | {sum(good)} of {len(good)} | {nees:.2f} | "
            f"{position.mean():.4f} | {position.max():.4f} | "
            f"{heading.mean():.4f} | {heading.max():.4f} |"
        )
    return rows


def thu_table(folder: Path) -> list[str]:
    """The real run, with surveyed static positions and in Shi's own frame."""
    settings = read_filter_settings(HERE / "thu.toml", [])
    recording = apply_calibration(read_thu(folder), read_calibration(HERE / "thu_calibration.toml"))
    rows = [
        "| frame | align | APE RMSE, m | heading RMSE, rad | dead reckoning: m | rad |",
        "|---|---|---|---|---|---|",
    ]
    for text, log in (
        ("surveyed static positions", surveyed(recording)),
        ("Shi's, from ranges", unknown(surveyed(recording))),
    ):
        found = from_motion(replace(log, truth={}), settings)
        made = estimate(log, found.start, settings).recording
        for align in ("anchors", "se2"):
            team = evaluate(made, EvaluateOptions(align=align))
            best, lost = team.estimate.team, team.dead_reckoning.team
            assert best is not None
            assert best.heading is not None
            assert lost is not None
            assert lost.heading is not None
            rows.append(
                f"| {text} | {align} | {best.ape.rmse:.3f} | {best.heading.rmse:.3f} | "
                f"{lost.ape.rmse:.3f} | {lost.heading.rmse:.3f} |"
            )
    return rows


def surveyed(recording: Recording) -> Recording:
    """The recording with the survey as the truth of the static robots."""
    span = next(iter(recording.truth.values())).stamp
    truth = dict(recording.truth)
    for robot in recording.team.static:
        if robot.position is not None:
            x, y = (np.full(span.size, value) for value in robot.position)
            truth[robot.name] = Poses(WORLD_FRAME, span, span, x, y, np.zeros(span.size))
    return replace(recording, truth=truth)


def unknown(recording: Recording) -> Recording:
    """The recording of a team that knows no position."""
    robots = tuple(replace(robot, position=None) for robot in recording.team.robots)
    return replace(recording, team=replace(recording.team, robots=robots))


def main() -> None:
    """Run the studies and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=300, help="of the layout")
    parser.add_argument("--seeds", type=int, default=30, help="of the paper's experiments")
    parser.add_argument("--starts", type=int, default=100, help="logs of three robots each")
    parser.add_argument("--logs", type=int, default=60, help="of 40 s of the paper's experiments")
    parser.add_argument("--thu", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    parts = [
        "# Initialization from motion",
        f"## Layout from 1 s of ranges (100 Hz, sigma 0.1 m), {options.runs} runs\n",
        *layout_table(options.runs),
        "\n## Unknown headings: shi-sim, robots that drive at once, two known static robots\n",
        *heading_table(options.starts),
        "\n## Covariance of the start: 40 s of the paper's experiments\n",
        *start_table(options.logs),
        "\n## The paper's experiments: 300 s from nothing known\n",
        *run_table(options.seeds),
    ]
    if options.thu is not None:
        parts += [
            "\n## Tsinghua run of 18 April 2019, from its own ranges\n",
            *thu_table(options.thu),
        ]
    text = "\n".join(parts) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
