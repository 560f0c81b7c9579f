"""Three robots that range each other, and how far an estimate is off: for the tests of dpf."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from clt.core.geometry import relative_pose
from clt.core.start import InitialPose, Start
from clt.initialization.given.truth import from_truth
from clt.model.choices import FrameSpec
from clt.model.problem import build_problem
from clt.model.settings import DistributedSettings, FilterSettings
from tests.filters.teams import team_recording

SECOND = 1_000_000_000
TEAM = ("R1", "R2", "R3")


def settings(**dpf):
    return FilterSettings(gate=0.0, dpf=DistributedSettings(**dpf))


def team(seed=0, seconds=15.0, range_rate=1, **more):
    """Three robots that range each other; the anchors of the recording stay unused."""
    recording = team_recording(seed, 3, seconds, 10, range_rate, **more)
    ranges = recording.ranges
    between = (ranges.source >= 2) & (ranges.target >= 2)
    return replace(recording, ranges=part(ranges, between))


def part(stream, use):
    """Some rows of a stream."""
    fields = {name: getattr(stream, name) for name in stream.__dataclass_fields__}
    return replace(stream, **{k: v[use] for k, v in fields.items() if isinstance(v, np.ndarray)})


def start_of(recording, ego="R1", sigma=(0.1, 0.1, 0.05), error=0):
    """The team as seen from `ego`, each pose off by a draw from its sigma."""
    true = from_truth(recording, (0.0, 0.0, 0.0))
    rng = np.random.default_rng(error)
    poses = {ego: InitialPose(np.zeros(3), np.zeros((3, 3)))}
    for name in TEAM:
        if name != ego:
            seen = relative_pose(true.poses[ego].mean, true.poses[name].mean)
            drawn = seen + np.array(sigma) * rng.normal(size=3)
            poses[name] = InitialPose(drawn, np.diag(np.square(sigma)))
    return Start(true.stamp, poses, f"{ego}/base_link")


def problem_of(recording, ego="R1", **more):
    return build_problem(
        recording, start_of(recording, ego, **more), settings(), FrameSpec("ego", (ego,))
    )


def errors(recording, problem, mean, ego="R1"):
    """Distance errors of each output, (outputs,)."""
    found = np.empty(problem.outputs.stamp.size)
    for b, name in enumerate(problem.robots):
        own = problem.outputs.robot == b
        at = [
            np.column_stack([t.x, t.y, t.heading])[
                np.searchsorted(t.stamp, problem.outputs.stamp[own])
            ]
            for t in (recording.truth[ego], recording.truth[name])
        ]
        found[own] = np.linalg.norm(mean[own, :2] - relative_pose(*at)[:, :2], axis=1)
    return found


def rmse(recording, problem, solution, ego="R1"):
    return float(np.sqrt(np.mean(errors(recording, problem, solution.mean, ego) ** 2)))
