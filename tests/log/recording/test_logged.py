"""A recording as its log would hold it, against the log itself."""

from __future__ import annotations

from dataclasses import fields, is_dataclass

import numpy as np
import pytest

from clt.log.recording.load import load
from clt.log.recording.logged import as_logged
from clt.log.recording.save import save
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

LATE = {"network.delay_mean": 0.05, "network.delay_sd": 0.05, "network.loss": 0.1}
CASES = {
    "plain": ("shi-sim", {}),
    "late": ("shi-sim", LATE),
    "packets": ("shi-sim", {"radio": {}}),
    "late packets": ("shi-sim", {"radio": {"odometry": "topic"}, **LATE}),
    "five": ("araki-five", {"sensors.odometry.gaps": {"share": 0.3}}),
    "unknown noise": ("shi-three", {"sensors.odometry.sigma_v": 0.0}),
    "pair": ("li-two", {"sensors.range.measured_by": "higher"}),
}


def same(one, other):
    """Equal to the last bit, NaN equal to NaN."""
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and np.array_equal(
            one, other, equal_nan=one.dtype.kind == "f"
        )
    if isinstance(one, dict):
        return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return one == other or (one != one and other != other)  # noqa: PLR0124 - NaN


@pytest.mark.parametrize("case", CASES)
def test_a_simulated_recording_is_what_comes_back_from_its_log(case, tmp_path):
    name, settings = CASES[case]
    recording = simulate(load_scenario(name, {"duration": 6.0, **settings}))
    with (tmp_path / "log.mcap").open("wb") as file:
        save(file, recording, {})
    back = load(tmp_path / "log.mcap").recording
    logged = as_logged(recording)
    for field in fields(back):
        if field.name not in {"faults", "run"}:
            assert same(getattr(logged, field.name), getattr(back, field.name)), field.name


def test_estimates_are_what_comes_back_from_their_log(synthetic, tmp_path):
    recording = synthetic(n=50)
    with (tmp_path / "log.mcap").open("wb") as file:
        save(file, recording, {})
    back = load(tmp_path / "log.mcap").recording
    logged = as_logged(recording)
    assert not same(recording.estimate, back.estimate)
    for name in ("truth", "estimate", "dead_reckoning", "innovations"):
        assert same(getattr(logged, name), getattr(back, name)), name
