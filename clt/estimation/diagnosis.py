"""What a misfit is as data: what does not fit, and the likely cause."""

from __future__ import annotations

from collections.abc import Sequence

from clt.core.diagnostics import Diagnostic, Values
from clt.estimation.causes import Cause, range_end_name
from clt.estimation.frozen import FrozenPair
from clt.estimation.nis_check import Misfit, PairMisfit
from clt.model.problem import Problem


def misfit_diagnostic(
    misfit: Misfit, problem: Problem, names: Sequence[str], filter_: str, *, decided: bool
) -> Diagnostic:
    """A misfit, its pairs and frozen ranges with the worst first.

    `decided`: ranges have decided between several possible poses, which may be wrong then.
    """
    values = {
        "filter": filter_,
        "mean_nis": misfit.nis,
        "mean_nis_by_chance": misfit.chance,
        "scattered": misfit.scattered,
        "pairs": [pair_values(pair) for pair in misfit.pairs],
        "frozen": [frozen_values(each, problem, names) for each in misfit.frozen],
        "vague": misfit.vague,
        "cause": None if misfit.cause is None else cause_values(misfit.cause),
        "decided": decided,
    }
    return Diagnostic("misfit", "", "partial", values)


def pair_values(pair: PairMisfit) -> Values:
    """What the residuals of a pair are like."""
    return {
        "pair": "-".join(pair.pair),
        "count": pair.count,
        "rejected_share": pair.rejected,
        "mean_m": pair.mean,
        "autocorrelation": pair.autocorrelation,
        "mean_nis": pair.nis,
    }


def frozen_values(frozen: FrozenPair, problem: Problem, names: Sequence[str]) -> Values:
    """Whose ranges stood still, for how long and while what moved."""
    ends = (range_end_name(problem, end, names) for end in (frozen.a, frozen.b))
    return {
        "pair": "-".join(sorted(ends, key=names.index)),
        "range_m": frozen.value,
        "count": frozen.count,
        "moved_m": frozen.moved,
    }


def cause_values(cause: Cause) -> Values:
    """A cause, whose it is (no robots: all) and how large; the unit of `value` is the kind's."""
    place = None if cause.place is None else list(cause.place)
    return {"kind": cause.kind, "robots": list(cause.who), "value": cause.value, "place_m": place}
