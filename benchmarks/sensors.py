"""Real logs and simulated sensors that err as real ones do: accuracy and honesty by default.

    python benchmarks/sensors.py --data FOLDER [--out benchmarks/results/sensors.md]

FOLDER holds the public data sets, one folder each, as `docs/how-to/import.md` names them. Each log
is imported, localized and evaluated by the commands that a user would type, with default settings;
the calibration is what a data sheet or a sibling run gives, and nothing comes from the truth of the
log itself but, in the columns that say so, the start.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).parent
GAIN_PLAZA = "[range]\ngain = 0.93493\noffset = 0.0\n"
OFFSET_LABYRINTH = "[range]\noffset = -0.123\n"


@dataclass(frozen=True)
class Log:
    """One log of the table."""

    name: str
    format: str
    path: str
    calibration: Path | str | None
    """A file, its text, or none."""
    frame: str
    lesson: str


LOGS = (
    Log("thu", "thu", "thu_rcl_20190418", HERE / "thu_calibration.toml", "world",
        "range errors depend on the poses and last for seconds; 100 Hz are not independent"),
    Log("thu, not calibrated", "thu", "thu_rcl_20190418", None, "world",
        "offsets of 0.6 m are more than default priors expect"),
    Log("VUB exp4", "vub", "vub_tb4_relative/exp4", HERE / "vub_calibration.toml", "ego:tb2",
        "one pair: outliers are weighed, nothing else can separate them from motion"),
    Log("VUB exp2", "vub", "vub_tb4_relative/exp2", HERE / "vub_calibration.toml", "ego:tb2",
        "visual odometry that jumps: no filter of twists can follow"),
    Log("plaza2", "plaza", "plaza2", GAIN_PLAZA, "world",
        "a gyro bias of 7 sigma of the best class of odometry"),
    Log("plaza2, not calibrated", "plaza", "plaza2", None, "world",
        "ranges 7 % too long need a gain"),
    Log("labyrinth", "labyrinth", "labyrinth_uwb", OFFSET_LABYRINTH, "world",
        "stated noise of odometry is too small"),
    Log("mrclam6", "mrclam", "mrclam6", None, "world",
        "odometry is commands: 7 % too fast, and late"),
    Log("mrclam5a", "pyfg", "pyfg_samples/mrclam5a.pyfg.gz", None, "world",
        "parked robots stand: odometry that says zero is exact"),
    Log("plaza2 (PyFG)", "pyfg", "pyfg_samples/plaza2.pyfg.gz", None, "world",
        "edges state ten times the noise of the wheels"),
    Log("TIERS pair", "tiers", "tiers_pair_20220907", HERE / "tiers_calibration.toml",
        "ego:turtle03", "45 s: too short to learn more than what is stated"),
)  # fmt: skip


def clt(*words: str) -> subprocess.CompletedProcess[str]:
    """Run one command."""
    return subprocess.run(
        [sys.executable, "-m", "clt", *words], capture_output=True, text=True, check=False
    )


def scores(found: dict, who: str) -> str:
    """RMSE (m), heading RMSE (deg) and mean ANEES over robots."""
    robots = [robot[who] for robot in found["robots"].values() if who in robot]
    anees = [robot["anees"] for robot in robots if robot.get("anees") is not None]
    team = found["team"][who]
    heading = team.get("heading") or {}
    degrees = heading.get("rmse")
    turn = "-" if degrees is None else f"{degrees * 57.29578:.1f}"
    honest = f" / {sum(anees) / len(anees):.1f}" if anees else ""
    return f"{team['ape']['rmse']:.3f} / {turn}{honest}"


def row(log: Log, data: Path, folder: Path, filters: tuple[str, ...]) -> str:
    """One line of the table."""
    source, words = folder / "in.mcap", []
    if log.calibration is not None:
        calibration = log.calibration
        if isinstance(calibration, str):
            calibration = folder / "calibration.toml"
            calibration.write_text(str(log.calibration), encoding="utf-8")
        words = ["--calibration", str(calibration)]
    made = clt("import", log.format, str(data / log.path), "-o", str(source), "--force", *words)
    if made.returncode not in {0, 3}:
        return f"| {log.name} | import: {made.stderr.strip().splitlines()[-1]} |"
    cells, reckoned = [], "-"
    for init in ("truth", "auto"):
        for name in filters if init == "truth" else filters[:1]:
            out = folder / "out.mcap"
            ran = clt("localize", str(source), "-o", str(out), "--force", "--filter", name,
                      "--frame", log.frame, "--init", init)  # fmt: skip
            if ran.returncode not in {0, 3}:
                cells.append(f"exit {ran.returncode}")
                continue
            judged = clt("evaluate", str(out), "--json")
            if judged.returncode not in {0, 3}:
                cells.append("no score")
                continue
            found = json.loads(judged.stdout)
            if init == "truth":
                reckoned = scores(found, "dead_reckoning")
            cells.append(f"{scores(found, 'estimate')}, exit {ran.returncode}")
    return f"| {log.name} | {reckoned} | {' | '.join(cells)} | {log.lesson} |"


def main() -> None:
    """Run the table and print it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--filters", default="eskf,ukf,mixture")
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    filters = tuple(options.filters.split(","))
    head = " | ".join(f"{name} from truth" for name in filters)
    lines = [
        "Real logs, default settings (`python benchmarks/sensors.py --data FOLDER`): position",
        "RMSE, m / heading RMSE, deg / ANEES (3 expected), and the exit code of `clt localize`.",
        "Distances and relative headings where the frame is a robot's.",
        "",
        f"| log | dead reckoning | {head} | {filters[0]}, `--init auto` | what it teaches |",
        "|" + "---|" * (len(filters) + 4),
    ]
    for log in LOGS:
        with tempfile.TemporaryDirectory() as folder:
            lines.append(row(log, options.data, Path(folder), filters))
            print(lines[-1], flush=True)
    text = "\n".join(lines) + "\n"
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
