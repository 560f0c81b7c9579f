"""One log's estimates against its truth: frames, association, alignment, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from clt.core.errors import CltError
from clt.core.recording import Poses, Recording, Team
from clt.metrics.align import Align, Transform
from clt.metrics.associate import Matched, associate
from clt.metrics.doubts import diverged, doubts, missing
from clt.metrics.errors import Delta
from clt.metrics.evaluation import EvaluateOptions, Evaluation, Side
from clt.metrics.pairs import all_nis, pair_nis
from clt.metrics.register import Scene, choose, mirrors, register
from clt.metrics.scores import score
from clt.metrics.tracks import check_frames, clean, frame_of, in_frame
from clt.metrics.warned import Warned


def evaluate(recording: Recording, options: EvaluateOptions | None = None) -> Evaluation:
    """Score the estimates of a log, and dead reckoning beside them, against its truth.

    Raises CltError where there is nothing to compare or an alignment cannot be found.
    """
    options = EvaluateOptions() if options is None else options
    names = recording.team.names
    truth, warnings = clean(recording.truth, "truth", headless=True)
    estimates, unusable = clean(recording.estimate, "estimate")
    reckoned, lost = clean(recording.dead_reckoning, "dead reckoning")
    _require(recording, truth, estimates)
    relative = check_frames(recording.team, truth, estimates)
    targets = in_frame(truth, estimates, names, options.max_gap)
    matched = _matched(targets, estimates, options)
    if len(matched) == 0:
        raise CltError(_no_match(targets, options))

    frame, truth_frame = frame_of(estimates), frame_of(truth)
    scene = Scene(recording.team, frame, relative, truth, matched)
    align = choose(scene, truth_frame, options.align)
    transforms = register(scene, matched, align)
    estimate = _side(recording.team, matched, transforms, options.delta, relative)
    reckoned = in_frame(reckoned, estimates, names, options.max_gap)
    baseline = _matched(targets, reckoned, options)
    own, unaligned = _baseline(scene, baseline, align, transforms)
    dead_reckoning = _side(recording.team, baseline, own, options.delta, relative)
    mirror = mirrors(scene)
    innovations = recording.innovations
    return Evaluation(
        frame=frame,
        truth_frame=truth_frame,
        relative=relative,
        frames={name: track.frame.lstrip("/") for name, track in estimates.items()},
        filter=recording.run.get("filter"),
        align=align,
        options=options,
        estimate=estimate,
        dead_reckoning=dead_reckoning,
        unscored=tuple(name for name in estimates if name not in truth),
        pairs={} if innovations is None else pair_nis(innovations, recording.team),
        all_pairs=None if innovations is None else all_nis(innovations),
        mirror=mirror is not None,
        warnings=(
            *warnings,
            *unusable,
            *lost,
            *unaligned,
            *missing(recording.team, truth, estimates, targets),
            *doubts([name for name in estimates if name in targets], estimate, recording.team),
            *diverged(estimate, dead_reckoning),
            *([] if mirror is None else [mirror]),
        ),
    )


def _require(
    recording: Recording, truth: Mapping[str, Poses], estimates: Mapping[str, Poses]
) -> None:
    """Raise CltError unless there are estimates and truth to compare."""
    if len(recording.estimate) == 0:
        raise CltError("no estimates in this log; make them with `clt localize`")
    if len(estimates) == 0:
        raise CltError("no estimate has a finite pose: the filter diverged; localize again")
    if len(truth) == 0:
        raise CltError("no ground truth in this log, so nothing to compare with; see --streams")
    if len(set(truth) & set(estimates)) == 0:
        raise CltError(
            f"truth of {', '.join(truth)}, estimates of {', '.join(estimates)}: no robot has both"
        )


def _matched(
    truth: Mapping[str, Poses], tracks: Mapping[str, Poses], options: EvaluateOptions
) -> dict[str, Matched]:
    """The robots with at least one pair."""
    pairs = {
        name: associate(truth[name], track, options.associate, options.max_gap, options.max_diff)
        for name, track in tracks.items()
        if name in truth
    }
    return {name: matched for name, matched in pairs.items() if len(matched.stamp) > 0}


def _no_match(truth: Mapping[str, Poses], options: EvaluateOptions) -> str:
    count = sum(len(track.stamp) for track in truth.values())
    if count == 0:
        return f"no truth pose has one of the ego in reach (--max-gap {options.max_gap:g} s)"
    if options.associate == "nearest":
        limit = f"within --max-diff {options.max_diff:g} s"
    else:
        limit = f"in reach (--max-gap {options.max_gap:g} s)"
    return f"none of {count} truth poses has an estimate {limit}; do both use one clock?"


def _side(
    team: Team,
    tracks: Mapping[str, Matched],
    transforms: Mapping[str, Transform],
    delta: Delta,
    relative: bool,
) -> Side:
    aligned = {name: transformed(m, transforms[name]) for name, m in tracks.items()}
    scores = {name: score([m], delta) for name, m in aligned.items()}
    moving = [aligned[robot.name] for robot in team.moving if robot.name in aligned]
    if relative and len(moving) == 0:  # what stands still moves all the same in a body frame
        moving = list(aligned.values())
    return Side(
        tracks=aligned,
        transforms={name: transforms[name] for name in aligned},
        scores={name: figures for name, figures in scores.items() if figures is not None},
        team=score(moving, delta),
    )


def transformed(matched: Matched, transform: Transform) -> Matched:
    """Estimates and their covariances brought into the truth's frame."""
    covariance = matched.covariance
    return replace(
        matched,
        estimate=transform.poses(matched.estimate),
        covariance=None if covariance is None else transform.covariances(covariance),
    )


def _baseline(
    scene: Scene,
    tracks: Mapping[str, Matched],
    align: Align,
    transforms: Mapping[str, Transform],
) -> tuple[Mapping[str, Transform], list[Warned]]:
    """Transforms of dead reckoning: by the same rule, else the estimate's (they share a frame)."""
    try:
        return register(scene, tracks, align), []
    except CltError as error:
        text = f"dead reckoning cannot be aligned by itself ({error}); aligned as the estimate is"
        shared = next(iter(transforms.values()))
        return {name: transforms.get(name, shared) for name in tracks}, [Warned(text)]
