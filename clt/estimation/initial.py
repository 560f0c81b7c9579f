"""Initial poses by the name of a method: a recording in, what is known of every robot out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from clt.core.diagnostics import Diagnostic, Severity
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.core.start import Start
from clt.initialization.given.recorded import from_record
from clt.initialization.given.truth import from_truth
from clt.initialization.status import Initialization, RobotStatus, from_given_start
from clt.model.settings import FilterSettings


@dataclass(frozen=True)
class NamedInitialization:
    """Initial poses and where they come from."""

    method: str
    """truth, pairwise, motion, or record; what `auto` chose."""
    found: Initialization
    references: tuple[str, ...] = ()
    """Robots whose ground truth the others were placed from."""


def initialize(
    recording: Recording, method: str, settings: FilterSettings, ego: str | None = None
) -> NamedInitialization:
    """Initial poses by `auto`, `motion` (Shi), `pairwise` (Li) or `truth`.

    `pairwise` gives them in the frame of the `ego`, else of the first moving robot; `auto` takes
    it in the frame of an ego with fewer than two static robots.
    Raises CltError where nothing can be initialized at all.
    """
    few = len(recording.team.static) < 2
    recorded = from_record(recording) if method == "auto" else None
    if recorded is None and method == "auto" and ego is not None and few:
        method = "pairwise"
    if method == "truth":
        start = from_truth(recording, settings.initial.sigma)
        lack = Diagnostic("start_without_truth")
        return NamedInitialization(method, from_given_start(start, recording.team, lack))
    if method == "pairwise":
        from clt.initialization.pairwise.team import from_pairwise  # noqa: PLC0415 - slow

        return NamedInitialization(method, from_pairwise(recording, settings, ego))
    if recorded is not None:
        lack = Diagnostic("start_not_recorded")
        return NamedInitialization("record", from_given_start(recorded, recording.team, lack))
    if method == "auto" and ego is None and few:
        from clt.initialization.given.known import from_references  # noqa: PLC0415 - slow

        placed = from_references(recording, settings)
        if placed is not None:
            names, found = placed
            return NamedInitialization("pairwise", found, tuple(names))
    from clt.initialization.motion.motion import from_motion  # noqa: PLC0415 - slow

    found = from_motion(recording, settings)
    if found.contradiction is not None:
        from clt.estimation.contradiction import explained  # noqa: PLC0415 - slow

        found = explained(recording, found, settings)
    return NamedInitialization("motion", found)


def uncertain_robots(
    found: Initialization, *, kept: bool
) -> Iterator[tuple[str, RobotStatus, Diagnostic, Severity]]:
    """The robots without a certain pose, why, and how much that matters.

    Those that are open are no lack where what follows has `kept` every hypothesis.
    """
    for name, robot in found.robots.items():
        if robot.status != "ok" and robot.why is not None:
            yield name, robot, robot.why, "warning" if kept and robot.open else "partial"


def any_moves(start: Start, recording: Recording) -> bool:
    """Whether a moving robot has an initial pose, without which nothing can be estimated."""
    return any(name in recording.odometry for name in start.poses)


def lacks(chosen: NamedInitialization, *, kept: bool) -> tuple[Diagnostic, ...]:
    """What is not certain of initial poses, robot by robot, behind what was assumed for them."""
    found = chosen.found
    if chosen.method == "record":
        return ()
    kept = kept and chosen.method == "pairwise" and len(chosen.references) == 0
    robots = (
        replace(why, subject=name, severity=severity, values={**why.values, "status": robot.status})
        for name, robot, why, severity in uncertain_robots(found, kept=kept)
    )
    return (*found.notes, *found.assumed, *robots)


def complete(
    recording: Recording, start: Start, settings: FilterSettings
) -> tuple[Start, tuple[Diagnostic, ...]]:
    """A start in the world with the robots that it leaves out, placed by ranges if they can be."""
    from clt.initialization.given.known import (  # noqa: PLC0415 - slow
        complete_given_start,
        robots_without_pose,
    )

    left = robots_without_pose(recording, start)
    if len(left) == 0 or recording.ranges.stamp.size == 0:
        return start, ()
    try:
        found = complete_given_start(recording, start, settings)
    except CltError as error:
        reason = {"file": "init", "error": str(error)}
        return start, (Diagnostic("file_incomplete", ", ".join(left), "partial", reason),)
    return found.start, lacks(NamedInitialization("given", found), kept=False)
