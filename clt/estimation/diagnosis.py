"""What a misfit is in words: what does not fit, the likely cause, the remedy; one line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from clt.estimation.causes import Cause, range_end_name
from clt.estimation.frozen import FrozenPair
from clt.estimation.nis_check import Misfit, PairMisfit
from clt.model.problem import Problem

MAX_PAIRS_SHOWN = 2
"""Pairs that are named, the worst first."""
UNKNOWN_CAUSE = (
    "cause unknown: see noise.sigma_range, noise.scale, noise.bias, the calibration, the positions "
    "of static robots and the stamps"
)


def misfit_line(
    misfit: Misfit, problem: Problem, names: Sequence[str], filter_: str, *, decided: bool
) -> str:
    """One line on a misfit.

    `decided`: ranges have decided between several possible poses, which may be wrong then.
    """
    found = []
    if misfit.scattered:
        found.append(
            f"the ranges scatter more than stated (mean NIS {misfit.nis:.2f}, at most "
            f"{misfit.chance:.2f} by chance)"
        )
    found += [pair_line(pair) for pair in misfit.pairs[:MAX_PAIRS_SHOWN]]
    if (more := len(misfit.pairs) - MAX_PAIRS_SHOWN) > 0:
        found.append(f"so do {more} more pairs" if more > 1 else "so does 1 more pair")
    if len(found) == 0 and len(misfit.frozen) == 0:
        found.append("ranges and odometry do not fit each other")
    if len(misfit.frozen) > 0:
        why = "; ".join(
            frozen_line(each, problem, names) for each in misfit.frozen[:MAX_PAIRS_SHOWN]
        )
        why += ": look at the radios, or leave these ranges out"
    elif misfit.vague:
        why = "the start may be too uncertain for a filter with one Gaussian (--filter mixture)"
    elif misfit.cause is not None:
        why = f"likely cause: {cause_line(misfit.cause)}"
    else:
        few = f"; or {filter_}.particles are too few" if filter_ in {"pf", "dpf"} else ""
        why = f"{UNKNOWN_CAUSE}{few}"
    unsure = ", and what became unique may be wrong" if decided else ""
    return "; ".join([*found, f"{why}; covariances are too small{unsure}"])


def pair_line(pair: PairMisfit) -> str:
    """What a pair's residuals are like."""
    text = f"{pair.pair[0]}-{pair.pair[1]}: {100.0 * pair.rejected:.0f} % of {pair.count} rejected"
    if not abs(pair.mean) < float("inf"):
        return text
    correlated = (
        ""
        if pair.autocorrelation != pair.autocorrelation
        else (f", correlation in time {pair.autocorrelation:.2f}")
    )
    return f"{text}, mean residual {pair.mean:+.3f} m{correlated}, mean NIS {pair.nis:.2f}"


def frozen_line(frozen: FrozenPair, problem: Problem, names: Sequence[str]) -> str:
    """Whose ranges stood still."""
    ends = (range_end_name(problem, end, names) for end in (frozen.a, frozen.b))
    a, b = sorted(ends, key=names.index)
    return (
        f"likely cause: the ranges {a}-{b} are frozen ({frozen.value:.3f} m repeated "
        f"{frozen.count} times while the estimated distance changed by {frozen.moved:.2f} m)"
    )


def cause_line(cause: Cause) -> str:
    """A cause and its remedy."""
    return CAUSE_TEXTS[cause.kind](cause)


def _offset(cause: Cause) -> str:
    whose = {0: "all ranges", 1: "the ranges of {}", 2: "the ranges {}-{}"}[len(cause.who)]
    return (
        f"{whose.format(*cause.who)} are {abs(cause.value):.2f} m too "
        f"{'long' if cause.value > 0.0 else 'short'}: calibrate their offset by so "
        "much more (--calibration, or `offset` in the streams file)"
    )


def _gain(cause: Cause) -> str:
    return (
        f"all ranges are {100.0 * abs(cause.value):.1f} % too "
        f"{'long' if cause.value > 0.0 else 'short'}: calibrate their gain by so "
        "much more (--calibration, or `gain` in the streams file)"
    )


def _late(cause: Cause) -> str:
    whose = "all odometry is" if len(cause.who) == 0 else f"the odometry of {cause.who[0]} is"
    return (
        f"{whose} stamped about {abs(cause.value):.2f} s too "
        f"{'late' if cause.value > 0.0 else 'early'} against the ranges: correct its stamps or "
        'clock (or twist = "instant" where samples are no means)'
    )


def _clock(cause: Cause) -> str:
    return (
        f"the clock of {cause.who[0]} is about {abs(cause.value):.2f} s "
        f"{'ahead' if cause.value > 0.0 else 'behind'}: correct the stamps of what it recorded"
    )


def _anchor(cause: Cause) -> str:
    near = (
        "" if cause.place is None else f", near x {cause.place[0]:.2f} m, y {cause.place[1]:.2f} m"
    )
    return (
        f"{cause.who[0]} stands about {abs(cause.value):.2f} m from its stated position{near}: "
        "measure that again"
    )


def _baseline(cause: Cause) -> str:
    return (
        f"{' and '.join(cause.who)} stand about {abs(cause.value):.2f} m "
        f"{'further apart' if cause.value > 0.0 else 'closer together'} than their stated "
        "positions: measure these again"
    )


def _scale(cause: Cause) -> str:
    what = "turn rate" if cause.kind == "turn scale" else "speed"
    return (
        f"the {what} of {cause.who[0]} is {100.0 * abs(cause.value):.0f} % too "
        f"{'large' if cause.value > 0.0 else 'small'}: calibrate its odometry, or set noise.scale"
    )


def _bias(cause: Cause) -> str:
    return (
        f"the turn rate of {cause.who[0]} is {cause.value:+.3f} rad/s off: calibrate its odometry, "
        "or set noise.bias"
    )


def _sign(cause: Cause) -> str:
    whose = "all robots" if len(cause.who) == 0 else cause.who[0]
    return (
        f"the turn rate of {whose} has the wrong sign: it counts counter-clockwise, as seen from "
        "above"
    )


def _swap(cause: Cause) -> str:
    return f"{cause.who[0]} and {cause.who[1]} are interchanged: check their ids and positions"


def _range_noise(cause: Cause) -> str:
    return (
        f"the noise of the ranges is about {cause.value:g} times what is stated: set "
        "noise.sigma_range"
    )


def _odometry_noise(cause: Cause) -> str:
    return (
        f"the noise of the odometry is about {cause.value:g} times what is stated: set "
        "noise.sigma_v and noise.sigma_omega"
    )


CAUSE_TEXTS: dict[str, Callable[[Cause], str]] = {
    "offset": _offset,
    "gain": _gain,
    "late": _late,
    "clock": _clock,
    "anchor": _anchor,
    "baseline": _baseline,
    "scale": _scale,
    "turn scale": _scale,
    "bias": _bias,
    "sign": _sign,
    "swap": _swap,
    "range noise": _range_noise,
    "odometry noise": _odometry_noise,
}
"""The words for each kind of cause."""
