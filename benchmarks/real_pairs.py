"""Real pairs: each robot in the other's frame against dead reckoning; where they start.

    python benchmarks/real_pairs.py DATA [--out benchmarks/results/real_pairs.md]

DATA holds the folders tiers_pair_20220907, vub_tb4_relative and thu_rcl_20190418 of the public data
sets (see `clt import --list`). Calibrations are those of this folder; filters start from the truth.
Distance is the norm of the position error of T_ji, root mean square over the run.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from math import degrees
from pathlib import Path

import numpy as np
from report import publish

from clt.calibration.apply import apply_calibration, read_calibration
from clt.core.geometry import relative_pose, wrap_angle
from clt.core.recording import Recording
from clt.core.settings import read_toml
from clt.estimation.estimators import Estimator, dead_reckon_recording
from clt.estimation.pipeline import estimate
from clt.importers import IMPORT_FORMATS
from clt.initialization.given.truth import from_truth
from clt.initialization.pairwise.team import from_pairwise
from clt.metrics.associate import as_array, interpolate
from clt.metrics.evaluate import evaluate
from clt.metrics.scores import Score
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings

HERE = Path(__file__).parent
LOGS = {
    "TIERS, 44 s": ("tiers", "tiers_pair_20220907", "tiers_calibration.toml"),
    "VUB exp4, 220 s": ("vub", "vub_tb4_relative/exp4", "vub_calibration.toml"),
}
THU = ("thu", "thu_rcl_20190418", "thu_calibration.toml")
STARTS = {
    "Tsinghua": (THU, None),
    "Tsinghua, `--config benchmarks/thu.toml`": (THU, "thu.toml"),
    "VUB exp4": (LOGS["VUB exp4, 220 s"], None),
    "TIERS": (LOGS["TIERS, 44 s"], None),
}
"""Log and settings of each start."""
SLOW = 1.0
"""Truth is interpolated over so much, s."""
FILTERS = ("ekf", "ukf", "pf", "mixture")


def read(data: Path, form: str, path: str, calibration: str) -> Recording:
    """One log, calibrated."""
    return apply_calibration(
        IMPORT_FORMATS[form].read((data / path,), None), read_calibration(HERE / calibration)
    )


def row(log: str, recording: Recording, ego: str, other: str) -> str:
    """One line of the table: dead reckoning, then every filter."""
    settings = FilterSettings()
    start = from_truth(recording, settings.initial.sigma)
    cells = []
    for name in FILTERS:
        made = estimate(recording, start, settings, Estimator(name, FrameSpec("ego", (ego,))))
        scored = evaluate(made.recording)
        if len(cells) == 0:
            cells.append(cell(scored.dead_reckoning.scores[other]))
        cells.append(cell(scored.estimate.scores[other]))
    return f"| {log} | {other} in {ego} | {' | '.join(cells)} |"


def cell(score: Score) -> str:
    """Distance in m and heading in degrees."""
    heading = "?" if score.heading is None else f"{degrees(score.heading.rmse):.2f}"
    return f"{score.ape.rmse:.3f} / {heading}"


def start_row(log: str, recording: Recording, config: str | None) -> str:
    """What `clt init --method pairwise` says of the first two moving robots, and how far off it is.

    The pose is carried by odometry to the first truth of both, where that begins later.
    """
    keys = {} if config is None else read_toml(HERE / config)
    settings = FilterSettings.model_validate(keys)
    ego, other = (robot.name for robot in recording.team.moving[:2])
    found = from_pairwise(recording, settings, ego)
    status, start = found.robots[other], found.start
    alone = replace(start, hypotheses=())
    track = dead_reckon_recording(recording, alone, settings, FrameSpec("ego", (ego,)))[other]
    begin = max(recording.truth[name].stamp[0] for name in (ego, other))
    k = int(np.searchsorted(track.stamp, begin))
    seen, pose = (
        interpolate(recording.truth[name], track.stamp[k : k + 1], SLOW)[1][0]
        for name in (ego, other)
    )
    d = as_array(track)[k] - relative_pose(seen, pose)
    sigma = np.sqrt(status.pose.covariance.diagonal()) if status.pose is not None else np.zeros(3)
    return (
        f"| {log} | {other} in {ego} | {status.status}, {status.probability:.3f} | "
        f"{np.hypot(d[0], d[1]):.2f} m, {abs(degrees(float(wrap_angle(d[2])))):.1f} deg | "
        f"{sigma[0]:.2f} m, {sigma[1]:.2f} m, {degrees(sigma[2]):.1f} deg |"
    )


def main() -> None:
    """Run every filter on every pair and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    lines = [
        "Distance RMSE in m / heading RMSE in degrees (`python benchmarks/real_pairs.py DATA`).",
        "",
        f"| log | pose | dead reckoning | {' | '.join(FILTERS)} |",
        "|" + "---|" * (len(FILTERS) + 3),
    ]
    for log, (form, path, calibration) in LOGS.items():
        recording = read(options.data, form, path, calibration)
        first, second = (robot.name for robot in recording.team.moving)
        lines += [
            row(log, recording, ego, other) for ego, other in ((first, second), (second, first))
        ]
    lines += [
        "",
        "Where pairs start (`clt init --method pairwise`), from ranges and odometry alone:",
        "",
        "| log | pose | status, probability | error | stated sigma of x, y, heading |",
        "|---|---|---|---|---|",
        *(
            start_row(log, read(options.data, *where), config)
            for log, (where, config) in STARTS.items()
        ),
    ]
    publish(lines, options.out)


if __name__ == "__main__":
    main()
