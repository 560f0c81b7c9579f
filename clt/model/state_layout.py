"""Who plays which part in a frame: the robots whose poses a state holds, and who moves them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError, UsageError
from clt.core.recording import Recording
from clt.core.settings import did_you_mean
from clt.core.start import Start
from clt.model.choices import FrameSpec
from clt.model.state_space import WORLD_REFERENCE
from clt.model.unused import is_uncertain

NO_ODOMETRY, NO_INITIAL_POSE = "no_odometry", "no_initial_pose"
"""Kinds of diagnostics: why a robot is not in the state."""


@dataclass(frozen=True)
class StateLayout:
    """Who plays which part: indices go into `names`, the robots whose odometry counts."""

    names: tuple[str, ...]
    who: tuple[int, ...]
    base: tuple[int, ...]
    left_out: tuple[Diagnostic, ...]


def choose_states(recording: Recording, start: Start, view: FrameSpec) -> StateLayout:
    """The blocks of a view. Raises CltError, UsageError where it cannot be had."""
    idle = set(recording.idle).difference(view.names)
    names, left_out = state_robots(recording, start, idle, every=view.kind != "world")
    if view.kind == "world":
        return StateLayout(
            tuple(names), tuple(range(len(names))), (WORLD_REFERENCE,) * len(names), tuple(left_out)
        )
    require_frame_robots(view, recording.team.names)
    for name in view.names:
        if name not in names:
            why = next((reason_left_out(one) for one in left_out if one.subject == name), "no pose")
            raise CltError(f"no frame of {name}: {why}")
    if view.kind == "ego":
        ego = view.names[0]
        names = [ego, *(name for name in names if name != ego)]
        if len(names) == 1:
            why = "; ".join(reason_left_out(one) for one in left_out)
            raise CltError(f"{ego} has no neighbour that can be localized: {why}")
        who = tuple(range(1, len(names)))
        return StateLayout(tuple(names), who, (0,) * len(who), tuple(left_out))
    return StateLayout(view.names, (1, 0), (0, 1), ())


def require_frame_robots(view: FrameSpec, names: Sequence[str]) -> None:
    """Raise UsageError, naming the nearest, where a view names a robot that the log has not."""
    for name in view.names:
        if name not in names:
            raise UsageError(f"--frame: no robot `{name}` in the log{did_you_mean(name, names)}")


def state_robots(
    recording: Recording, start: Start, idle: Collection[str] = (), *, every: bool = False
) -> tuple[list[str], list[Diagnostic]]:
    """Names of the robots in the state, and one diagnostic for each robot left out.

    `idle` ones are left out without one. `every`: static robots of certain position, too.
    """
    names: list[str] = []
    left_out: list[Diagnostic] = []
    for robot in recording.team.robots:
        pose = start.poses.get(robot.name)
        if robot.name in idle:
            continue
        if robot.static:
            if pose is not None and (every or is_uncertain(pose)):
                names.append(robot.name)
        elif robot.name not in recording.odometry:
            left_out.append(Diagnostic(NO_ODOMETRY, robot.name, "partial"))
        elif pose is None:
            left_out.append(Diagnostic(NO_INITIAL_POSE, robot.name, "partial"))
        else:
            names.append(robot.name)
    return names, left_out


def reason_left_out(found: Diagnostic) -> str:
    """Why a robot is not in the state, for an error that ends the run."""
    lack = "moves but has no odometry" if found.kind == NO_ODOMETRY else "has no initial pose"
    return f"{found.subject} {lack}: not localized"
