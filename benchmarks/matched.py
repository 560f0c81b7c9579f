"""Random scenarios whose noise the filters know: how often a result is sure and wrong.

    python benchmarks/matched.py [--runs 300] [--first 1] [--out benchmarks/results/matched.md]

Every run draws a team, drives, sensors, errors that last, outliers, a filter, a frame and a start,
and goes through the commands as a user's would: simulate, localize, evaluate. All noise is what the
settings state; starts are drawn from the covariance that the filter is given, or found by `auto`.
A run is sure and wrong when localize ends with 0 and the mean NEES per dimension of some robot
exceeds 5 (1 expected). A run is fine when that of no robot exceeds 2; exit code 3 is needless then.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from report import publish
from scipy.stats import beta
from typer.testing import CliRunner

from clt.cli.app import app
from clt.core.geometry import relative_pose
from clt.core.recording import Recording
from clt.initialization.given.truth import from_truth
from clt.log.recording.load import load

DIMENSION = 3
WRONG, FINE = 5.0, 2.0
"""NEES per dimension."""
DOUBTED = 3
"""Exit code of a run that says what may be wrong."""
STAND = {"duration": 10.0, "v": 0.0, "omega": 0.0}
DRIVES = (
    {"kind": "wander"},
    {"kind": "wander"},
    {"kind": "circle", "radius": 2.0, "speed": 0.6},
    {"kind": "segments", "segments": [{"duration": 60.0, "v": 0.3, "omega": 0.05}]},
    {
        "kind": "segments",
        "turn_radius": 0.5,
        "segments": [
            STAND,
            {"duration": 8.0, "v": 0.5, "omega": 0.3},
            STAND,
            {"duration": 32.0, "v": 0.5, "omega": -0.2},
        ],
    },
)
RELATIVE = ("ekf", "ukf", "mixture", "pf", "dpf")
ABSOLUTE = ("eskf", "ekf", "ukf", "mixture")


@dataclass(frozen=True)
class Case:
    """One run before it ran."""

    number: int
    scenario: dict[str, Any]
    filter: str
    frame: str
    """`world`, `moving ego`, `standing ego` or `mutual`."""
    init: str
    """`auto`, or `drawn` from `sigma`."""
    sigma: tuple[float, float]
    """m, rad."""
    settings: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    case: Case
    exit: int
    worst: float | None
    """Largest mean NEES per dimension of a robot; None where nothing could be scored."""
    error: float | None
    """RMSE of that robot's position, m."""
    said: str

    @property
    def wrong(self) -> bool:
        """Sure and wrong."""
        return self.exit == 0 and self.worst is not None and self.worst > WRONG

    @property
    def fine(self) -> bool:
        """No robot is much further off than stated."""
        return self.worst is not None and self.worst < FINE


def drawn(number: int) -> Case:
    """Case `number`: the same at every call."""
    rng = np.random.default_rng([number, 20261130])

    def one(*values: Any) -> Any:
        return values[int(rng.integers(len(values)))]

    relative = bool(rng.random() < 0.5)
    moving = int(rng.integers(2 if relative else 1, 5))
    static = int(rng.integers(0, 3) if relative else rng.integers(0, 5))
    known = bool(rng.random() < 0.75)
    odometry: dict[str, Any] = {
        "rate": one(10.0, 20.0, 50.0),
        "sigma_v": one(0.02, 0.05, 0.1, 0.2),
        "sigma_omega": one(0.02, 0.05, 0.1),
        "at_rest": one(1.0, 0.01),
        "phase": one("common", "random"),
    }
    settings: list[str] = []
    if rng.random() < 0.3:
        odometry |= {"scale_sd": 0.03, "bias_sd": 0.02}
        settings += ["noise.scale=0.03", "noise.bias=0.02"]
    if rng.random() < 0.2:
        odometry["twist"] = "instant"
    if rng.random() < 0.2:
        odometry["gaps"] = {"share": 0.05, "length": 0.5}
    outliers = {"share": one(0.0, 0.0, 0.0, 0.05), "mean": 1.0}
    pairs = ["all", "all", "all"]
    if moving > 1 and (relative or static == 0):
        pairs.append("moving-moving")
    if static > 1 and not relative:
        pairs.append("moving-static")
    pairs = one(*pairs)
    scenario = {
        "name": f"matched{number}",
        "duration": float(rng.integers(20, 61)),
        "seed": number,
        "team": {
            "moving": moving,
            "static": static,
            "area": [0.0, 0.0, *([one(6.0, 12.0)] * 2)],
            "known": known,
        },
        "trajectory": one(*DRIVES),
        "sensors": {
            "odometry": odometry,
            "range": {
                "rate": one(1.0, 5.0, 20.0),
                "sigma": one(0.03, 0.1, 0.2),
                "phase": one("common", "random"),
                "pairs": pairs,
            },
            "truth": {"rate": 10.0},
        },
        "outliers": outliers,
        "network": {"loss": one(0.0, 0.1)},
    }
    if not relative:
        frame, filter_ = "world", str(one(*ABSOLUTE))
    else:
        filter_ = str(one(*RELATIVE))
        still = ["standing ego"] if static > 0 and filter_ != "dpf" else []
        frame = str(one("moving ego", *still, *([] if filter_ == "dpf" else ["mutual"])))
    auto = not relative and static >= 2 and known and pairs == "all" and bool(rng.random() < 0.3)
    sigma = one((0.02, 0.02), (0.1, 0.1), (0.3, 0.2), (1.0, 0.5))
    return Case(
        number, scenario, filter_, frame, "auto" if auto else "drawn", sigma, tuple(settings)
    )


def names_of(case: Case, recording: Recording) -> tuple[str | None, tuple[str, ...]]:
    """The ego of a case, None in the world, and the robots of its frame."""
    moving = [robot.name for robot in recording.team.moving]
    if case.frame == "world":
        return None, recording.team.names
    if case.frame == "mutual":
        return moving[0], (moving[0], moving[1])
    ego = recording.team.static[0].name if case.frame == "standing ego" else moving[0]
    return ego, recording.team.names


def frame_option(case: Case, recording: Recording) -> str:
    """What `--frame` takes."""
    ego, names = names_of(case, recording)
    if case.frame == "mutual":
        return f"mutual:{','.join(names)}"
    return "world" if ego is None else f"ego:{ego}"


def write_start(case: Case, recording: Recording, file: Path) -> None:
    """Poses in the frame of the case, their errors drawn from what the file states."""
    true = from_truth(recording, (0.0, 0.0, 0.0)).poses
    rng = np.random.default_rng([case.number, 7])
    width = np.array([case.sigma[0], case.sigma[0], case.sigma[1]])
    ego, names = names_of(case, recording)
    known = {robot.name for robot in recording.team.static if robot.position is not None}
    tables = {}
    for name in names:
        if name == ego or (ego is None and name in known):
            continue
        mean = true[name].mean if ego is None else relative_pose(true[ego].mean, true[name].mean)
        mean = mean + width * rng.standard_normal(3)
        tables[name] = dict(zip(("x", "y", "heading"), map(float, mean), strict=True))
        tables[name]["sigma"] = width.tolist()
    file.write_text(tomli_w.dumps(tables), encoding="utf-8")


def run(case: Case, folder: Path) -> Outcome:
    """Simulate, localize, evaluate."""
    runner = CliRunner()
    scenario, log = folder / "scenario.toml", folder / "log.mcap"
    start, out = folder / "start.toml", folder / "out.mcap"
    scenario.write_text(tomli_w.dumps(case.scenario), encoding="utf-8")
    made = runner.invoke(app, ["simulate", str(scenario), "-o", str(log), "--force", "-q"])
    if made.exit_code != 0:
        raise RuntimeError(f"case {case.number}: {made.output}")
    init, recording = "auto", load(log).recording
    if case.init == "drawn":
        write_start(case, recording, start)
        init = str(start)
    words = ["localize", str(log), "-o", str(out), "--force", "--init", init, "--no-scene"]
    words += ["--filter", case.filter, "--frame", frame_option(case, recording)]
    words += [word for key in case.settings for word in ("--set", key)]
    out.unlink(missing_ok=True)
    done = runner.invoke(app, words)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    if not out.exists():
        return Outcome(case, done.exit_code, None, None, done.stderr)
    scored = runner.invoke(app, ["evaluate", str(out), "--json"])
    if scored.exit_code not in {0, 3}:
        return Outcome(case, done.exit_code, None, None, done.stderr + scored.stderr)
    worst, error = None, None
    for robot in json.loads(scored.stdout)["robots"].values():
        own = robot["estimate"]
        anees = own.get("anees")
        if anees is not None and (worst is None or anees / DIMENSION > worst):
            worst, error = anees / DIMENSION, own["ape"]["rmse"]
    return Outcome(case, done.exit_code, worst, error, done.stderr)


def interval(count: int, of: int) -> str:
    """Share in per cent with its 95 % interval (Clopper and Pearson)."""
    if of == 0:
        return "-"
    low = float(beta.ppf(0.025, count, of - count + 1)) if count > 0 else 0.0
    high = float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0
    return f"{100 * count / of:.1f} ({100 * low:.1f} to {100 * high:.1f})"


def table(outcomes: list[Outcome], first: int) -> Iterator[str]:
    """The result as a markdown table, a row per filter."""
    last = first + len(outcomes) - 1
    yield f"{len(outcomes)} random matched scenarios, numbers {first} to {last}"
    yield f"(`python benchmarks/matched.py --runs {len(outcomes)} --first {first}`)."
    yield "Sure and wrong: exit code 0 and a robot's mean NEES per dimension above 5."
    yield "Fine: that of every robot is below 2. Per cent, with 95 % interval:"
    yield ""
    yield "| filter, frame | runs | exit 0 | exit 3 | of exit 0 sure and wrong | of fine exit 3 |"
    yield "|---|---|---|---|---|---|"
    kinds = sorted({(o.case.filter, o.case.frame) for o in outcomes})
    for kind in [*kinds, None]:
        own = [o for o in outcomes if kind in {None, (o.case.filter, o.case.frame)}]
        done, fine = [o for o in own if o.exit == 0], [o for o in own if o.fine]
        name = "**all**" if kind is None else ", ".join(kind)
        partial = sum(o.exit == DOUBTED for o in own)
        wrong = interval(sum(o.wrong for o in done), len(done))
        needless = interval(sum(o.exit == DOUBTED for o in fine), len(fine))
        yield f"| {name} | {len(own)} | {len(done)} | {partial} | {wrong} | {needless} |"


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--runs", type=int, default=300)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--verbose", action="store_true", help="a line for every run")
    options = parser.parse_args()
    outcomes = []
    with tempfile.TemporaryDirectory() as folder:
        for number in range(options.first, options.first + options.runs):
            outcomes.append(run(drawn(number), Path(folder)))
            o = outcomes[-1]
            if options.verbose:
                c = o.case
                worst = "-" if o.worst is None else f"{o.worst:.2f} {o.error:.2f} m"
                mark = "  WRONG" if o.wrong else ""
                print(
                    f"{number} exit {o.exit} {c.filter} {c.frame} {c.init} {c.sigma} {c.settings} "
                    f"NEES/3 {worst}{mark}",
                    flush=True,
                )
                if o.exit != 0 or o.wrong:
                    print("   " + o.said.replace("\n", "\n   "), flush=True)
    publish(table(outcomes, options.first), options.out)


if __name__ == "__main__":
    main()
