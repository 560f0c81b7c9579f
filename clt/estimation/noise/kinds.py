"""Kinds of noise that a log is asked about, and the values that are looked at.

Values of kinds are keys of the settings: those of `noise` by their names, those of `outliers` after
`outliers.`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from clt.model.settings import FilterSettings

Values = Mapping[str, float | None]


class Platform(NamedTuple):
    """A class of odometry: errors that grow with motion, and errors that last (`NoiseSettings`)."""

    v_per_sqrt_m: float
    omega_per_sqrt_rad: float
    omega_per_sqrt_m: float
    scale: float
    scale_omega: float
    bias: float


PLATFORMS = {
    "encoders": Platform(0.06, 0.015, 0.015, 0.02, 0.01, 0.001),
    "wheels": Platform(0.06, 0.05, 0.05, 0.03, 0.03, 0.003),
    "commands": Platform(0.1, 0.15, 0.15, 0.08, 0.05, 0.005),
}
"""Measured on real platforms, from narrow to wide: encoders or visual odometry; poor wheels;
commands that were not measured at all."""
STATED: Values = {
    "v_per_sqrt_m": None, "omega_per_sqrt_rad": None, "omega_per_sqrt_m": None,
    "scale": 0.0, "scale_omega": None, "bias": 0.0,
}  # fmt: skip
"""Odometry as the log or the settings state it."""
GRIDS: dict[str, tuple[float, ...]] = {
    "sigma_range": (0.01, 0.02, 0.04, 0.07, 0.1, 0.15, 0.3, 0.6, 1.2),
    "outliers.isolated": (0.02, 0.05, 0.1),
    "offset": (0.0, 0.05, 0.2),
    "bias": (0.0, 0.001, 0.003, 0.01, 0.03),
    "scale": (0.0, 0.02, 0.05, 0.1),
    "slow": (0.02, 0.05, 0.15, 0.4, 1.0),
    "slow_time": (0.5, 1.0, 3.0, 10.0),
    "slow_distance": (0.0, 3.0, 10.0),
}
"""Values of each kind of noise, in the order in which the kinds are looked at."""
NO_SLOW: Values = {"slow": 0.0}
SLOW_STARTS: tuple[Values, ...] = (
    {"slow": 0.02, "slow_time": 0.5, "correlation_time": 0.0, "sigma_range": 0.01},
    {"slow": 0.05, "slow_time": 3.0, "correlation_time": 0.0, "sigma_range": 0.04},
    {"slow": 0.2, "slow_time": 3.0, "correlation_time": 0.0, "sigma_range": 0.15},
)
"""Where the search for slow range errors begins; they take the place of correlated noise."""
ODOMETRY_KEYS = frozenset(
    {
        "sigma_v", "sigma_omega", "v_per_v", "v_per_omega", "omega_per_v", "omega_per_omega",
        "v_per_sqrt_m", "omega_per_sqrt_rad", "omega_per_sqrt_m",
    }
)  # fmt: skip
"""Settings of which any pins the class of odometry."""
SLOW_KEYS = frozenset({"slow", "correlation_time"})
"""Settings of which any pins slow range errors."""


def pinned_kinds(settings: FilterSettings) -> frozenset[str]:
    """Kinds that the settings give, and `odometry` where they give its noise."""
    noise = settings.noise.model_fields_set
    pinned = {key for key in GRIDS if key in noise}
    pinned |= {f"outliers.{key}" for key in settings.outliers.model_fields_set}
    if noise & ODOMETRY_KEYS:
        pinned.add("odometry")
    if noise & SLOW_KEYS:
        pinned.add("slow")
    if "scale_omega" in noise:
        pinned.add("scale")
    return frozenset(pinned)


def with_noise(settings: FilterSettings, values: Mapping[str, object]) -> FilterSettings:
    """Settings with some kinds of noise replaced."""
    noise = {key: value for key, value in values.items() if not key.startswith("outliers.")}
    outliers = {
        key.removeprefix("outliers."): value
        for key, value in values.items()
        if key.startswith("outliers.")
    }
    return settings.model_copy(
        update={
            "noise": settings.noise.model_copy(update=noise),
            "outliers": settings.outliers.model_copy(update=outliers),
        }
    )
