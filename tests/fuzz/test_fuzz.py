"""A share of what the fuzzers of this folder do at length."""

from __future__ import annotations

import pytest

from tests.fuzz import commands, oracle, settings


@pytest.mark.parametrize("seed", range(4))
def test_commands_on_hostile_logs(seed, tmp_path):
    assert commands.study(40, 1000 + seed, tmp_path) == []


@pytest.mark.parametrize("seed", range(4))
def test_hostile_settings(seed, tmp_path):
    assert settings.study(400, 1000 + seed, tmp_path) == []


@pytest.mark.parametrize(
    "setting", ["radio.oscillator.skew_walk=1_000", "sensors.odometry.bias_sd=1e300"]
)
def test_scenarios_that_overflowed(setting):
    """Found by the fuzzer."""
    sets = [*settings.SHORT, "--set", "radio.rate=10", "--set", setting]
    assert oracle.run(["simulate", "shi-sim", *sets]) == []
