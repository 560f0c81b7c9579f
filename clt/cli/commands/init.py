"""`clt init`: where every robot starts, how sure that is, and which cannot be known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from clt.cli.common import (
    check_choice,
    read_filter_settings,
    read_for_estimate,
    refuse_two_outputs,
    require_data,
)
from clt.cli.options import (
    CalibrationOption,
    ConfigOption,
    ForceOption,
    JsonOption,
    LogArgument,
    QuietOption,
    SetOption,
    StreamsOption,
    VerboseOption,
)
from clt.cli.period import FromOption, ToOption

if TYPE_CHECKING:
    from clt.core.arrays import Floats
    from clt.initialization.status import Initialization, RobotStatus

POSES_FILE_HEADER = """\
# Initial poses by `clt init --method {method}`, for `clt localize --init FILE` on the same log.
# x, y, sigma[0], sigma[1] in m, heading, sigma[2] in rad.
"""
UNCERTAIN_POSE_COMMENT = """\
# {name} is {status}: {why}. One pose stands here; `--init {method}` would follow all.
"""
WIDENED_SIGMA_COMMENT = """\
# sigma is {factor:g} times the standard deviation that `clt init` prints: the filter will see the
# same ranges again, and would otherwise count what they say twice.
"""


def init(
    *,
    log: LogArgument,
    method: Annotated[
        str,
        typer.Option(
            help="motion: from ranges and odometry alone (Shi). pairwise: relative poses from the "
            "ranges between pairs (Li). truth: from the ground truth. "
            "auto: what the log records, else motion; where fewer than two robots stand still, "
            "from the ground truth of some robots and the ranges of pairs, if there is any."
        ),
    ] = "auto",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Poses (TOML) for localize --init."),
    ] = None,
    config: ConfigOption = None,
    sets: SetOption = [],  # noqa: B006 - typer copies it
    calibration: CalibrationOption = None,
    streams: StreamsOption = None,
    since: FromOption = None,
    until: ToOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> int:
    """Find the initial pose of every robot, or say why it cannot be known yet.

    Examples:
      clt init log.mcap
      clt init log.mcap --method motion -o poses.toml --json
    """
    import json

    from clt.cli.console import Console
    from clt.cli.inputs import Inputs
    from clt.cli.options import INIT_METHODS
    from clt.cli.period import parse_period
    from clt.log.output import STDOUT

    console = Console(quiet, verbose)
    check_choice("--method", method, INIT_METHODS)
    refuse_two_outputs(as_json, output)
    period = parse_period(since, until)
    inputs = Inputs.of(log, config=config, calibration=calibration, streams=streams)
    inputs.check(output, force)
    settings = read_filter_settings(inputs["config"], sets)

    # Slow to import: what stands above is refused at once.
    from clt.cli.initial import find_initial_poses

    _, recording = read_for_estimate(log, inputs, period, console)
    team = recording.team
    standing = len(team.moving) == 0 and len(team.static) > 0
    require_data(recording, str(log), standing=standing)
    used, found = find_initial_poses(recording, method, settings, console)
    if used == "motion" and len(recording.team.static) < 2:
        console.say("relative poses need no static robots: clt init --method pairwise")
    if output is not None:
        with inputs.output(output, force) as file:
            file.write(poses_toml(used, found, {robot.name for robot in team.static}).encode())
    if as_json:
        document = init_document(used, found) | {"diagnostics": console.diagnostics}
        print(json.dumps(document, allow_nan=False))
    elif output != STDOUT:
        print_initial_poses(found)
    return console.code


def init_document(method: str, found: Initialization) -> dict[str, Any]:
    """The object that `clt init --json` prints; null where not even a guess is possible."""
    from clt.cli.messages.initialization import reason_text
    from clt.cli.messages.render import diagnostic_text

    robots = {}
    for name, robot in found.robots.items():
        pose = robot.pose
        mean = [None] * 3 if pose is None else [float(value) for value in pose.mean]
        robots[name] = {
            "x": mean[0],
            "y": mean[1],
            "heading": mean[2],
            "covariance": None if pose is None else pose.covariance.tolist(),
            "stamp_ns": found.stamp,
            "status": robot.status,
            "probability": robot.probability,
            "why": reason_text(robot.why),
            "alternatives": [
                {
                    "x": float(other.mean[0]),
                    "y": float(other.mean[1]),
                    "heading": float(other.mean[2]),
                    "probability": other.probability,
                }
                for other in robot.alternatives
            ],
        }
    return {
        "method": method,
        "frame": found.frame,
        "surveyed": found.surveyed,
        "notes": [diagnostic_text(one) for one in (*found.notes, *found.assumed)],
        "robots": robots,
    }


def print_initial_poses(found: Initialization) -> None:
    """A line per robot on standard output, and one per alternative of those that are not ok."""
    print(f"{'robot':<8} {'x, m':>9} {'y, m':>9} {'heading':>10}  sigma (m, m, deg)    status")
    for name, robot in found.robots.items():
        print(f"{name:<8} {pose_and_sigma_columns(robot)}  {robot.status}")
        if robot.status != "ok":
            for other in robot.alternatives:
                print(
                    f"{'  or':<8} {pose_columns(other.mean)}  probability {other.probability:.3f}"
                )


def pose_and_sigma_columns(robot: RobotStatus) -> str:
    """Pose and standard deviations of one robot, in columns."""
    from math import degrees

    from clt.core.geometry import is_heading_unknown

    if robot.pose is None:
        return f"{'-':>9} {'-':>9} {'-':>10}  {'-':<19}"
    s_x, s_y, s_heading = (float(v) for v in robot.pose.covariance.diagonal().clip(0.0) ** 0.5)
    if is_heading_unknown(robot.pose.covariance[2, 2]):
        x, y = (float(value) for value in robot.pose.mean[:2])
        return f"{x:9.3f} {y:9.3f} {'-':>10}  {f'{s_x:.3f}, {s_y:.3f}, -':<19}"
    sigma = f"{s_x:.3f}, {s_y:.3f}, {degrees(s_heading):.2f}"
    return f"{pose_columns(robot.pose.mean)}  {sigma:<19}"


def pose_columns(pose: Floats) -> str:
    """x, y and heading of a pose (3,)."""
    from math import degrees

    x, y, heading = (float(value) for value in pose)
    return f"{x:9.3f} {y:9.3f} {degrees(heading):6.1f} deg"


def poses_toml(method: str, found: Initialization, still: set[str]) -> str:
    """A TOML of the poses that a filter may take, as `clt localize --init FILE` reads it.

    Robots that stand `still` need no heading.
    """
    import tomli_w

    from clt.cli.messages.initialization import reason_text
    from clt.core.geometry import is_heading_unknown

    tables: dict[str, dict[str, Any]] = {}
    for name, pose in found.start.poses.items():
        x, y, heading = (float(value) for value in pose.mean)
        sigma = [float(value) for value in pose.covariance.diagonal().clip(0.0) ** 0.5]
        unknown = name in still and is_heading_unknown(pose.covariance[2, 2])
        known = {} if unknown else {"heading": heading}
        tables[name] = {"x": x, "y": y, **known, "sigma": sigma}
    widened = WIDENED_SIGMA_COMMENT.format(factor=found.again) if found.again != 1.0 else ""
    unsure = "".join(
        UNCERTAIN_POSE_COMMENT.format(
            name=name, status=robot.status, why=reason_text(robot.why), method=method
        )
        for name, robot in found.robots.items()
        if robot.status != "ok" and name in tables
    )
    return POSES_FILE_HEADER.format(method=method) + widened + unsure + tomli_w.dumps(tables)
