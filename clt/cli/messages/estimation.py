"""What a filter's run found, in words."""

from __future__ import annotations

from collections.abc import Mapping

from clt.cli.messages.misfit import misfit_text
from clt.cli.messages.words import Texts, fill_template, first_few, times_in_words
from clt.core.diagnostics import DIVERGED, Diagnostic
from clt.core.printable import count_text

MAX_LISTED_ROBOTS = 3
"""Robots that one line names."""


def idle_static_text(found: Diagnostic) -> str:
    """Static robots that nobody ranges."""
    few = first_few(found.values["robots"], MAX_LISTED_ROBOTS)
    return f"no range touches {few}: static robots that cannot be estimated, left out"


def robot_found_text(found: Diagnostic) -> str:
    """A search that replaced an estimate."""
    vain = found.values["in_vain"]
    return (
        f"{found.subject} was lost {times_in_words(found.values['times'])}: many of its ranges "
        "contradicted the estimate, and a search found a pose that they fit"
        f"{f' ({times_in_words(vain)} in vain)' if vain > 0 else ''}"
    )


def vain_search_text(found: Diagnostic) -> str:
    """A search after which the estimate stayed."""
    return (
        f"{found.subject} looked lost {times_in_words(found.values['times'])}: many of its ranges "
        "contradicted the estimate, but a search found no pose that they fit clearly better, so "
        "the estimate stayed"
    )


def implausible_error_text(found: Diagnostic) -> str:
    """An error of odometry that nobody expects."""
    return fill_template(
        "odometry of {subject}: the error of its {what} is estimated as {value:+.3f}, "
        "{sigmas:.1f} times the standard deviation that the settings state: the filter went "
        "astray, or noise.scale, noise.scale_omega, noise.bias are too small",
        found,
    )


def fixed_ranges_text(found: Diagnostic) -> str:
    """Ranges that say nothing about any robot."""
    count = found.values["count"]
    verb = "is" if count == 1 else "are"
    return f"{count_text(count, 'range')} between static robots of known position {verb} left out"


NOISE_UNITS = {
    "sigma_range": " m", "slow": " m", "slow_time": " s", "slow_distance": " m", "offset": " m",
    "bias": " rad/s", "v_per_sqrt_m": " m/sqrt(m)", "omega_per_sqrt_rad": " rad/sqrt(rad)",
    "omega_per_sqrt_m": " rad/sqrt(m)",
}  # fmt: skip


def noise_estimated_text(found: Diagnostic) -> str:
    """What the log showed of its sensors in place of what is stated."""
    noise: Mapping[str, float | None] = found.values["noise"]
    parts = [
        f"{key if '.' in key else f'noise.{key}'} {'as stated' if value is None else f'{value:g}'}"
        f"{'' if value is None else NOISE_UNITS.get(key, '')}"
        for key, value in noise.items()
    ]
    return "noise as the log shows it: " + ", ".join(parts) + "; what --set gives is kept"


ESTIMATION_TEXTS: Texts = {
    "noise_estimated": noise_estimated_text,
    "idle_static_robots": idle_static_text,
    "odometry_noise_assumed": "the log does not give the odometry noise of {subject}: assumed "
    "{sigma_v} m/s and {sigma_omega} rad/s; set noise.sigma_v and noise.sigma_omega",
    "range_noise_assumed": "the log does not give the noise of its ranges: assumed {sigma_m} m; "
    "set noise.sigma_range",
    "odometry_gaps": "gaps in the odometry of {subject}: {count}, the longest {longest_s:.2f} s; "
    "bridged with widened noise",
    "no_odometry": "{subject} moves but has no odometry: not localized",
    "no_initial_pose": "{subject} has no initial pose: not localized",
    "unplaced_static_robot": "{subject} stands at an unknown position: its {ranges} ranges are not "
    "used; give it a pose with --init FILE",
    "ranges_after_odometry": "{count} ranges come after the end of all odometry: not used",
    "no_ranges": "no range ties the team together: the estimate is dead reckoning",
    "odometry_ends_early": "the odometry of {subject} ends {early_s:.1f} s before that of others",
    "late_arrivals": "{ranges} ranges and {odometry_samples} odometry samples arrived more than "
    "{lag_s:g} s after their stamps: these ranges are not used; raise received.lag",
    "no_delays": "every message arrived at its own stamp: the log shows no delays",
    "arrived_before_stamps": "odometry arrived {early_s:.1f} s before its stamps: the recorder's "
    "clock was wrong, so the log shows no delays",
    "unique_pose": "the pose of {subject} was unique after {after_s:.1f} s",
    "ambiguous_pose": "{subject} is ambiguous: its most probable pose at the end has probability "
    "{probability:.4f}, and {sure} is sure; longer or more winding driving of both robots would "
    "decide",
    "hypotheses_dropped": "hypotheses of probability {probability:.2f} were dropped for want of "
    "room: what became unique may be wrong; raise mixture.components (dpf: dpf.particles)",
    "robot_found": robot_found_text,
    "search_in_vain": vain_search_text,
    "odometry_errors": "odometry of {subject}: scale of v {scale_v:.4f} (sigma "
    "{sigma_scale_v:.4f}), of omega {scale_omega:.4f} (sigma {sigma_scale_omega:.4f}), bias "
    "{bias:+.4f} rad/s (sigma {sigma_bias:.4f})",
    "implausible_odometry_error": implausible_error_text,
    "traffic": "{subject} sent {messages_sent} messages, {bytes_sent} bytes, and heard "
    "{messages_heard}, {bytes_heard} bytes",
    "out_of_reach": "{subject} was out of reach of {ego} for {apart_s:.1f} of {whole_s:.1f} s: its "
    "odometry was not known meanwhile; raise dpf.reach or add links to dpf.graph",
    "fixed_ranges": fixed_ranges_text,
    "start_too_uncertain": "{subject}: {filter} is surer than many Gaussians are from the same "
    "start, which is too uncertain for one: use --filter mixture, or start from a better known "
    "pose",
    "estimate_too_uncertain": "{subject}: {filter} is surer than many Gaussians are from "
    "{since_s:.1f} s on, where its estimate is too uncertain for one: use --filter mixture",
    "misfit": misfit_text,
    "estimates_not_finite": "{count} of {total} estimates of {subject} are no numbers: left out",
    "innovations_not_finite": "{count} of {total} range innovations are no numbers: left out; look "
    "at the stamps and the noise settings",
    DIVERGED: "the estimate of {subject} has diverged: its ranges contradict it",
}
