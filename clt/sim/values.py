"""What the values of a scenario's keys may be. SI units: m, s, rad, Hz."""

from __future__ import annotations

from typing import Annotated, TypeVar

from pydantic import Field, StringConstraints

MAX_SCENARIO_VALUE = 1e9
"""Beyond every robot and every log; squares and sums of it are finite."""
Positive = Annotated[float, Field(gt=0.0, le=MAX_SCENARIO_VALUE)]
NonNegative = Annotated[float, Field(ge=0.0, le=MAX_SCENARIO_VALUE)]
Number = Annotated[float, Field(ge=-MAX_SCENARIO_VALUE, le=MAX_SCENARIO_VALUE)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]
Rate = Annotated[float, Field(gt=0.0, le=1000.0)]
Count = Annotated[int, Field(ge=0, le=1000)]
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Point = tuple[Number, Number]
Pose = tuple[Number, Number, Number]
Area = tuple[Number, Number, Number, Number]
T = TypeVar("T")


def imperfection(default: T) -> T:
    """Default of an imperfection that a scenario need not have: written out only where it has."""
    field: T = Field(default=default, exclude_if=lambda value: value == default)
    return field
