"""How `clt localize` and `clt init` come by initial poses, and what they say about them."""

from __future__ import annotations

from dataclasses import replace
from math import degrees

from clt.cli.compiling import announce_compilation
from clt.cli.console import Console
from clt.cli.messages.initialization import reason_text
from clt.core.diagnostics import Diagnostic, Severity
from clt.core.document import Document
from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.core.settings import read_toml
from clt.core.start import Start
from clt.estimation.initial import any_moves, initialize, uncertain_robots
from clt.initialization.given.poses import from_poses
from clt.initialization.given.truth import with_heading
from clt.initialization.status import Initialization
from clt.model.settings import FilterSettings


def find_initial_poses(
    recording: Recording,
    method: str,
    settings: FilterSettings,
    console: Console,
    ego: str | None = None,
    *,
    kept: bool = False,
) -> tuple[str, Initialization]:
    """Initial poses by one of `clt.cli.options.INIT_METHODS`, and the method that `auto` chose.

    `pairwise` gives them in the frame of the `ego`, else of the first moving robot; `auto` takes
    it in the frame of an ego with fewer than two static robots. Says which cannot be located;
    those that are open are no lack where what follows has `kept` every hypothesis.
    Raises CltError where nothing can be initialized at all.
    """
    with announce_compilation(console):
        chosen = initialize(recording, method, settings, ego)
    used, found = chosen.method, chosen.found
    if len(chosen.references) > 0:
        console.say(
            f"initial poses: from the ground truth of {', '.join(chosen.references)}, what is "
            "surveyed and ranges between pairs"
        )
    elif used == "pairwise":
        console.say(f"initial poses: from ranges between pairs, in the frame {found.frame}")
    if used == "record":
        console.say("initial poses: from the log's own record")
    elif used == "motion":
        print_motion_start(found, recording, console)
    else:
        print_notes(found, console)
        kept = kept and used == "pairwise" and len(chosen.references) == 0
        warn_uncertain_robots(found, console, kept=kept)
    return used, found


def print_notes(found: Initialization, console: Console) -> None:
    """Say what was left out and what was assumed."""
    console.report(found.notes)
    console.report(found.assumed)


def complete_start(
    recording: Recording, start: Start, file: str, settings: FilterSettings, console: Console
) -> Start:
    """A start in the world with the robots that a `file` of poses leaves out, placed by ranges.

    Says which cannot be placed, why, and how to take the ground truth of those that have it.
    """
    from clt.initialization.given.known import (
        complete_given_start,
        robots_with_unused_truth,
        robots_without_pose,
    )

    left = robots_without_pose(recording, start)
    if len(left) == 0 or recording.ranges.stamp.size == 0:
        return start
    try:
        with announce_compilation(console):
            found = complete_given_start(recording, start, settings)
    except CltError as error:
        reason = {"file": file, "error": str(error)}
        console.report([Diagnostic("file_incomplete", ", ".join(left), "partial", reason)])
    else:
        names = ", ".join(left)
        console.say(f"initial poses of {names}: not in {file}; from ranges between pairs")
        print_notes(found, console)
        warn_uncertain_robots(found, console)
        start = found.start
    known = robots_with_unused_truth(recording, start)
    if len(known) > 0:
        where = {"file": file}
        console.report([Diagnostic("truth_beside_file", ", ".join(known), "warning", where)])
    return start


def find_start(
    recording: Recording,
    init: str | Document,
    settings: FilterSettings,
    console: Console,
    ego: str | None = None,
    *,
    kept: bool,
) -> Start:
    """The start of a filter by one of the same methods or from a TOML file.

    In the frame of an `ego` a file without a table for it gives relative poses; in the world one
    with the poses of some robots is completed. Whether the filter
    has `kept` all hypotheses decides whether an open start is reported as a lack.
    Raises UsageError for a file that makes no sense, CltError where no robot can be initialized.
    """
    if isinstance(init, Document):
        start = from_poses(recording, read_toml(init), str(init), settings.initial.sigma, ego)
        if ego is not None:
            return start
        return complete_start(recording, start, str(init), settings, console)
    used, found = find_initial_poses(recording, init, settings, console, ego, kept=kept)
    return start_if_any_moves(found, recording, used, relative=ego is not None)


def start_if_any_moves(
    found: Initialization, recording: Recording, method: str, *, relative: bool = False
) -> Start:
    """The poses of the robots that are certain, in the frame of a robot if `relative`.

    Raises CltError if no moving one is, with the remedies that the log allows.
    """
    start = found.start
    if any_moves(start, recording):
        return start
    truths = (recording.truth.get(name) for name in recording.odometry)
    headed = any(truth is not None and with_heading(truth).stamp.size > 0 for truth in truths)
    remedies = ["give poses in a TOML file (--init FILE)"]
    remedies += ["start from the ground truth (--init truth)"] if headed else []
    if not relative and len(recording.odometry) + len(recording.team.static) > 1:
        remedies.append("ask for relative poses (--frame ego:NAME --init pairwise)")
    options = ", ".join(remedies[:-1]) + (", or " if len(remedies) > 1 else "") + remedies[-1]
    doubt = found.contradiction
    doubted = doubt is not None and any(one.why == doubt for one in found.robots.values())
    reason = reason_text(doubt) if doubted else "the reasons are above"
    raise CltError(f"no robot can be initialized from {method} ({reason}); {options}")


def warn_uncertain_robots(found: Initialization, console: Console, *, kept: bool = False) -> None:
    """Say which robots have no certain pose, and why: once for all that share a reason."""
    reasons: dict[tuple[str, str, Severity], list[str]] = {}
    whys: dict[str, Diagnostic] = {}
    for name, robot, why, severity in uncertain_robots(found, kept=kept):
        text = reason_text(why)
        whys[text] = why
        reasons.setdefault((robot.status, text, severity), []).append(name)
    for (status, text, severity), names in reasons.items():
        values = {**whys[text].values, "status": status}
        console.report(
            [replace(whys[text], subject=", ".join(names), severity=severity, values=values)]
        )


def print_motion_start(found: Initialization, recording: Recording, console: Console) -> None:
    """Say which robots start where, and which cannot be located and why."""
    frame = "the surveyed positions" if found.surveyed else "ranges (Shi's convention)"
    console.say(f"initial poses: from motion, in the frame of {frame}")
    print_notes(found, console)
    warn_uncertain_robots(found, console)
    for name, robot in found.robots.items():
        if robot.status == "ok" and robot.pose is not None and name in recording.odometry:
            x, y, heading = robot.pose.mean
            console.detail(
                f"  {name} starts at x {x:.3f} m, y {y:.3f} m, heading {degrees(heading):.1f} deg"
            )
