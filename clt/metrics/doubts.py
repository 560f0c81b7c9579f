"""What an evaluation could not decide, and what its reader should know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clt.core.diagnostics import Diagnostic, Severity
from clt.core.recording import Poses, Team
from clt.metrics.evaluation import EstimateScores
from clt.metrics.tracks import ego_of_frame

MIN_MATCHED_SHARE = 0.9
"""A matched share under this is a warning."""
MAX_SINGULAR_SHARE = 0.01
"""Share of singular covariances that needs no word, e.g. of a start that is known exactly."""
MIN_INSIDE_SHARE = 0.5
"""An estimate that is off and has fewer errors than this share inside 3 sigma has diverged."""


def missing_data_warnings(
    team: Team,
    truth: Mapping[str, Poses],
    estimates: Mapping[str, Poses],
    targets: Mapping[str, Poses],
) -> list[Diagnostic]:
    """Relative truth that is short, moving robots without an estimate, truth in several frames."""
    egos = {name: ego_of_frame(track.frame, team.names) for name, track in estimates.items()}
    found: list[Diagnostic] = []
    for name, ego in egos.items():
        if ego is not None and name in truth:
            found += _short_truth_warning(name, ego, truth, targets.get(name))
    mutual = set(egos.values()) == set(estimates)  # Two robots, each in the other's frame.
    found += [
        Diagnostic("no_estimate", robot.name, "partial")
        for robot in (team.moving if not mutual else ())
        if robot.name in truth and robot.name not in {*estimates, *egos.values()}
    ]
    if len({track.frame for track in truth.values()}) > 1:
        frames = ", ".join(dict.fromkeys(track.frame for track in truth.values()))
        found.append(Diagnostic("several_truth_frames", values={"frames": frames}))
    return found


def _short_truth_warning(
    name: str, ego: str, truth: Mapping[str, Poses], target: Poses | None
) -> list[Diagnostic]:
    """One on a relative truth that holds less than either of the two that it is made of."""
    most = min(len(truth[name].stamp), len(truth[ego].stamp))
    count = 0 if target is None else len(target.stamp)
    if count >= MIN_MATCHED_SHARE * most:
        return []
    counts = {"count": count, "total": most, "ego": ego}
    severity: Severity = "partial" if count == 0 else "warning"
    return [Diagnostic("short_relative_truth", name, severity, counts)]


def divergence_warnings(estimate: EstimateScores, baseline: EstimateScores) -> list[Diagnostic]:
    """Estimates worse than dead reckoning; diverged if their own 3 sigma deny it as well."""
    found: list[Diagnostic] = []
    for name, figures in estimate.scores.items():
        plain = baseline.scores.get(name)
        if plain is None or figures.ape.rmse <= plain.ape.rmse:
            continue
        inside = 1.0 if figures.inside is None else min(figures.inside.values())
        values = {
            "rmse_m": figures.ape.rmse,
            "dead_reckoning_rmse_m": plain.ape.rmse,
            "inside_share": inside,
        }
        severity: Severity = "partial" if inside < MIN_INSIDE_SHARE else "warning"
        found.append(Diagnostic("worse_than_dead_reckoning", name, severity, values))
    return found


def score_warnings(names: Sequence[str], side: EstimateScores, team: Team) -> list[Diagnostic]:
    """Of robots with estimate and truth: few matches, unknown headings, singular covariances.

    A static robot that lies on an axis of the frame by definition has a singular one by right.
    """
    static = {robot.name for robot in team.static}
    found: list[Diagnostic] = []
    for name in names:
        if name not in side.scores:
            found.append(Diagnostic("no_match", name, "partial"))
            continue
        figures, matched = side.scores[name], side.tracks[name]
        if figures.share < MIN_MATCHED_SHARE:
            values: dict[str, float] = {"count": matched.paired, "total": matched.total}
            values["percent"] = 100 * figures.share
            found.append(Diagnostic("few_matches", name, values=values))
        if figures.heading is None:
            whose = "truth" if np.all(np.isnan(matched.truth[:, 2])) else "estimate"
            found.append(Diagnostic("no_heading", name, values={"stream": whose}))
        if figures.singular > MAX_SINGULAR_SHARE * figures.matched and name not in static:
            counts = {"count": figures.singular, "total": figures.matched}
            found.append(Diagnostic("singular_covariances", name, values=counts))
    return found
