"""What an evaluation could not tell, and what its reader should know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from clt.core.recording import Poses, Team
from clt.metrics.evaluation import EstimateScores
from clt.metrics.tracks import ego_of_frame
from clt.metrics.warned import EvaluationWarning

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
) -> list[EvaluationWarning]:
    """Relative truth that is short, moving robots without an estimate, truth in several frames."""
    egos = {name: ego_of_frame(track.frame, team.names) for name, track in estimates.items()}
    warnings: list[EvaluationWarning] = []
    for name, ego in egos.items():
        if ego is not None and name in truth:
            warnings += _short_truth_warning(name, ego, truth, targets.get(name))
    mutual = set(egos.values()) == set(estimates)  # Two robots, each in the other's frame.
    warnings += [
        EvaluationWarning(f"{robot.name}: no estimate", partial=True)
        for robot in (team.moving if not mutual else ())
        if robot.name in truth and robot.name not in {*estimates, *egos.values()}
    ]
    if len({track.frame for track in truth.values()}) > 1:
        frames = ", ".join(dict.fromkeys(track.frame for track in truth.values()))
        warnings.append(
            EvaluationWarning(f"the truth stands in several frames ({frames}), taken as one")
        )
    return warnings


def _short_truth_warning(
    name: str, ego: str, truth: Mapping[str, Poses], target: Poses | None
) -> list[EvaluationWarning]:
    """A word on a relative truth that holds less than either of the two that it is made of."""
    most = min(len(truth[name].stamp), len(truth[ego].stamp))
    count = 0 if target is None else len(target.stamp)
    if count >= MIN_MATCHED_SHARE * most:
        return []
    text = f"{name}: only {count} of {most} truth poses have one of {ego} in reach (--max-gap)"
    return [EvaluationWarning(text, partial=count == 0)]


def divergence_warnings(
    estimate: EstimateScores, baseline: EstimateScores
) -> list[EvaluationWarning]:
    """Estimates worse than dead reckoning; diverged if their own 3 sigma deny it as well."""
    warnings: list[EvaluationWarning] = []
    for name, figures in estimate.scores.items():
        plain = baseline.scores.get(name)
        if plain is None or figures.ape.rmse <= plain.ape.rmse:
            continue
        text = (
            f"{name}: the estimate ({figures.ape.rmse:.3g} m) is worse than dead reckoning "
            f"({plain.ape.rmse:.3g} m)"
        )
        inside = 1.0 if figures.inside is None else min(figures.inside.values())
        if inside < MIN_INSIDE_SHARE:
            text += f" and {100 * (1 - inside):.0f} % of its errors exceed 3 sigma: it diverged"
        warnings.append(EvaluationWarning(text, partial=inside < MIN_INSIDE_SHARE))
    return warnings


def score_warnings(
    names: Sequence[str], side: EstimateScores, team: Team
) -> list[EvaluationWarning]:
    """Of robots with estimate and truth: few matches, unknown headings, singular covariances.

    A static robot that lies on an axis of the frame by definition has a singular one by right.
    """
    static = {robot.name for robot in team.static}
    warnings: list[EvaluationWarning] = []
    for name in names:
        if name not in side.scores:
            warnings.append(
                EvaluationWarning(f"{name}: no estimate reaches a truth pose", partial=True)
            )
            continue
        figures, matched = side.scores[name], side.tracks[name]
        if figures.share < MIN_MATCHED_SHARE:
            text = f"{name}: only {matched.paired} of {matched.total} truth poses have an estimate"
            warnings.append(EvaluationWarning(f"{text} ({100 * figures.share:.1f} %)"))
        if figures.heading is None:
            whose = "truth" if np.all(np.isnan(matched.truth[:, 2])) else "estimate"
            text = f"{name}: the {whose} has no heading; no heading error, RPE or ANEES"
            warnings.append(EvaluationWarning(text))
        if figures.singular > MAX_SINGULAR_SHARE * figures.matched and name not in static:
            text = f"{name}: {figures.singular} of {figures.matched} covariances are singular"
            warnings.append(EvaluationWarning(f"{text}, left out of ANEES"))
    return warnings
