"""Whether what `clt observability` says of a log comes true in a filter, and what it costs.

    python benchmarks/observability.py [--logs 200] [--out benchmarks/results/observability.md]

Random teams drive at random, on circles, straight or not at all, with no to three static robots,
some of them degenerate. Each log is asked at its truth, over its whole length as one window, which
joint directions of the team's error its data fix. Then the filter runs from starts with random
errors, and the errors along each direction are compared before and after: those called
unobservable must not have shrunk, those called observable must be bounded. In the coordinates
(e, dtheta), e = dp - J p dtheta, an error that no range corrects stays what it is, so that a
direction means the same at the start and at the end.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from clt.filters import world
from clt.filters.settings import FilterSettings, Noise
from clt.geometry import wrap
from clt.init.start import InitialPose, Start
from clt.init.truth import from_truth
from clt.observability.advice import setup_of
from clt.observability.analysis import analyse
from clt.observability.gramian import windows
from clt.observability.reference import Reference, reference_of
from clt.observability.setup import Setup, every_pair, team
from clt.observability.windows import SEEN_HEADING, SEEN_POSITION, STEP, look
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.streams import Floats, Recording

LARGE, SMALL = np.array([0.2, 0.2, 0.1]), np.array([0.02, 0.02, 0.01])
"""Standard deviations of the initial errors, m and rad. What is observable must overcome large
ones (still larger ones the filter's linearization does not bear). What is not is asked with small
ones: of a large error across a line, or of a large rotation, ranges tell to second order.
"""
KEPT, BOUNDED = 0.85, 0.5
"""An error that does not shrink keeps this share of its initial root mean square at least; a
bounded one has fallen below that share of a large initial one, whatever the odometry added, or
is within BOUND times the best standard deviation attainable.
"""
BOUND = 3.0
DRAWS = 40
ON_LINE = "along the anchors' line"
SECONDS = 40.0


@dataclass(frozen=True)
class Verdict:
    """One direction of one log: what was said and what came."""

    kind: str
    observable: bool
    shrink: float
    """Final over initial root mean square error."""
    excess: float
    """Final root mean square error over the best standard deviation."""


def scenario(rng: np.random.Generator, index: int) -> tuple[str, dict[str, Any]]:
    """A random team; the kind goes round, so that each is met equally often."""
    kinds = ("two anchors", "one anchor", "no anchor", "one at rest", ON_LINE,
             "three anchors", "two anchors, circles", "two anchors, straight")  # fmt: skip
    kind = kinds[index % len(kinds)]
    moving = int(rng.integers(1, 4))
    static = {"one anchor": 1, "no anchor": 0, "three anchors": 3}.get(kind, 2)
    keys: dict[str, Any] = {
        "seed": int(rng.integers(1, 10**6)),
        "duration": SECONDS,
        "team.static": static,
        "team.moving": max(moving, 2) if static == 0 else moving,
        "sensors.odometry.sigma_v": float(rng.uniform(0.01, 0.05)),
        "sensors.odometry.sigma_omega": float(rng.uniform(0.002, 0.01)),
        "sensors.range.sigma": float(rng.uniform(0.03, 0.15)),
        "sensors.range.rate": 10.0,
    }
    speed = float(rng.uniform(0.08, 0.12))
    line = {"kind": "segments", "segments": [{"duration": 100.0, "v": speed, "omega": 0.0}]}
    if kind == "one at rest":
        own = [*rng.uniform(3.0, 9.0, 2).tolist(), float(rng.uniform(-3.0, 3.0))]
        keys["robots"] = [{"name": "Q", "start": own, "trajectory": {"kind": "stand"}}]
        keys["team.moving"] = max(moving, 2)
    elif kind == ON_LINE:
        own = [float(rng.uniform(3.0, 4.0)), 0.0, 0.0]
        keys["robots"] = [{"name": "Q", "start": own, "trajectory": line}]
        keys["team.moving"] = 1
    elif kind == "two anchors, circles":
        keys["trajectory"] = {"kind": "circle", "radius": float(rng.uniform(2.0, 4.0))}
    elif kind == "two anchors, straight":
        own = [float(rng.uniform(1.0, 4.0)), float(rng.uniform(3.0, 8.0)), float(rng.uniform(0, 1))]
        keys["robots"] = [{"name": "Q", "start": own, "trajectory": line}]
        keys["team.moving"] = 1
    return kind, keys


def drawn(start: Start, sigma: Floats, rng: np.random.Generator) -> Start:
    """Initial poses of the moving robots with random errors, and covariances that say so."""
    poses = {
        name: pose
        if not np.any(pose.covariance)
        else InitialPose(pose.mean + sigma * rng.standard_normal(3), np.diag(sigma**2))
        for name, pose in start.poses.items()
    }
    return replace(start, poses=poses)


def invariant(error: Floats, place: Floats) -> Floats:
    """(e, dtheta) from (dx, dy, dtheta) at places (n, 2), shapes (n, 3)."""
    turn = error[:, 2]
    e = [error[:, 0] + place[:, 1] * turn, error[:, 1] - place[:, 0] * turn, turn]
    return np.stack(e, axis=1)


def errors(recording: Recording, start: Start, names: list[str], centre: Floats) -> Floats:
    """Invariant errors (2, 3 n) at the start and at the end of one filter run."""
    posterior = world.localize(recording, start, FilterSettings(gate=0.0))
    found = []
    for which in (0, -1):
        rows, places = [], []
        for name in names:
            poses, truth = posterior.poses[name], recording.truth[name]
            pose = np.array([poses.x[which], poses.y[which], poses.heading[which]])
            k = int(np.searchsorted(truth.stamp, poses.stamp[which]))
            k = min(k, truth.stamp.size - 1)
            true = np.array([truth.x[k], truth.y[k], truth.heading[k]])
            difference = pose - true
            difference[2] = wrap(difference[2])
            rows.append(difference)
            places.append(0.5 * (pose[:2] + true[:2]) - centre)
        found.append(invariant(np.array(rows), np.array(places)).ravel())
    return np.array(found)


def directions(reference: Reference) -> tuple[Floats, Floats, Floats]:
    """Scaled information about (e, dtheta) of the whole log: eigenvalues, vectors, scales."""
    steps = reference.noise.shape[1]
    Y = windows(reference, np.array([0]), steps, framed=False)[0]
    return to_invariant(reference, Y)


def to_invariant(reference: Reference, Y: Floats) -> tuple[Floats, Floats, Floats]:
    """Back from the pose at the end: z = A x, so that the information of z is A^-T Y A^-1."""
    n = len(reference.robots)
    A = np.eye(3 * n)
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    for i in range(n):
        p = reference.pose[i, -1, :2] - centre
        A[3 * i, 3 * i + 2], A[3 * i + 1, 3 * i + 2] = p[1], -p[0]
    back = np.linalg.inv(A)
    scale = np.tile([SEEN_POSITION, SEEN_POSITION, SEEN_HEADING], n)
    value, vector = np.linalg.eigh(back.T @ Y @ back * scale[:, None] * scale)
    return value, vector, scale


def judge(kind: str, recording: Recording, rng: np.random.Generator) -> list[Verdict]:
    """Every joint direction of one log against many filter runs."""
    reference = reference_of(recording, Noise(), STEP)
    names = [robot.name for robot in reference.robots]
    value, vector, scale = directions(reference)
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    start = from_truth(recording, (0.1, 0.1, 0.1))
    value = np.maximum(value, 1e-6)
    open_, best = value < 1.0, 1.0 / np.sqrt(value)
    pairs = np.empty((value.size, 2))
    for chosen, sigma in ((~open_, LARGE), (open_, SMALL)):
        runs = [errors(recording, drawn(start, sigma, rng), names, centre) for _ in range(DRAWS)]
        along = np.einsum("rtd,dk->rtk", np.array(runs) / scale, vector[:, chosen])
        if sigma is SMALL:
            first = initial(start, names, centre, scale, vector[:, chosen])
            along[:, 0] = (np.array(runs)[:, 0] / scale) @ first
        pairs[chosen] = np.sqrt(np.mean(along**2, axis=0)).T
    return [
        Verdict(kind, not open_[k], after / before, after / best[k])
        for k, (before, after) in enumerate(pairs)
    ]


def initial(start: Start, names: list[str], centre: Floats, scale: Floats, N: Floats) -> Floats:
    """Weights (d, k) that read the amplitudes of directions N (d, k) off an initial error.

    What is left once ranges fixed all other directions is the amplitude that the initial
    covariance P gives: (N^T P^-1 N)^-1 N^T P^-1.
    """
    A = np.eye(3 * len(names))
    for i, name in enumerate(names):
        x, y = start.poses[name].mean[:2] - centre
        A[3 * i, 3 * i + 2], A[3 * i + 1, 3 * i + 2] = y, -x
    P = A @ np.diag(np.tile(SMALL, len(names)) ** 2) @ A.T / np.outer(scale, scale)
    weighted = np.linalg.solve(P, N)
    return np.asarray(np.linalg.solve(N.T @ weighted, weighted.T).T)


def exact_agrees(recording: Recording, verdicts: list[Verdict]) -> bool:
    """Whether the exact rank of the team as it drove equals the number of directions seen."""
    setup = setup_of(recording)
    if verdicts[0].kind == ON_LINE:
        setup = replace(setup, in_line=frozenset(range(len(setup.nodes))))
    return analyse(setup).rank == sum(one.observable for one in verdicts)


def agreement(logs: int) -> list[str]:
    """The table of what was said and what came."""
    rng = np.random.default_rng(6)
    kept: list[Verdict] = []
    per_log: dict[str, list[tuple[bool, bool]]] = {}
    for index in range(logs):
        kind, keys = scenario(rng, index)
        recording = simulate(load_scenario("shi-sim", keys))
        verdicts = judge(kind, recording, rng)
        kept += verdicts
        good = all(came_true(one) for one in verdicts)
        per_log.setdefault(kind, []).append((good, exact_agrees(recording, verdicts)))
    lines = [
        (
            f"{logs} logs of {SECONDS:g} s, {DRAWS} filter runs each from initial errors of "
            f"{LARGE[0]:g} m and {LARGE[2]:g} rad for what is called observable, of {SMALL[0]:g} m "
            f"and {SMALL[2]:g} rad for what is not."
        ),
        "",
        (
            "| said of a direction | directions | came true | final / initial error, median "
            "(worst) | final error / best sd, median (worst) |"
        ),
        "|---|---|---|---|---|",
    ]
    for observable in (False, True):
        own = [one for one in kept if one.observable == observable]
        if len(own) == 0:
            continue
        shrink, excess = (np.array([getattr(o, key) for o in own]) for key in ("shrink", "excess"))
        worst = np.max(shrink) if observable else np.min(shrink)
        tail = f"{np.median(excess):.2f} ({np.max(excess):.2f})" if observable else "-"
        lines.append(
            f"| {'observable' if observable else 'unobservable'} | {len(own)} | "
            f"{sum(map(came_true, own))} | {np.median(shrink):.2f} ({worst:.2f}) | {tail} |"
        )
    lines += [
        "",
        (
            f"Unobservable comes true where the error is not below {KEPT} of the initial one, "
            f"observable where it has fallen below {BOUNDED} of it or is within {BOUND:g} times "
            "the best standard deviation attainable."
        ),
        "",
        "| kind of log | logs | all directions came true | exact rank of the team agrees |",
        "|---|---|---|---|",
    ]
    for kind, found in per_log.items():
        lines.append(
            f"| {kind} | {len(found)} | {sum(good for good, _ in found)} | "
            f"{sum(same for _, same in found)} |"
        )
    return lines


def came_true(one: Verdict) -> bool:
    if not one.observable:
        return one.shrink >= KEPT
    return one.shrink <= BOUNDED or one.excess <= BOUND


def best_of(work: Any, times: int = 3) -> float:
    """Shortest of some runs, s."""
    spent = []
    for _ in range(times):
        begin = perf_counter()
        work()
        spent.append(perf_counter() - begin)
    return min(spent)


def timings() -> list[str]:
    """What the two forms of the command cost."""
    program = [sys.executable, "-m", "clt", "observability", "--moving", "50", "--static", "0"]
    whole = best_of(lambda: subprocess.run(program, check=True, capture_output=True))
    ask = Setup(team(50, 0), every_pair(50))
    five = simulate(load_scenario("shi-sim", {}))
    fifty = simulate(load_scenario("shi-sim", {"team.moving": 48, "duration": 60.0}))
    rows = [
        ("`clt observability --moving 50 --static 0`, whole process", whole),
        ("the same inside a process", best_of(lambda: analyse(ask))),
        ("300 s, five robots, windows of 10 s, log in memory", best_of(lambda: along(five))),
        ("60 s, fifty robots, windows of 10 s, log in memory", best_of(lambda: along(fifty), 1)),
    ]
    return ["| work | s |", "|---|---|", *(f"| {name} | {spent:.2f} |" for name, spent in rows)]


def along(recording: Recording) -> None:
    look(reference_of(recording, Noise(), STEP), 10.0, framed=False)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    text = "\n".join(
        [
            "# Observability: what is said and what comes",
            "",
            f"`python benchmarks/observability.py --logs {options.logs}`",
            "",
            *agreement(options.logs),
            "",
            *timings(),
            "",
        ]
    )
    if options.out is not None:
        options.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
