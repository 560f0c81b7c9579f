"""Accuracy on shi-sim against the posterior Cramer-Rao bound, over many seeds.

    python benchmarks/shi_sim.py [--seeds 50] [--out benchmarks/results/shi_sim.md]

The bound is the covariance recursion with all Jacobians at the truth (Tichavsky et al. 1998, the
form for singular process noise): what the filter itself reports on the exact log of the same
drives. Initial errors are drawn from the initial covariance (0.01 m, 0.01 rad).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from clt.core.arrays import Floats
from clt.core.geometry import wrap_angle
from clt.core.recording import Poses, Recording
from clt.core.start import InitialPose, Start
from clt.estimation import estimators
from clt.initialization.given.truth import from_truth
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate, simulate_exact

SIGMA = (0.01, 0.01, 0.01)


@dataclass(frozen=True)
class Score:
    """Sums of one run over robots and stamps."""

    position: float
    heading: float
    bound_position: float
    bound_heading: float
    lost_position: float
    lost_heading: float
    nees: float
    nis: float
    count: int


def errors(poses: Poses, truth: Poses) -> Floats:
    """Estimate minus truth (n, 3); both are sampled alike in this scenario."""
    keep = np.isin(truth.stamp, poses.stamp)
    return np.stack(
        [
            poses.x - truth.x[keep],
            poses.y - truth.y[keep],
            wrap_angle(poses.heading - truth.heading[keep]),
        ],
        axis=1,
    )


def drawn(start: Start, seed: int) -> Start:
    """The start with errors drawn from its covariance."""
    rng = np.random.default_rng([seed, 99])
    poses = {
        name: InitialPose(
            pose.mean + np.sqrt(pose.covariance.diagonal()) * rng.normal(size=3), pose.covariance
        )
        for name, pose in start.poses.items()
    }
    return replace(start, poses=poses)


def run(recording: Recording, perfect: Recording, seed: int) -> Score:
    """Filter one log and its exact twin."""
    settings = FilterSettings()
    start = drawn(from_truth(recording, SIGMA), seed)
    posterior = estimators.localize_recording(recording, start, settings)
    bound = estimators.localize_recording(perfect, from_truth(perfect, SIGMA), settings)
    alone = estimators.dead_reckon_recording(recording, start, settings)
    sums = np.zeros(7)
    count = 0
    for name, poses in posterior.poses.items():
        e, lost = errors(poses, recording.truth[name]), errors(alone[name], recording.truth[name])
        B, P = bound.poses[name].covariance, poses.covariance
        assert B is not None
        assert P is not None
        nees = np.einsum("ni,ni->", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
        sums += [
            np.sum(e[:, :2] ** 2),
            np.sum(e[:, 2] ** 2),
            np.sum(B[:, 0, 0] + B[:, 1, 1]),
            np.sum(B[:, 2, 2]),
            np.sum(lost[:, :2] ** 2),
            np.sum(lost[:, 2] ** 2),
            nees,
        ]
        count += e.shape[0]
    return Score(*sums, float(np.mean(posterior.innovations.nis)), count)


def table(scores: list[Score]) -> str:
    """The result as a markdown table."""
    total = {
        name: sum(getattr(score, name) for score in scores) / sum(s.count for s in scores)
        for name in Score.__dataclass_fields__
        if name not in ("nis", "count")
    }
    rms = {name: float(np.sqrt(value)) for name, value in total.items()}
    p, h = rms["position"], rms["heading"]
    b = rms["bound_position"], rms["bound_heading"]
    lost = rms["lost_position"], rms["lost_heading"]
    nis = float(np.mean([score.nis for score in scores]))
    return f"""\
shi-sim, {len(scores)} seeds, 300 s, three moving robots, ESKF from a start known to 0.01 m and
0.01 rad (`python benchmarks/shi_sim.py`):

| | position RMSE, m | heading RMSE, rad |
|---|---|---|
| filter | {p:.4f} | {h:.4f} |
| Cramer-Rao bound | {b[0]:.4f} | {b[1]:.4f} |
| filter / bound | {p / b[0]:.4f} | {h / b[1]:.4f} |
| dead reckoning | {lost[0]:.3f} | {lost[1]:.3f} |
| dead reckoning / filter | {lost[0] / p:.1f} | {lost[1] / h:.1f} |

ANEES per dimension {total["nees"] / 3:.4f}, mean NIS {nis:.4f}
"""


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    scores = []
    for seed in range(1, options.seeds + 1):
        scenario = load_scenario("shi-sim", {"seed": seed})
        scores.append(run(simulate(scenario), simulate_exact(scenario), seed))
    text = table(scores)
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
