"""Two real pairs of TurtleBot4, each robot in the other's frame, against dead reckoning.

    python benchmarks/real_pairs.py DATA [--out benchmarks/results/real_pairs.md]

DATA holds the folders tiers_pair_20220907 and vub_tb4_relative of the public data sets (see
`clt import --list`). Starts from the truth, calibrations of this folder. Distance is the norm of
the position error of T_ji, root mean square over the run.
"""

from __future__ import annotations

import argparse
from math import degrees
from pathlib import Path

from clt.calibration import apply, read_calibration
from clt.filters.settings import FilterSettings
from clt.filters.space import View
from clt.filters.world import Estimator
from clt.importers import FORMATS
from clt.init.truth import from_truth
from clt.metrics.evaluate import evaluate
from clt.metrics.scores import Score
from clt.pipeline import estimate
from clt.streams import Recording

HERE = Path(__file__).parent
LOGS = {
    "TIERS, 44 s": ("tiers", "tiers_pair_20220907", "tiers_calibration.toml"),
    "VUB exp4, 220 s": ("vub", "vub_tb4_relative/exp4", "vub_calibration.toml"),
}
FILTERS = ("ekf", "ukf", "pf", "mixture")


def read(data: Path, form: str, path: str, calibration: str) -> Recording:
    """One log, calibrated."""
    return apply(FORMATS[form].read(data / path), read_calibration(HERE / calibration))


def row(log: str, recording: Recording, ego: str, other: str) -> str:
    """One line of the table: dead reckoning, then every filter."""
    settings = FilterSettings()
    start = from_truth(recording, settings.initial.sigma)
    cells = []
    for name in FILTERS:
        made = estimate(recording, start, settings, Estimator(name, View("ego", (ego,))))
        scored = evaluate(made.recording)
        if len(cells) == 0:
            cells.append(cell(scored.dead_reckoning.scores[other]))
        cells.append(cell(scored.estimate.scores[other]))
    return f"| {log} | {other} in {ego} | {' | '.join(cells)} |"


def cell(score: Score) -> str:
    """Distance in m and heading in degrees."""
    heading = "?" if score.heading is None else f"{degrees(score.heading.rmse):.2f}"
    return f"{score.ape.rmse:.3f} / {heading}"


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
    text = "\n".join(lines) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text)


if __name__ == "__main__":
    main()
