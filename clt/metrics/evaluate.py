"""One log's estimates against its truth: frames, association, alignment, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from clt.core.diagnostics import Diagnostic
from clt.core.errors import CltError
from clt.core.recording import Poses, Recording, Team
from clt.metrics.align import AlignMethod, Transform
from clt.metrics.associate import MatchedPoses, associate
from clt.metrics.doubts import divergence_warnings, missing_data_warnings, score_warnings
from clt.metrics.errors import Delta
from clt.metrics.evaluation import EstimateScores, EvaluateOptions, Evaluation
from clt.metrics.pairs import all_nis, pair_nis
from clt.metrics.register import AlignmentInput, choose_alignment, find_mirrored, register
from clt.metrics.scores import pooled_score, track_errors
from clt.metrics.tracks import check_frames, clean_tracks, frames_text, tracks_in_frames


def evaluate(recording: Recording, options: EvaluateOptions | None = None) -> Evaluation:
    """Score the estimates of a log, and dead reckoning beside them, against its truth.

    Raises CltError where there is nothing to compare or an alignment cannot be found.
    """
    options = EvaluateOptions() if options is None else options
    names = recording.team.names
    truth, unusable_truth = clean_tracks(recording.truth, "truth", headless=True)
    estimates, unusable = clean_tracks(recording.estimate, "estimate")
    reckoned, lost = clean_tracks(recording.dead_reckoning, "dead reckoning")
    _require(recording, truth, estimates)
    relative = check_frames(recording.team, truth, estimates)
    targets = tracks_in_frames(truth, estimates, names, options.max_gap)
    matched = _matched(targets, estimates, options)
    if len(matched) == 0:
        raise _no_match(targets, options)

    frame, truth_frame = frames_text(estimates), frames_text(truth)
    scene = AlignmentInput(recording.team, frame, relative, truth, matched)
    align = choose_alignment(scene, truth_frame, options.align)
    transforms = register(scene, matched, align)
    estimate = _side(recording.team, matched, transforms, options.delta, relative)
    reckoned = tracks_in_frames(reckoned, estimates, names, options.max_gap)
    baseline = _matched(targets, reckoned, options)
    own, unaligned = _baseline(scene, baseline, align, transforms)
    dead_reckoning = _side(recording.team, baseline, own, options.delta, relative)
    mirror = find_mirrored(scene)
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
        diagnostics=(
            *unusable_truth,
            *unusable,
            *lost,
            *unaligned,
            *missing_data_warnings(recording.team, truth, estimates, targets),
            *score_warnings(
                [name for name in estimates if name in targets], estimate, recording.team
            ),
            *divergence_warnings(estimate, dead_reckoning),
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
) -> dict[str, MatchedPoses]:
    """The robots with at least one pair."""
    pairs = {
        name: associate(truth[name], track, options.associate, options.max_gap, options.max_diff)
        for name, track in tracks.items()
        if name in truth
    }
    return {name: matched for name, matched in pairs.items() if len(matched.stamp) > 0}


def _no_match(truth: Mapping[str, Poses], options: EvaluateOptions) -> CltError:
    """The error where no truth pose has an estimate."""
    count = sum(len(track.stamp) for track in truth.values())
    if count == 0:
        return CltError(
            f"no truth pose has one of the ego in reach (--max-gap {options.max_gap:g} s)"
        )
    nearest = options.associate == "nearest"
    return CltError(
        f"none of {count} truth poses has an estimate "
        + (
            f"within --max-diff {options.max_diff:g} s"
            if nearest
            else f"in reach (--max-gap {options.max_gap:g} s)"
        )
        + "; do both use one clock?"
    )


def _side(
    team: Team,
    tracks: Mapping[str, MatchedPoses],
    transforms: Mapping[str, Transform],
    delta: Delta,
    relative: bool,
) -> EstimateScores:
    aligned = {name: transform_matched(m, transforms[name]) for name, m in tracks.items()}
    errors = {name: track_errors(m, delta) for name, m in aligned.items()}
    scores = {name: pooled_score([one], delta) for name, one in errors.items()}
    moving = [errors[robot.name] for robot in team.moving if robot.name in errors]
    if relative and len(moving) == 0:  # what stands still moves all the same in a body frame
        moving = list(errors.values())
    return EstimateScores(
        tracks=aligned,
        transforms={name: transforms[name] for name in aligned},
        scores={name: figures for name, figures in scores.items() if figures is not None},
        team=pooled_score(moving, delta),
    )


def transform_matched(matched: MatchedPoses, transform: Transform) -> MatchedPoses:
    """Estimates and their covariances brought into the truth's frame."""
    covariance = matched.covariance
    return replace(
        matched,
        estimate=transform.poses(matched.estimate),
        covariance=None if covariance is None else transform.covariances(covariance),
    )


def _baseline(
    scene: AlignmentInput,
    tracks: Mapping[str, MatchedPoses],
    align: AlignMethod,
    transforms: Mapping[str, Transform],
) -> tuple[Mapping[str, Transform], list[Diagnostic]]:
    """Transforms of dead reckoning: by the same rule, else the estimate's (they share a frame)."""
    if len(tracks) == 0:
        return transforms, []
    try:
        return register(scene, tracks, align), []
    except CltError as error:
        reason = Diagnostic("baseline_not_aligned", values={"error": str(error)})
        shared = next(iter(transforms.values()))
        return {name: transforms.get(name, shared) for name in tracks}, [reason]
