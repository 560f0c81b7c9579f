"""Relative initialization from random geometries: how often right, covered, unique; how fast.

    python benchmarks/pairwise.py [--runs 500] [--out benchmarks/results/pairwise.md]
        [--figures FOLDER]

Two robots start 1 m to 4 m apart, in any direction, with any headings ("arena": anywhere in Li's
arena of 9 m x 2 m, at least 1 m apart; "paper": 2 m apart at 90 degrees, turned by -14.6), and
drive steps of 0.6 m: straight; gentle (0.1 rad a step); weave (0.5 rad a step, swinging with a
period of 8 steps); curvy (every step turns by a normal angle of 0.5 rad). Odometry errors are a
random walk that is off by the given distance (RMS) after 15 steps. The pose given, as `clt init`
gives it, is right within 1 m and 20 degrees; "could be": how often the best possible answer would
be, by the posterior itself; "in the set": the truth lies in the 99.7 % region of a hypothesis.
Further rows have wild ranges, too long by an exponential error of 1 m on average: here
and there, or all by the same in a row.
Times are of the processor, for one pair: the median over all runs, the least of three calls each.
FOLDER gets the paper's Fig. 6, theta and phi against the number of
ranges.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import rotation_matrix, wrap_angle
from clt.initialization.pairwise.graph import combine_pairs
from clt.initialization.pairwise.hypotheses import PairHypotheses
from clt.initialization.pairwise.likelihood import PairRanges
from clt.initialization.pairwise.pairwise import solve_pair
from clt.initialization.pairwise.team import status_from_joints, with_pair_doubts
from clt.initialization.status import RobotStatus

STEP = 0.6
REGION = 13.93
"""Chi-square with 3 degrees of freedom, 99.7 %."""
COUNTS = (7, 9, 11, 13, 20, 30)
MOTIONS = ("straight", "gentle", "weave", "curvy")
QUIET = ((13, 0.2, 0.1), (13, 0.2, 0.0), (9, 0.05, 0.1), (30, 0.1, 0.1))
"""Further cells of curvy tracks: ranges, their sigma, drift."""
OTHER = ((13, 0.2, 0.3), (13, 0.2, 0.1), (30, 0.1, 0.1))
"""Cells of curvy tracks that start anywhere in the arena, and where the paper's do."""
WILD = (
    (30, 0.1, 0.1, 3, False), (30, 0.1, 0.1, 6, False), (20, 0.1, 0.1, 2, False),
    (13, 0.2, 0.1, 1, False), (20, 0.1, 0.1, 4, True), (30, 0.1, 0.1, 6, True),
)  # fmt: skip
"""Cells of curvy tracks with so many wild ranges, in a row or not."""
Geometry = Callable[[np.random.Generator], Floats]
PAPER = np.array([0.0, 2.0, np.radians(-14.6)])


class Score(NamedTuple):
    """One run."""

    right: bool
    could: float
    covered: bool
    unique: bool
    hypotheses: int
    position: float
    heading: float
    seconds: float


def track(motion: str, n: int, rng: np.random.Generator) -> Floats:
    """Positions (n, 2) of a robot in its own frame at the start."""
    turn = {
        "straight": np.zeros(n - 1),
        "gentle": np.full(n - 1, 0.1) * rng.choice([-1.0, 1.0]),
        "weave": 0.5 * np.sin(2.0 * np.pi * (np.arange(n - 1) / 8.0 + rng.uniform())),
        "curvy": 0.5 * rng.standard_normal(n - 1),
    }[motion]
    heading = np.cumsum(turn)
    steps = STEP * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.vstack([np.zeros(2), np.cumsum(steps, axis=0)])


def around(rng: np.random.Generator) -> Floats:
    """Relative pose (3,) of two robots 1 m to 4 m apart."""
    distance, theta, phi = rng.uniform((1.0, -np.pi, -np.pi), (4.0, np.pi, np.pi))
    return np.array([distance * np.cos(theta), distance * np.sin(theta), phi])


def arena(rng: np.random.Generator) -> Floats:
    """Relative pose (3,) of two robots in the arena."""
    while True:
        place = rng.uniform((0.0, 0.0), (9.0, 2.0), (2, 2))
        if np.hypot(*(place[1] - place[0])) >= 1.0:
            break
    heading = rng.uniform(-np.pi, np.pi, 2)
    away = rotation_matrix(-heading[0]) @ (place[1] - place[0])
    return np.array([*away, float(wrap_angle(heading[1] - heading[0]))])


def paper(_: np.random.Generator) -> Floats:
    """Relative pose (3,) of the paper's robots."""
    return PAPER


def measure(
    pose: Floats, motion: str, n: int, sigma: float, drift: float, rng: np.random.Generator
) -> PairRanges:
    """Noisy ranges along two tracks as odometry reports them."""
    a, b = track(motion, n, rng), track(motion, n, rng)
    z = np.hypot(*(pose[:2] + b @ rotation_matrix(pose[2]).T - a).T) + sigma * rng.standard_normal(
        n
    )
    step = drift / np.sqrt(2.0 * 15.0)
    k = np.arange(n)
    P = step**2 * np.minimum(k[:, None], k)[:, :, None, None] * np.eye(2)
    tracks = []
    for p in (a, b):
        error = np.cumsum(step * rng.standard_normal((n - 1, 2)), axis=0)
        tracks.append(p + np.vstack([np.zeros(2), error]))
    S = P[k, k]
    return PairRanges(np.abs(z), np.full(n, sigma**2), *tracks, P, P, S, S, np.zeros((n, 2, 2)))


def spoil(pair: PairRanges, wild: int, in_a_row: bool, rng: np.random.Generator) -> None:
    """Make some ranges too long, in place."""
    if in_a_row:
        first = rng.integers(0, pair.z.size - wild + 1)
        pair.z[first : first + wild] += rng.exponential(1.0)
    else:
        pair.z[rng.choice(pair.z.size, wild, replace=False)] += rng.exponential(1.0, wild)


def score(found: PairHypotheses, best: RobotStatus, pose: Floats, seconds: float) -> Score:
    """Against the true pose."""
    assert best.pose is not None
    e = np.vstack([best.pose.mean, found.mean]) - pose
    e[:, 2] = wrap_angle(e[:, 2])
    far, turned = float(np.hypot(e[0, 0], e[0, 1])), float(abs(e[0, 2]))
    squared = [x @ np.linalg.solve(C, x) for x, C in zip(e[1:], found.covariance, strict=True)]
    right = far < 1.0 and turned < np.radians(20.0)
    could = float(found.support.max())
    unique = best.status == "ok"
    return Score(right, could, min(squared) < REGION, unique, len(found.mean), far, turned, seconds)


def timed(pair: PairRanges) -> tuple[PairHypotheses, float]:
    """A solved pair and what it takes: the least of three, s."""
    seconds = []
    for _ in range(3):
        begin = process_time()
        found = solve_pair(pair)
        seconds.append(process_time() - begin)
    return found, min(seconds)


def cell(
    motion: str,
    n: int,
    sigma: float,
    drift: float,
    runs: int,
    geometry: Geometry = around,
    wild: int = 0,
    in_a_row: bool = False,
) -> str:
    """One line of the table."""
    rng = np.random.default_rng(n)
    scores = []
    for _ in range(runs):
        pose = geometry(rng)
        pair = measure(pose, motion, n, sigma, drift, rng)
        if wild > 0:
            spoil(pair, wild, in_a_row, rng)
        found, seconds = timed(pair)
        edges = {("R1", "R2"): found}
        _, joints = combine_pairs("R1", edges, frozenset())
        best = with_pair_doubts(status_from_joints(joints, 1, turns=True), edges)
        scores.append(score(found, best, pose, seconds))
    right, could, covered, unique, count, far, turned, seconds = np.array(scores, np.float64).T
    wrong = int(np.sum((unique == 1.0) & (right == 0.0)))
    where = {arena: " (arena)", paper: " (paper)"}.get(geometry, "")
    if wild > 0:
        where += f" ({wild} wild{', in a row' if in_a_row else ''})"
    return (
        f"| {motion}{where} | {n} | {sigma:g} | {drift:g} | {100 * right.mean():.1f} % | "
        f"{100 * could.mean():.1f} % | "
        f"{np.median(far):.2f} m, {np.degrees(np.median(turned)):.1f} deg | "
        f"{100 * covered.mean():.1f} % | {np.median(count):.0f} | {100 * unique.mean():.1f} % | "
        f"{wrong} | {1e3 * np.median(seconds):.1f} |"
    )


def figure(folder: Path) -> None:
    """The paper's Fig. 6: bearing theta and turn phi of its geometry against N, weaving drives."""
    from matplotlib.figure import Figure  # noqa: PLC0415 - only this needs it

    counts, runs = np.arange(7, 14), 40
    drawn = np.empty((2, counts.size, runs))
    for c, n in enumerate(counts.tolist()):
        rng = np.random.default_rng(n)
        for k in range(runs):
            found = solve_pair(measure(PAPER, "weave", n, 0.2, 0.3, rng))
            best = found.mean[np.argmax(found.support)]
            drawn[:, c, k] = np.arctan2(best[1], best[0]), best[2]
    page = Figure(figsize=(8.0, 3.5), layout="constrained")
    for axes, values, name, true in zip(
        page.subplots(1, 2), drawn, ("theta", "phi"), (np.pi / 2.0, PAPER[2]), strict=True
    ):
        axes.boxplot(list(np.degrees(values)), tick_labels=counts.astype(str).tolist())
        axes.axhline(np.degrees(true), color="tab:red", linewidth=1.0, label="truth")
        axes.set(xlabel="ranges N", ylabel=f"{name} of the pose given, deg", title=name)
        axes.legend()
    folder.mkdir(parents=True, exist_ok=True)
    page.savefig(folder / "pairwise.png", dpi=150)


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=500)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--figures", type=Path)
    options = parser.parse_args()
    solve_pair(measure(PAPER, "weave", 13, 0.2, 0.3, np.random.default_rng(1)))
    columns = (
        "motion", "N", "range sigma, m", "drift, m", "right", "could be", "median error",
        "truth in the set", "hypotheses", "unique", "unique but wrong", "CPU, ms",
    )  # fmt: skip
    rows = ["| " + " | ".join(columns) + " |", "|---" * len(columns) + "|"]
    cells = [(motion, n, 0.2, 0.3) for motion in MOTIONS for n in COUNTS]
    for each in [*cells, *(("curvy", *quiet) for quiet in QUIET)]:
        rows.append(cell(*each, options.runs))
        print(rows[-1], flush=True)
    for geometry in (arena, paper):
        for other in OTHER:
            rows.append(cell("curvy", *other, options.runs, geometry))
            print(rows[-1], flush=True)
    for n, sigma, drift, wild, in_a_row in WILD:
        rows.append(cell("curvy", n, sigma, drift, options.runs, wild=wild, in_a_row=in_a_row))
        print(rows[-1], flush=True)
    text = "\n".join(
        [f"# Relative initialization, {options.runs} random geometries per row\n", *rows, ""]
    )
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")
    if options.figures is not None:
        figure(options.figures)


if __name__ == "__main__":
    main()
