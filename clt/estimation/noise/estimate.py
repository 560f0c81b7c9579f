"""How noisy the sensors of a log are, from the log itself.

What a log or a data sheet states is where the search begins. The error-state filter runs over the
log, thinned, with one noise after another; what makes its innovations most probable is taken, and
what is stated is left only for something clearly better. A maximum of likelihood is overconfident,
as an error that lasts is seen only a few times in one log: such errors are made wider before use.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from clt.core.diagnostics import Diagnostic
from clt.core.recording import Recording
from clt.core.start import InitialPose, Start
from clt.estimation.noise.kinds import (
    GRIDS,
    PLATFORMS,
    STATED,
    Platform,
    Values,
    pinned_kinds,
    with_noise,
)
from clt.estimation.noise.search import MIN_GAIN, NoiseSearch
from clt.estimation.noise.thinning import thin_recording
from clt.filters.kalman.free import use_first_estimates
from clt.filters.kalman.gaussian import solve_eskf
from clt.filters.kalman.trail import cut_problem
from clt.model.choices import FrameSpec
from clt.model.problem import Problem, build_problem
from clt.model.settings import FilterSettings

MIN_RANGES = 60
"""With fewer ranges nothing is estimated."""
SETTLED_SHARE = 0.25
"""Of a log, after which robots that were lost at first count as found."""
SLOW_FACTOR, MIN_SLOW_S = 2.0, 3.0
"""How much wider than the most probable value slow errors are used, and how slow at least, s."""
WHITE_SHARE, MAX_WHITE_FLOOR_M = 0.3, 0.03
OFFSET_SHARE, MAX_OFFSET_FLOOR_M = 0.5, 0.05
"""White noise and offsets beside them are at least such a share of them, or so large, m."""


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise to filter with."""

    settings: FilterSettings
    """Those given, with what the log shows in place of what is stated."""
    diagnostics: tuple[Diagnostic, ...] = ()


def estimate_noise(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec
) -> NoiseEstimate:
    """The noise of a log from a start, but for what the settings give themselves.

    Raises CltError where nothing can be estimated.
    """
    whole = build_problem(recording, start, settings, view, with_outputs=False)
    pinned = pinned_kinds(settings)
    if whole.ranges.row.size < MIN_RANGES or {"odometry", *GRIDS} <= pinned:
        return NoiseEstimate(settings)
    stated = not any(found.kind == "odometry_noise_assumed" for found in whole.diagnostics)
    short, plain = thin_recording(recording, settings)
    start = settled_start(short, start, plain, view)
    search = NoiseSearch(
        short, start, plain, view, use_first_estimates(whole, settings), whole.drivers,
        whole.end, usual_values(whole, settings), pinned,
    )  # fmt: skip
    own = without_pinned(STATED, pinned)
    classes = [without_pinned(each._asdict(), pinned) for each in PLATFORMS.values()]
    if "odometry" in pinned:
        chosen = search.search([own])
    else:
        chosen = search.search(classes)
        if stated:
            nearby = search.search_near(chosen, own)
            if search.better(chosen, nearby, MIN_GAIN) is chosen:
                chosen = better_on_the_whole(recording, start, settings, view, chosen, nearby)
            else:
                chosen = nearby
    used = widened(chosen, pinned)
    changed = {key: value for key, value in used.items() if value != usual(settings, key)}
    values = {"noise": changed, "runs": len(search.found)}
    found = Diagnostic("noise_estimated", "", "information", values)
    return NoiseEstimate(with_noise(settings, used), (found,) if len(changed) > 0 else ())


def without_pinned(values: Values, pinned: frozenset[str]) -> Values:
    """Values of odometry without the kinds that settings give."""
    growing = Platform._fields[:3] if "odometry" in pinned else ()
    turns = ("scale_omega",) if "scale" in pinned else ()
    return {key: value for key, value in values.items() if key not in {*pinned, *growing, *turns}}


def usual(settings: FilterSettings, key: str) -> object:
    """The value of a kind of noise in the settings."""
    if key.startswith("outliers."):
        return getattr(settings.outliers, key.removeprefix("outliers."))
    return getattr(settings.noise, key)


def usual_values(problem: Problem, settings: FilterSettings) -> dict[str, float]:
    """What each kind of noise is where nothing is chosen."""
    values = {key: float(usual(settings, key) or 0.0) for key in GRIDS}  # type: ignore[arg-type]
    values["sigma_range"] = float(np.sqrt(np.median(problem.ranges.variance)))
    return values


def settled_start(
    recording: Recording, start: Start, settings: FilterSettings, view: FrameSpec
) -> Start:
    """A start at which no robot is lost: a later one, where one was and has been found.

    Noise that explains a wrong start would explain everything.
    """
    if view.kind != "world":
        return start
    whole = build_problem(recording, start, settings, view, lasting_range_errors=True)
    later = whole.start + round(SETTLED_SHARE * (whole.end - whole.start))
    problem = cut_problem(whole, whole.start, later)
    solution = solve_eskf(problem, settings)
    if solution.found is None or not np.any(solution.found):
        return start
    poses = dict(start.poses)
    for b, name in enumerate(problem.robots):
        last = np.flatnonzero(problem.outputs.robot == b)[-1]
        poses[name] = InitialPose(solution.mean[last], solution.covariance[last])
    return replace(start, stamp=later, poses=poses, hypotheses=())


def better_on_the_whole(
    recording: Recording,
    start: Start,
    settings: FilterSettings,
    view: FrameSpec,
    one: Values,
    other: Values,
) -> Values:
    """The one noise where it is clearly better for the whole log as it is used, else the other."""
    found = []
    for values in (one, other):
        trial = with_noise(settings, widened(values, pinned_kinds(settings)))
        problem = build_problem(recording, start, trial, view, lasting_range_errors=True)
        density = solve_eskf(problem, trial).log_density
        found.append(-np.inf if density is None else float(np.sum(density)))
    return one if found[0] > found[1] + MIN_GAIN else other


def widened(chosen: Values, pinned: Collection[str]) -> Values:
    """Noise to filter with, from the most probable; what is pinned stays."""
    slow = chosen.get("slow")
    if not slow:
        return chosen
    wide = {
        "slow": SLOW_FACTOR * slow,
        "slow_time": max(MIN_SLOW_S, chosen.get("slow_time") or MIN_SLOW_S),
    }
    offset = min(OFFSET_SHARE * wide["slow"], MAX_OFFSET_FLOOR_M)
    wide["offset"] = max(offset, chosen.get("offset") or 0.0)
    white = chosen.get("sigma_range")
    if white:
        wide["sigma_range"] = max(min(WHITE_SHARE * wide["slow"], MAX_WHITE_FLOOR_M), white)
    return {**chosen, **{key: value for key, value in wide.items() if key not in pinned}}
