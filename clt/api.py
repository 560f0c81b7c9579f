"""What a notebook or script needs: `clt.load`, `simulate`, `localize` and `evaluate`.

The commands of the same names do the same with files, options and messages around. Errors are
`clt.core.errors.CltError`; a wrong name or key is a `UsageError`. The environment (`CLT_*`) has no
say here: what counts stands in the call.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError, UsageError
from clt.core.faults import fault_diagnostic
from clt.core.recording import Recording
from clt.core.settings import did_you_mean
from clt.core.start import Start
from clt.log.recording.clocks.findings import CLOCK_FAULT_KINDS
from clt.log.recording.clocks.timeline import timeline_faults
from clt.log.recording.clocks.usable import find_usable_part
from clt.log.recording.load import load as load_log
from clt.log.recording.logged import as_logged
from clt.metrics.align import AlignMethod
from clt.metrics.associate import Association
from clt.metrics.errors import Delta, parse_delta
from clt.metrics.evaluate import evaluate as evaluate_recording
from clt.metrics.evaluation import EvaluateOptions, Evaluation
from clt.model.choices import ENGINES, FILTER_NAMES, FILTERPY_FILTER_NAMES, parse_frame_spec
from clt.model.effective_settings import effective_settings
from clt.model.settings import FilterSettings

INIT_METHODS = ("auto", "motion", "pairwise", "truth")
"""Ways to find initial poses from a recording."""


@dataclass(frozen=True)
class Localization:
    """The estimates of one run, and how they came to be."""

    recording: Recording
    """Truth, `estimate`, `dead_reckoning`, `innovations` and team: what a result log holds."""
    filter: str
    frame: str
    init: str
    """Where the initial poses come from: motion, pairwise, truth, record or given."""
    start: Start
    settings: FilterSettings
    diagnostics: tuple[Diagnostic, ...]
    """What was found out besides; `severity` partial means that something is missing or wrong."""

    @property
    def partial(self) -> bool:
        """Something is missing or wrong: `clt localize` would end with exit code 3."""
        return any(one.severity == "partial" for one in self.diagnostics)


def load(log: str | Path, streams: str | Path | None = None) -> Recording:
    """A log as columns of numpy arrays: MCAP, `.db3`, or the folder of a ROS 2 bag.

    `streams`: a TOML file that maps the topics of logs that clt did not write. What is wrong with
    the data is counted in `faults`. Raises LogError, UsageError.
    """
    return load_log(Path(log), None if streams is None else Path(streams)).recording


def simulate(
    scenario: str | Path,
    *,
    seed: int | None = None,
    duration: float | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Recording:
    """A simulated recording with truth: of a built-in scenario by name, or of a TOML file.

    `duration` in s; `settings` are values by dotted key, as `clt simulate --set` takes them.
    Raises UsageError.
    """
    from clt.sim.scenario import load_scenario  # noqa: PLC0415 - of no use to the others
    from clt.sim.simulate import simulate as run  # noqa: PLC0415

    overrides = dict(settings or {})
    given = {"seed": seed, "duration": duration}
    overrides |= {key: value for key, value in given.items() if value is not None}
    return as_logged(run(load_scenario(str(scenario), overrides)))


def localize(
    recording: Recording,
    *,
    filter: str | None = None,  # noqa: A002 - as the option is called
    frame: str = "world",
    init: str | Mapping[str, Mapping[str, Any]] = "auto",
    engine: str = "compiled",
    settings: Mapping[str, Any] | FilterSettings | None = None,
    as_received: bool = False,
) -> Localization:
    """Estimate every robot's pose (m, rad) and covariance from ranges and odometry.

    `filter`: one of `clt.model.choices.FILTER_NAMES`; by default eskf in the world, mixture in
    relative frames. `frame`: world, `ego:NAME` or `mutual:A,B`. `init`: one of INIT_METHODS, or
    poses by robot, each with x, y, heading and optionally sigma (m, m, rad). `settings`: values by
    dotted key, as `clt localize --set` takes them. `as_received` replays the order of arrival.
    Raises UsageError for a wrong choice, CltError where nothing can be estimated.
    """
    from clt.estimation.estimators import Estimator  # noqa: PLC0415 - numba is slow to import
    from clt.estimation.pipeline import estimate  # noqa: PLC0415
    from clt.model.state_layout import require_frame_robots  # noqa: PLC0415
    from clt.observability.advice import advise  # noqa: PLC0415

    chosen = check_estimator(filter, frame, engine)
    estimator = Estimator(chosen, parse_frame_spec(frame), engine)
    if not isinstance(settings, FilterSettings):
        check_init(init)
    usable, faults = _usable(recording)
    if not isinstance(settings, FilterSettings):
        layers = (("settings", settings or {}),)
        settings = effective_settings(("settings", {}), layers, usable.team.communication)
    require_frame_robots(estimator.view, usable.team.names)
    ego = next(iter(estimator.view.names), None)
    method, start, found = _start(usable, init, settings, ego, chosen)
    advice = advise(usable, start.placed, frame)
    result = estimate(usable, start, settings, estimator, as_received=as_received)
    if len(result.recording.estimate) == 0:
        raise CltError("no estimate is finite: check the noise settings and the initial poses")
    kept = {key: value for key, value in usable.run.items() if key in {"calibration", "seed"}}
    run = kept | {"filter": chosen, "frame": frame, "engine": engine, "init": method}
    diagnostics = (*faults, *found, *advice, *result.posterior.diagnostics)
    estimates = replace(result.recording, run=run, faults=())
    return Localization(estimates, chosen, frame, method, start, settings, diagnostics)


def evaluate(
    result: Recording | Localization,
    *,
    align: AlignMethod | None = None,
    associate: Association = "interpolate",
    max_gap: float = 0.5,
    max_diff: float = 0.01,
    delta: str = "1s",
) -> Evaluation:
    """Score estimates against the truth, dead reckoning beside them; `as_dict` has all figures.

    A `Localization` is scored as its log would be, to the last digit.

    `align`: none, first, anchors, se2 or se2-per-robot; by default none where frames agree, else
    anchors, else se2. `max_gap` and `max_diff` in s; `delta`: time or way of the relative error.
    Raises CltError where there is nothing to compare.
    """
    recording = as_logged(result.recording) if isinstance(result, Localization) else result
    span: Delta = parse_delta(delta)
    options = EvaluateOptions(align, associate, max_gap, max_diff, span)
    return evaluate_recording(recording, options)


def check_estimator(filter_: str | None, frame: str, engine: str) -> str:
    """The filter that is meant. Raises UsageError for a filter, frame or engine that is none."""
    view = parse_frame_spec(frame)
    chosen = filter_ or ("eskf" if view.kind == "world" else "mixture")
    for what, value, known in (("filter", chosen, FILTER_NAMES), ("engine", engine, ENGINES)):
        if value not in known:
            raise UsageError(f"{what} {value}: unknown{did_you_mean(value, known)}")
    if chosen == "dpf" and view.kind == "world":
        raise UsageError("filter dpf estimates relative poses: use frame ego:NAME")
    if engine == "filterpy" and chosen not in FILTERPY_FILTER_NAMES:
        has = ", ".join(FILTERPY_FILTER_NAMES)
        raise UsageError(f"engine filterpy has no {chosen}; it has {has}")
    return chosen


def check_init(init: str | Mapping[str, Mapping[str, Any]]) -> None:
    """Raise UsageError for a method that does not exist."""
    if isinstance(init, str) and init not in INIT_METHODS:
        raise UsageError(f"init {init}: no such method{did_you_mean(init, INIT_METHODS)}")


def _usable(recording: Recording) -> tuple[Recording, tuple[Diagnostic, ...]]:
    """What of a recording an estimate is made from, ranged; and what was wrong with it."""
    chosen = find_usable_part(recording)
    faults = [fault for fault in recording.faults if fault.kind not in CLOCK_FAULT_KINDS]
    faults += timeline_faults(chosen.timeline, "the recording")
    found = [fault_diagnostic(fault) for fault in faults]
    if chosen.cut:
        text = "only the part with the most messages is used, as clocks disagree"
        found.append(Diagnostic("part_used", "the recording", "partial", {"text": text}))
    if len(chosen.lost) > 0:
        raise CltError(f"no {' and no '.join(chosen.lost)} in the part whose clocks hold together")
    usable = chosen.recording
    if usable.ranges.stamp.size == 0 and usable.frames.stamp.size > 0:
        from clt.ranging.recover import range_packets  # noqa: PLC0415 - numba is slow to import

        usable = range_packets(usable).recording
    lacks = [("odometry", len(usable.odometry)), ("ranges", usable.ranges.stamp.size)]
    for what, count in lacks:
        if count == 0:
            raise CltError(f"the recording has no {what}, which localizing needs")
    return usable, tuple(found)


def _start(
    recording: Recording,
    init: str | Mapping[str, Mapping[str, Any]],
    settings: FilterSettings,
    ego: str | None,
    filter_: str,
) -> tuple[str, Start, tuple[Diagnostic, ...]]:
    """The method that was used, the initial poses, and what was found out about them."""
    from clt.estimation.estimators import MULTI_HYPOTHESIS_FILTERS  # noqa: PLC0415 - numba
    from clt.estimation.initial import any_moves, complete, initialize, lacks  # noqa: PLC0415

    if not isinstance(init, str):
        from clt.initialization.given.poses import from_poses  # noqa: PLC0415 - slow

        start = from_poses(recording, init, "init", settings.initial.sigma, ego)
        if ego is not None:
            return "given", start, ()
        return ("given", *complete(recording, start, settings))
    chosen = initialize(recording, init, settings, ego)
    found = chosen.found
    if not any_moves(found.start, recording):
        raise CltError(f"no robot can be initialized from {chosen.method}")
    return chosen.method, found.start, lacks(chosen, kept=filter_ in MULTI_HYPOTHESIS_FILTERS)
