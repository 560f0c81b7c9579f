"""A misfit of ranges in words: what does not fit, the likely cause, the remedy; one line."""

from __future__ import annotations

from math import isnan

from clt.cli.messages.causes import cause_text
from clt.core.diagnostics import Diagnostic, Values

MAX_PAIRS_SHOWN = 2
"""Pairs that are named, the worst first."""
UNKNOWN_CAUSE = (
    "cause unknown: see noise.sigma_range, noise.scale, noise.bias, the calibration, the positions "
    "of static robots and the stamps"
)


def misfit_text(found: Diagnostic) -> str:
    """One line on a misfit."""
    values = found.values
    pairs, frozen = values["pairs"], values["frozen"]
    parts = []
    if values["scattered"]:
        parts.append(
            f"the ranges scatter more than stated (mean NIS {values['mean_nis']:.2f}, at most "
            f"{values['mean_nis_by_chance']:.2f} by chance)"
        )
    parts += [pair_text(pair) for pair in pairs[:MAX_PAIRS_SHOWN]]
    if (more := len(pairs) - MAX_PAIRS_SHOWN) > 0:
        parts.append(f"so do {more} more pairs" if more > 1 else "so does 1 more pair")
    if len(parts) == 0 and len(frozen) == 0:
        parts.append("ranges and odometry do not fit each other")
    unsure = ", and what became unique may be wrong" if values["decided"] else ""
    return "; ".join([*parts, f"{why_text(values)}; covariances are too small{unsure}"])


def why_text(values: Values) -> str:
    """The likely cause of a misfit and its remedy."""
    frozen = values["frozen"]
    if len(frozen) > 0:
        why = "; ".join(frozen_text(each) for each in frozen[:MAX_PAIRS_SHOWN])
        return f"{why}: look at the radios, or leave these ranges out"
    if values["vague"]:
        return "the start may be too uncertain for a filter with one Gaussian (--filter mixture)"
    if values["cause"] is not None:
        return f"likely cause: {cause_text(values['cause'])}"
    few = ""
    if values["filter"] in {"pf", "dpf"}:
        few = f"; or {values['filter']}.particles are too few"
    return f"{UNKNOWN_CAUSE}{few}"


def pair_text(pair: Values) -> str:
    """What a pair's residuals are like."""
    rejected, mean, correlation = (
        pair[key] for key in ("rejected_share", "mean_m", "autocorrelation")
    )
    text = f"{pair['pair']}: {100.0 * rejected:.0f} % of {pair['count']} rejected"
    if not abs(mean) < float("inf"):
        return text
    correlated = "" if isnan(correlation) else f", correlation in time {correlation:.2f}"
    return f"{text}, mean residual {mean:+.3f} m{correlated}, mean NIS {pair['mean_nis']:.2f}"


def frozen_text(frozen: Values) -> str:
    """Whose ranges stood still."""
    return (
        f"likely cause: the ranges {frozen['pair']} are frozen ({frozen['range_m']:.3f} m repeated "
        f"{frozen['count']} times while the estimated distance changed by "
        f"{frozen['moved_m']:.2f} m)"
    )
