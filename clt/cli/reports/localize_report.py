"""What `clt localize` records about a run in its result log, and what it prints."""

from __future__ import annotations

import json
from math import degrees
from pathlib import Path

from clt.cli.console import Console
from clt.cli.provenance import run_record
from clt.core.printable import count_text
from clt.core.recording import Poses
from clt.estimation.pipeline import EstimationResult
from clt.model.settings import FilterSettings


def localize_record(
    inputs: dict[str, str],
    choices: dict[str, str],
    settings: FilterSettings,
    result: EstimationResult,
    timings: dict[str, float],
    console: Console,
) -> dict[str, str]:
    """The `clt.run` record of a result log."""
    earlier = result.recording.run
    start = {
        name: {
            "x": float(pose.mean[0]),
            "y": float(pose.mean[1]),
            "heading": float(pose.mean[2]),
            "covariance": pose.covariance.tolist(),
            "stamp_ns": result.start.stamp,
        }
        for name, pose in result.start.poses.items()
    }
    kept = {key: earlier[key] for key in ("calibration", "seed", "ranging") if key in earlier}
    sent = result.posterior.traffic
    return kept | run_record(
        inputs,
        **choices,
        **({"traffic": sent} if len(sent) > 0 else {}),
        config=settings.model_dump(mode="json"),
        noise=dict(result.noise),
        initial_poses=start,
        timings=timings,
        warnings=console.warnings,
        input_run=json.dumps(dict(earlier)),
    )


def print_localize_summary(
    console: Console,
    result: EstimationResult,
    log: Path,
    choices: dict[str, str],
    timings: dict[str, float],
    as_json: bool,
) -> None:
    """What was estimated: one object on stdout, or a line per robot on stderr."""
    seen = result.posterior.innovations.accepted
    last = {name: final_pose(poses) for name, poses in result.recording.estimate.items()}
    if as_json:
        ranges = {"used": int(seen.sum()), "rejected": int((~seen).sum())}
        head = {"log": str(log), **choices, "final": last, "ranges": ranges}
        said = {"warnings": console.warnings, "diagnostics": console.diagnostics}
        print(json.dumps({**head, "timings": timings, **said}, allow_nan=False))
        return
    compiled = f", compiled in {timings['compile_s']:.1f} s" if timings["compile_s"] > 0.0 else ""
    console.say(
        f"{log}: {count_text(len(last), 'robot')}, {count_text(seen.size, 'range')}, "
        f"{int((~seen).sum())} rejected, "
        f"filtered in {timings['filter_s']:.2f} s{compiled}"
    )
    for name, pose in last.items():
        x, y, heading = pose["mean"]
        s_x, s_y, s_heading = pose["sigma"]
        console.say(
            f"  {name} ends at x {x:.3f} m, y {y:.3f} m, heading {degrees(heading):.1f} deg "
            f"(sigma {s_x:.3f} m, {s_y:.3f} m, {degrees(s_heading):.1f} deg)"
        )


def final_pose(poses: Poses) -> dict[str, list[float]]:
    """The last pose of a trajectory: mean and standard deviation of (x, y, heading), m and rad."""
    mean = [float(column[-1]) for column in (poses.x, poses.y, poses.heading)]
    covariance = poses.covariance
    sigma = [0.0] * 3 if covariance is None else covariance[-1].diagonal().clip(0.0) ** 0.5
    return {"mean": mean, "sigma": [float(value) for value in sigma]}
