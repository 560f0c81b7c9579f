"""The likely causes of a misfit in words, each with its remedy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from clt.core.diagnostics import Values


@dataclass(frozen=True)
class NamedCause:
    """A cause as a diagnostic holds it; see `clt.estimation.causes.Cause`."""

    kind: str
    who: Sequence[str]
    value: float
    place: Sequence[float] | None


def cause_text(values: Values) -> str:
    """A cause and its remedy."""
    cause = NamedCause(*(values[key] for key in ("kind", "robots", "value", "place_m")))
    return CAUSE_TEXTS[cause.kind](cause)


def _offset(cause: NamedCause) -> str:
    whose = {0: "all ranges", 1: "the ranges of {}", 2: "the ranges {}-{}"}[len(cause.who)]
    return (
        f"{whose.format(*cause.who)} are {abs(cause.value):.2f} m too "
        f"{'long' if cause.value > 0.0 else 'short'}: calibrate their offset by so "
        "much more (--calibration, or `offset` in the streams file)"
    )


def _gain(cause: NamedCause) -> str:
    return (
        f"all ranges are {100.0 * abs(cause.value):.1f} % too "
        f"{'long' if cause.value > 0.0 else 'short'}: calibrate their gain by so "
        "much more (--calibration, or `gain` in the streams file)"
    )


def _late(cause: NamedCause) -> str:
    whose = "all odometry is" if len(cause.who) == 0 else f"the odometry of {cause.who[0]} is"
    return (
        f"{whose} stamped about {abs(cause.value):.2f} s too "
        f"{'late' if cause.value > 0.0 else 'early'} against the ranges: correct its stamps or "
        'clock (or twist = "instant" where samples are no means)'
    )


def _clock(cause: NamedCause) -> str:
    return (
        f"the clock of {cause.who[0]} is about {abs(cause.value):.2f} s "
        f"{'ahead' if cause.value > 0.0 else 'behind'}: correct the stamps of what it recorded"
    )


def _anchor(cause: NamedCause) -> str:
    near = (
        "" if cause.place is None else f", near x {cause.place[0]:.2f} m, y {cause.place[1]:.2f} m"
    )
    return (
        f"{cause.who[0]} stands about {abs(cause.value):.2f} m from its stated position{near}: "
        "measure that again"
    )


def _baseline(cause: NamedCause) -> str:
    return (
        f"{' and '.join(cause.who)} stand about {abs(cause.value):.2f} m "
        f"{'further apart' if cause.value > 0.0 else 'closer together'} than their stated "
        "positions: measure these again"
    )


def _scale(cause: NamedCause) -> str:
    what = "turn rate" if cause.kind == "turn scale" else "speed"
    return (
        f"the {what} of {cause.who[0]} is {100.0 * abs(cause.value):.0f} % too "
        f"{'large' if cause.value > 0.0 else 'small'}: calibrate its odometry, or set noise.scale"
    )


def _bias(cause: NamedCause) -> str:
    return (
        f"the turn rate of {cause.who[0]} is {cause.value:+.3f} rad/s off: calibrate its odometry, "
        "or set noise.bias"
    )


def _sign(cause: NamedCause) -> str:
    whose = "all robots" if len(cause.who) == 0 else cause.who[0]
    return (
        f"the turn rate of {whose} has the wrong sign: it counts counter-clockwise, as seen from "
        "above"
    )


def _swap(cause: NamedCause) -> str:
    return f"{cause.who[0]} and {cause.who[1]} are interchanged: check their ids and positions"


def _range_noise(cause: NamedCause) -> str:
    return (
        f"the noise of the ranges is about {cause.value:g} times what is stated: set "
        "noise.sigma_range"
    )


def _odometry_noise(cause: NamedCause) -> str:
    return (
        f"the noise of the odometry is about {cause.value:g} times what is stated: set "
        "noise.sigma_v and noise.sigma_omega"
    )


CAUSE_TEXTS: dict[str, Callable[[NamedCause], str]] = {
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
