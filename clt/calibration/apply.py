"""Calibration of a team's sensors: `calibration.toml` and its effect on a recording.

Ranges: range = gain * raw + offset, always from the raw column, so that a calibration replaces
whatever stood there before. Odometry: v <- scale * v and omega <- omega - gyro_bias; the recording
carries what was applied to it (`run["calibration"]`), which the next calibration takes back first.
Applying a calibration twice is therefore the same as applying it once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError, field_validator

from clt.core.arrays import Floats
from clt.core.document import Document
from clt.core.errors import LogError, UsageError
from clt.core.recording import CALIBRATION_KEY, Odometry, Ranges, Recording, Team
from clt.core.settings import Settings, did_you_mean, parse_settings, read_toml

KEY = CALIBRATION_KEY

PositiveFactor = Annotated[float, Field(gt=0.0)]


class PairCalibration(Settings):
    """One pair of radios, whichever of the two measured; a missing key is taken from `[range]`."""

    ends: tuple[str, str]
    """Names of both robots."""
    gain: PositiveFactor | None = None
    """Range over raw value."""
    offset: float | None = None
    """m."""


class RangeCalibration(Settings):
    """All pairs. With neither gain nor offset, pairs that are not listed stay as they are."""

    gain: PositiveFactor | None = None
    """1 where only an offset is given."""
    offset: float | None = None
    """m; 0 where only a gain is given."""
    pair: tuple[PairCalibration, ...] = ()
    """Pairs that differ, a table each."""

    @field_validator("pair")
    @classmethod
    def distinct(cls, pairs: tuple[PairCalibration, ...]) -> tuple[PairCalibration, ...]:
        """Refuse a pair with itself and a pair listed twice."""
        seen: set[frozenset[str]] = set()
        for pair in pairs:
            ends = frozenset(pair.ends)
            if len(ends) < 2:
                raise ValueError(f"both ends are {pair.ends[0]}")
            if ends in seen:
                raise ValueError(f"the pair {'-'.join(pair.ends)} is listed twice")
            seen.add(ends)
        return pairs


class OdometryCalibration(Settings):
    """One robot's odometry."""

    scale: PositiveFactor = 1.0
    """True over measured forward speed; omega is not scaled."""
    gyro_bias: float = 0.0
    """Measured omega of a robot that stands still, rad/s."""


class Calibration(Settings):
    """The whole of `calibration.toml`."""

    range: RangeCalibration = RangeCalibration()
    odometry: Mapping[str, OdometryCalibration] = Field(default_factory=dict)
    """By robot name."""


def read_calibration(source: Path | Document) -> Calibration:
    """Read a calibration file. Raises UsageError naming the file and the key."""
    return parse_settings(Calibration, read_toml(source), str(source))


def apply_calibration(recording: Recording, calibration: Calibration) -> Recording:
    """The recording with calibrated ranges and odometry, any earlier calibration taken back.

    Raises:
        UsageError: the calibration names a robot that the team does not have.
        LogError: the recording's own word on its calibration cannot be read.
    """
    _check_names(recording.team, calibration)
    earlier = _applied(recording.run)
    odometry = {
        name: _calibrated_odometry(
            stream,
            earlier.odometry.get(name, OdometryCalibration()),
            calibration.odometry.get(name, OdometryCalibration()),
        )
        for name, stream in recording.odometry.items()
    }
    return replace(
        recording,
        odometry=odometry,
        ranges=_calibrated_ranges(recording.ranges, recording.team, calibration.range),
        run={**recording.run, KEY: calibration.model_dump_json(exclude_unset=True)},
    )


def _applied(run: Mapping[str, str]) -> Calibration:
    """The calibration that a recording's columns already contain."""
    try:
        return Calibration.model_validate_json(run.get(KEY, "{}"))
    except ValidationError:
        raise LogError(f"the log's metadata clt.run: `{KEY}` is not a calibration") from None


def _check_names(team: Team, calibration: Calibration) -> None:
    """Raise UsageError for a stranger, naming its table and the closest robot."""
    named = [("range.pair", end) for pair in calibration.range.pair for end in pair.ends]
    named += [("odometry", name) for name in calibration.odometry]
    for table, name in named:
        if name not in team.names:
            hint = did_you_mean(name, team.names)
            raise UsageError(f"calibration: [{table}] names an unknown robot `{name}`{hint}")


def _calibrated_odometry(
    stream: Odometry, earlier: OdometryCalibration, new: OdometryCalibration
) -> Odometry:
    """The stream with `earlier` taken back and `new` applied; sigma_v scales along with v."""
    scale = new.scale / earlier.scale
    return replace(
        stream,
        v=scale * stream.v,
        sigma_v=scale * stream.sigma_v,
        omega=stream.omega + (earlier.gyro_bias - new.gyro_bias),
    )


def _calibrated_ranges(ranges: Ranges, team: Team, calibration: RangeCalibration) -> Ranges:
    """`range` = gain * raw + offset, pair by pair; `sigma` stays what the message states."""
    # Gain and offset by source and target; NaN for pairs that are left alone.
    affine: Floats = np.full((len(team.robots), len(team.robots), 2), np.nan)
    if calibration.gain is not None or calibration.offset is not None:
        affine[:] = _gain(calibration.gain), _offset(calibration.offset)
    for pair in calibration.pair:
        a, b = map(team.index, pair.ends)
        gain = pair.gain if pair.gain is not None else calibration.gain
        offset = pair.offset if pair.offset is not None else calibration.offset
        affine[a, b] = affine[b, a] = _gain(gain), _offset(offset)
    gain_of, offset_of = np.moveaxis(affine[ranges.source, ranges.target], -1, 0)
    known = ~np.isnan(gain_of)
    return replace(ranges, range=np.where(known, gain_of * ranges.raw + offset_of, ranges.range))


def _gain(value: float | None) -> float:
    return 1.0 if value is None else value


def _offset(value: float | None) -> float:
    return 0.0 if value is None else value
