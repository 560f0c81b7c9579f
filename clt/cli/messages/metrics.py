"""What an evaluation found besides its figures, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts, fill_template
from clt.core.diagnostics import Diagnostic


def worse_text(found: Diagnostic) -> str:
    """An estimate that dead reckoning beats; one that has diverged says so."""
    text = fill_template(
        "{subject}: the estimate ({rmse_m:.3g} m) is worse than dead reckoning "
        "({dead_reckoning_rmse_m:.3g} m)",
        found,
    )
    if found.severity != "partial":
        return text
    outside = 100 * (1 - found.values["inside_share"])
    return f"{text} and {outside:.0f} % of its errors exceed 3 sigma: it diverged"


def mirrored_text(found: Diagnostic) -> str:
    """What the mirror image of fits better."""
    whose = "the estimate" if found.subject == "" else found.subject
    verb = "they are" if found.values["robots"] > 1 else "it is"
    return f"the mirror image of {whose} fits the truth clearly better: {verb} mirrored"


METRICS_TEXTS: Texts = {
    "poses_not_finite": "{subject}: {count} of {total} poses of the {stream} are not finite, left "
    "out",
    "covariance_not_finite": "{subject}: the covariance of the {stream} is not finite, not used",
    "baseline_not_aligned": "dead reckoning cannot be aligned by itself ({error}); aligned as the "
    "estimate is",
    "no_estimate": "{subject}: no estimate",
    "several_truth_frames": "the truth stands in several frames ({frames}), taken as one",
    "short_relative_truth": "{subject}: only {count} of {total} truth poses have one of {ego} in "
    "reach (--max-gap)",
    "worse_than_dead_reckoning": worse_text,
    "no_match": "{subject}: no estimate reaches a truth pose",
    "few_matches": "{subject}: only {count} of {total} truth poses have an estimate "
    "({percent:.1f} %)",
    "no_heading": "{subject}: the {stream} has no heading; no heading error, RPE or ANEES",
    "singular_covariances": "{subject}: {count} of {total} covariances are singular, left out of "
    "ANEES",
    "mirrored": mirrored_text,
}
