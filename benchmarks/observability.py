"""Whether what `clt observability` says of a log comes true in a filter, and what it costs.

    python benchmarks/observability.py [--logs 200] [--out benchmarks/results/observability.md]

Random teams drive at random, on circles, straight or not at all, with no to three static robots,
some of them degenerate. Each log is asked at its truth, over its whole length as one window, which
joint directions of the team's error its data fix. Then the filter runs from starts with random
errors, and the errors along each direction are compared before and after: of those called
unobservable the initial error must still be there, those called observable must have shrunk, and be
bounded. In the coordinates (e, dtheta), e = dp - J p dtheta, an error that no range corrects stays
what it is, so that a direction means the same at the start and at the end.

On the anchors' line the rank drops at a single state, and ranges show the open directions to second
order: the more, the larger the errors. There the initial error must be kept the better, the
smaller it is.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from processes import CLT, wall

from clt.core.arrays import Floats
from clt.core.geometry import wrap_angle
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.estimation import estimators
from clt.initialization.given.truth import from_truth
from clt.log.recording.save import save
from clt.model.settings import FilterSettings, NoiseSettings
from clt.observability.advice import setup_of
from clt.observability.exact.analysis import Analysis, analyse
from clt.observability.windows.gramian import window_information
from clt.observability.windows.reference import ReferenceTrajectories, build_reference
from clt.observability.windows.windows import (
    NOISE_STEP_S,
    OBSERVED_HEADING_SIGMA,
    OBSERVED_POSITION_SIGMA,
    evaluate_windows,
)
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate
from clt.sim.simulate import simulate_exact as without_noise

LARGE, SMALL, TINY = (np.array([0.2, 0.2, 0.1]) * factor for factor in (1.0, 0.1, 0.001))
"""Standard deviations of the initial errors, m and rad. What is observable must overcome large ones
(still larger ones the filter's linearization does not bear). What is not is asked with small ones:
of a large rotation ranges show to second order.
"""
KEPT = 0.95
"""An unobservable direction keeps this share of each initial error at least."""
SHRUNK = 0.5
"""An observable one's error has fallen below this share of a large initial one."""
BOUND = 4.0
"""So many best standard deviations it may end at. All runs of a log share its noise: by chance one
direction in 400 ends beyond 3, one in 16 000 beyond 4."""
DRAWS = 40
ON_LINE = "along the anchors' line"
SECONDS = 40.0


@dataclass(frozen=True)
class Verdict:
    """One direction of one log: what was said and what came."""

    kind: str
    said: str
    """One of SAID."""
    kept: float
    """How much of a small initial error along it is left at the end."""
    tiny: float
    """The same of a tiny one, with sensors that have no noise."""
    shrink: float
    """Final over initial error, from large errors, medians over the runs."""
    worst: float
    """Final error of the worst run over the median initial one."""
    excess: float
    """Median final error over the best standard deviation."""

    @property
    def true(self) -> bool:
        """Whether it came true."""
        if self.said == UNOBSERVABLE:
            return self.kept >= KEPT
        if self.said == SECOND_ORDER:
            return self.tiny >= KEPT
        return self.shrink <= SHRUNK


UNOBSERVABLE, SECOND_ORDER, OBSERVABLE = SAID = (
    "unobservable",
    "observed to second order only",
    "observable",
)


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
    moving = [name for name, pose in start.poses.items() if np.any(pose.covariance)]
    return moved(start, {name: sigma * rng.standard_normal(3) for name in moving}, sigma)


def moved(start: Start, by: Mapping[str, Floats], sigma: Floats) -> Start:
    """Initial poses of some robots with given errors (3,) and standard deviations."""
    poses = dict(start.poses)
    for name, error in by.items():
        poses[name] = InitialPose(poses[name].mean + error, np.diag(sigma**2))
    return replace(start, poses=poses)


def invariant(error: Floats, place: Floats) -> Floats:
    """(e, dtheta) from (dx, dy, dtheta) at places (n, 2), shapes (n, 3)."""
    turn = error[:, 2]
    e = [error[:, 0] + place[:, 1] * turn, error[:, 1] - place[:, 0] * turn, turn]
    return np.stack(e, axis=1)


def errors(recording: Recording, start: Start, names: list[str], centre: Floats) -> Floats:
    """Invariant errors (2, 3 n) at the start and at the end of one filter run."""
    posterior = estimators.localize_recording(recording, start, FilterSettings(gate=0.0))
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
            difference[2] = wrap_angle(difference[2])
            rows.append(difference)
            places.append(0.5 * (pose[:2] + true[:2]) - centre)
        found.append(invariant(np.array(rows), np.array(places)).ravel())
    return np.array(found)


def directions(reference: ReferenceTrajectories) -> tuple[Floats, Floats, Floats]:
    """Scaled information about (e, dtheta) of the whole log: eigenvalues, vectors, scales."""
    steps = reference.noise.shape[1]
    Y = window_information(reference, np.array([0]), steps, framed=False)[0]
    return to_invariant(reference, Y)


def to_invariant(reference: ReferenceTrajectories, Y: Floats) -> tuple[Floats, Floats, Floats]:
    """Back from the pose at the end: z = A x, so that the information of z is A^-T Y A^-1."""
    n = len(reference.robots)
    A = np.eye(3 * n)
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    for i in range(n):
        p = reference.pose[i, -1, :2] - centre
        A[3 * i, 3 * i + 2], A[3 * i + 1, 3 * i + 2] = p[1], -p[0]
    back = np.linalg.inv(A)
    scale = np.tile([OBSERVED_POSITION_SIGMA, OBSERVED_POSITION_SIGMA, OBSERVED_HEADING_SIGMA], n)
    value, vector = np.linalg.eigh(back.T @ Y @ back * scale[:, None] * scale)
    return value, vector, scale


def judge(
    kind: str, recording: Recording, silent: Recording, rng: np.random.Generator
) -> list[Verdict]:
    """Every joint direction of one log against filter runs; tiny errors without noise."""
    reference = build_reference(recording, NoiseSettings(), NOISE_STEP_S)
    names = [robot.name for robot in reference.robots]
    value, vector, scale = directions(reference)
    centre = reference.pose[:, :, :2].reshape(-1, 2).mean(axis=0)
    start = from_truth(recording, (0.1, 0.1, 0.1))
    value = np.maximum(value, 1e-6)
    runs = [errors(recording, drawn(start, LARGE, rng), names, centre) for _ in range(DRAWS)]
    along = np.einsum("rtd,dk->trk", np.array(runs) / scale, vector)
    before, after = np.median(np.abs(along), axis=1)
    most = np.max(np.abs(along[1]), axis=0)
    bent = any(not one.hidden for one in asked(kind, recording).unobservable)
    verdicts = []
    for k, information in enumerate(value):
        said, kept = OBSERVABLE, [np.nan, np.nan]
        if information < 1.0:
            said = SECOND_ORDER if bent else UNOBSERVABLE
            kept = [
                left(log, start, names, centre, vector[:, k] * scale, sigma)
                for log, sigma in ((recording, SMALL), (silent, TINY))
            ]
        best = 1.0 / np.sqrt(information)
        verdicts.append(
            Verdict(kind, said, *kept, after[k] / before[k], most[k] / before[k], after[k] / best)
        )
    return verdicts


def left(
    log: Recording, start: Start, names: list[str], centre: Floats, z: Floats, sigma: Floats
) -> float:
    """Share of an initial error along one direction z (3 n,) that is left at the end.

    From two runs with errors to either side, the largest of one standard deviation: their
    difference holds nothing of what odometry and ranges add to both.
    """
    step = z / np.max(np.abs(z) / np.tile(sigma, len(names)))
    ends = []
    for sign in (1.0, -1.0):
        by = {}
        for name, (ex, ey, turn) in zip(names, sign * step.reshape(-1, 3), strict=True):
            x, y = start.poses[name].mean[:2] - centre
            by[name] = np.array([ex - y * turn, ey + x * turn, turn])
        ends.append(errors(log, moved(start, by, sigma), names, centre)[1])
    weight = (
        step
        / np.tile(
            [OBSERVED_POSITION_SIGMA, OBSERVED_POSITION_SIGMA, OBSERVED_HEADING_SIGMA], len(names)
        )
        ** 2
    )
    return float((ends[0] - ends[1]) @ weight / (2.0 * step @ weight))


def asked(kind: str, recording: Recording) -> Analysis:
    """The exact analysis of the team as it drove."""
    setup = setup_of(recording)
    if kind == ON_LINE:
        setup = replace(setup, in_line=frozenset(range(len(setup.nodes))))
    return analyse(setup)


def agreement(logs: int) -> list[str]:
    """The table of what was said and what came."""
    rng = np.random.default_rng(6)
    kept: list[Verdict] = []
    per_log: dict[str, list[tuple[bool, bool]]] = {}
    for index in range(logs):
        kind, keys = scenario(rng, index)
        chosen = load_scenario("shi-sim", keys)
        recording = simulate(chosen)
        verdicts = judge(kind, recording, without_noise(chosen), rng)
        kept += verdicts
        seen = sum(one.said == OBSERVABLE for one in verdicts)
        same = asked(kind, recording).rank == seen
        per_log.setdefault(kind, []).append((all(one.true for one in verdicts), same))
    lines = [
        (
            f"{logs} logs of {SECONDS:g} s, {DRAWS} filter runs each from initial errors of "
            f"{LARGE[0]:g} m and {LARGE[2]:g} rad (large); two from errors along each direction "
            f"not observable, of {SMALL[0]:g} m and {SMALL[2]:g} rad at most (small), and of "
            f"{TINY[0]:g} m and {TINY[2]:g} rad (tiny)."
        ),
        "",
        "| said of a direction | directions | criterion | met by | median | worst |",
        "|---|---|---|---|---|---|",
        *(line for said in SAID for line in criteria([one for one in kept if one.said == said])),
        "",
        NOTES,
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


NOTES = """\
All runs of a log share its noise, so that by chance one direction in 400 ends beyond 3 best
standard deviations, and one in 16 000 beyond 4.

Observability is local: from a large error the filter, which linearizes, may lose a team in a single
run. And on the line a large error across it, which ranges show to second order only, lengthens them
and so spoils the place along it.

Observed to second order: a robot on the line of both anchors. Off that line by y, at distance d, a
range changes by y^2 / (2 d); and the filter, which linearizes at its estimate beside the line,
learns the more the further that is. So larger errors shrink there in part, and so may small ones
where noise takes the estimate off the line; tiny ones without noise stay."""


def criteria(own: list[Verdict]) -> list[str]:
    """Rows of the table for the directions of which one thing was said."""
    if len(own) == 0:
        return []
    said = own[0].said
    rows: list[tuple[str, str, float]] = {
        UNOBSERVABLE: [
            ("of a small initial error at least {} is left", "kept", KEPT),
            ("the same of a tiny one, without noise", "tiny", KEPT),
        ],
        SECOND_ORDER: [
            ("of a small initial error at least {} is left", "kept", KEPT),
            ("the same of a tiny one, without noise", "tiny", KEPT),
        ],
        OBSERVABLE: [
            ("in the median run a large error falls below {} of itself", "shrink", SHRUNK),
            ("it does so in every single run", "worst", SHRUNK),
            ("in the median run it ends within {} best standard deviations", "excess", BOUND),
        ],
    }[said]
    lines = []
    for text, name, limit in rows:
        values = np.array([getattr(one, name) for one in own])
        met = values >= limit if said != OBSERVABLE else values <= limit
        worst = np.min(values) if said != OBSERVABLE else np.max(values)
        lines.append(
            f"| {said} | {len(own)} | {text.format(f'{limit:g}')} | {np.sum(met)} | "
            f"{np.median(values):.2f} | {worst:.2f} |"
        )
    return lines


def best_of(work: Callable[[], object], times: int = 5) -> tuple[float, float]:
    """Shortest of some runs: s by the clock, and s of processor time, processes included."""
    spent = []
    for _ in range(times):
        begin, worked = perf_counter(), sum(os.times()[:4])
        work()
        spent.append((perf_counter() - begin, sum(os.times()[:4]) - worked))
    return min(wall for wall, _ in spent), min(busy for _, busy in spent)


def timings() -> list[str]:
    """What the two forms of the command cost."""
    five = simulate(load_scenario("shi-sim", {}))
    fifty = simulate(load_scenario("shi-sim", {"team.moving": 48, "duration": 60.0}))
    fast = {"sensors.range.rate": 100.0, "sensors.odometry.rate": 100.0, "duration": 300.0}
    everyone = ("observability", "--moving", "50")
    processes = [everyone, (*everyone, "--parallel", "all"), (*everyone, "--in-line", "all")]
    with TemporaryDirectory() as folder:
        log = Path(folder) / "five.mcap"
        with log.open("wb") as file:
            save(file, simulate(load_scenario("shi-sim", fast)), {})
        rows = [
            (f"`clt {' '.join(words)}`", best_of(partial(wall, *CLT, *words)))
            for words in processes
        ]
        windowed = best_of(partial(wall, *CLT, "observability", str(log)))
    rows += [
        ("`clt observability LOG`: 300 s, five robots, odometry and ranges at 100 Hz", windowed),
        ("300 s, five robots, windows of 10 s, log in memory", best_of(lambda: along(five))),
        ("60 s, fifty robots, windows of 10 s, log in memory", best_of(lambda: along(fifty), 1)),
    ]
    head = "| work (commands: the whole process) | s | s of processor time |"
    lines = [f"| {name} | {clock:.2f} | {busy:.2f} |" for name, (clock, busy) in rows]
    return [head, "|---|---|---|", *lines]


def along(recording: Recording) -> None:
    evaluate_windows(build_reference(recording, NoiseSettings(), NOISE_STEP_S), 10.0, framed=False)


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
