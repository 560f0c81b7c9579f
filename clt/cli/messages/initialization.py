"""What is known of a start, in words: why a robot has no certain pose, and what was assumed."""

from __future__ import annotations

from clt.cli.messages.causes import cause_text
from clt.cli.messages.words import Texts, fill_template
from clt.core.diagnostics import Diagnostic

STATED = (
    "state the noise where it is smaller than assumed (noise.sigma_v, noise.sigma_omega, "
    "noise.sigma_range; clt settings noise)"
)
"""A remedy: the noise that is assumed decides what ranges can distinguish."""
GIVE_ITS_POSE = f"{STATED}, or give its pose in a TOML file (--init FILE)"
CALIBRATION_REMEDY = (
    "calibrate ranges and odometry, or check noise.sigma_range, noise.sigma_v and "
    "noise.sigma_omega, or give poses in a TOML file (--init FILE)"
)
CONTRADICTIONS = {
    "ranges_contradict": "the ranges contradict each other, those of {pair} most",
    "ranges_biased": "the ranges contradict each other, those of {pairs} may be biased",
    "start_misfit": "ranges and odometry contradict each other (mean NIS {mean_nis:.1f})",
}
"""What leaves a whole start in doubt."""
DRIVE_REMEDY = f"let both robots drive in curves in the first {{span_s}} s, or {GIVE_ITS_POSE}"


def contradiction_text(why: Diagnostic) -> str:
    """How ranges contradict each other, and the likely cause or what to check."""
    cause = why.values.get("cause")
    what = fill_template(CONTRADICTIONS[why.kind], why)
    if cause is not None:
        return f"{what}; likely cause: {cause_text(cause)}"
    return f"{what}: {CALIBRATION_REMEDY}"


def open_pair_pose_text(why: Diagnostic) -> str:
    """How wide a relative pose is, or how many there are, and the remedy."""
    what = fill_template(
        "{count} poses explain the ranges (this one with probability {probability:.3f})"
        if why.values["count"] > 1
        else "its pose is known only to {sigma_m:.2f} m and {sigma_heading:.2f} rad",
        why,
    )
    unseen = "" if why.values["observable"] else ": not observable yet"
    return f"{what}{unseen}; {fill_template(DRIVE_REMEDY, why)}"


REASONS: Texts = {
    "start_without_odometry": "no odometry",
    "start_without_truth": "no truth with heading, or no odometry, at the start",
    "start_not_recorded": "no initial pose in the record",
    "joins_late": "it joins {late_s:.1f} s after the others: left out of the start, whose poses "
    "hold at one instant; to begin when it joins, give the poses at that time in a TOML file "
    "(--init FILE)",
    "ends_before_start": "its odometry ends before the others start: left out of the start",
    "no_static_robot": "no static robot: the whole team may turn or shift unseen; two are needed",
    "one_static_robot": "only one static robot, {static}: the whole team may turn or shift unseen; "
    "two are needed",
    "one_known_static_robot": "only one static robot, {static}: the whole team may turn around its "
    "known position unseen; the pose of one moving robot in a TOML file (--init FILE) or a second "
    "static robot is needed",
    "layout_too_sparse": "too few ranges between the static robots to place {robots}",
    "too_many_layouts": "too many layouts fit the ranges between the static robots {robots}",
    "too_few_ranges": "too few ranges to place it",
    "layout_mirrored": "ranges alone do not distinguish the layout from its mirror image; "
    "let the robots turn",
    "layout_part_mirrored": "a mirror image of a part of the layout fits the ranges as well; "
    "ranges between more pairs, or its position in the log, would decide",
    "layout_not_searched": "so many layouts fit the ranges between so many static robots that not "
    "all were looked for; "
    "ranges between more pairs, or some positions in the log, would decide",
    "layout_side_open": "ranges alone do not distinguish this layout from its mirror image; "
    "give the position of a robot beside the line of the others",
    "several_poses": "{count} poses explain its ranges (the best with probability "
    f"{{probability:.2f}}); let it drive on in curves, or {GIVE_ITS_POSE}",
    "mirrored_pose": "this pose (with probability {probability:.2f}) or its mirror image, which "
    f"only turning excludes; let it turn, or {GIVE_ITS_POSE}",
    **dict.fromkeys(CONTRADICTIONS, contradiction_text),
    "never_moves": "it never moves: no heading can be found",
    "too_few_placed_robots": "no ranges to two static robots, nor to robots that are found",
    "no_pose_fits": "no pose explains its ranges",
    "moved_too_little": "it has moved too little ({moved_m:.2f} m): no heading can be found",
    "not_connected": "no chain of ranges connects it with {reference}",
    "pairs_contradict": f"the pairs of the team contradict each other; {DRIVE_REMEDY}",
    "too_many_combinations": "there are too many combinations of the poses of all pairs: some of "
    f"probability {{probability:.2f}} were left out; {DRIVE_REMEDY}",
    "open_pair_pose": open_pair_pose_text,
    "search_cut_off": "the search for the relative pose of {pairs} was cut off: there may be "
    f"others; {DRIVE_REMEDY}",
    "outliers_guessed": "of the ranges of {pairs} some fit to no pose, and which of them is a "
    f"guess; {DRIVE_REMEDY}",
}
"""Why a robot has no certain pose."""


def reason_text(why: Diagnostic | None) -> str:
    """Why a robot has no certain pose, without its name; empty where it has one."""
    if why is None:
        return ""
    text = REASONS[why.kind]
    return fill_template(text, why) if isinstance(text, str) else text(why)


def uncertain_robots_text(found: Diagnostic) -> str:
    """Robots without a certain pose, what is known of them and why."""
    return f"{found.subject} ({found.values['status']}): {reason_text(found)}"


INITIALIZATION_TEXTS: Texts = {
    **dict.fromkeys(REASONS, uncertain_robots_text),
    "start_waits_for_static": "the start waits {wait_s:.1f} s: before, fewer than two static "
    "robots are heard",
    "start_waits_for_odometry": "the start waits {wait_s:.1f} s until the odometry of {subject} "
    "begins",
    "one_known_position": "only {subject} has a known position: the frame is built from ranges",
    "layout_took_time": "it took {took_s:.0f} s of ranges until the static robots could be placed",
    "distance_left_out": "the mean distance {subject} contradicts the others by {residual_m:+.2f} "
    "m: its ranges are left out of the start",
    "static_not_placed": "too few ranges to place {subject}: left out",
    "static_places_open": "too many places are possible of {subject}: left out",
    "pair_left_out": "the ranges {subject} contradict the others: left out of the start",
    "outliers_left_out": "{subject}: {count} of the ranges (or averages of them) fit to no pose "
    "and were left out",
    "layout_residual": "the layout misses {count} mean distances by {rms_m:.3f} m rms",
    "distances_left_out": "{count} mean distance(s) contradict the others: left out",
    "layout_side_unknown": "ranges alone do not distinguish this layout from its mirror image",
    "mirror_by_convention": "ranges do not distinguish this frame from its mirror image: taken is "
    "the one in which positive omega turns counter-clockwise; three surveyed robots off one line "
    "would decide",
    "collinear_survey": "the frame rests on {anchors} alone: its mirror image at their line and, "
    "with their positions exchanged, a world turned by half fit the ranges as well; taken are the "
    "positions as given and the side on which positive omega turns counter-clockwise; a third "
    "surveyed robot off their line or one known heading would decide",
    "survey_unused": "the surveyed position of {subject} is not used in the frame of {ego}: to "
    "start in the world, give the pose of a moving robot in a TOML file (--init FILE)",
    "file_incomplete": "{subject}: no initial pose in {file}, and {error}",
    "truth_beside_file": "{subject}: the ground truth is not used beside {file}, whose frame may "
    "be another; to start from it, add to the file what `clt init LOG --method truth -o "
    "FILE` writes, or start all from it (--init truth)",
}
