"""A share of what the fuzzers of this folder do at length."""

from __future__ import annotations

import pytest

from tests.fuzz import commands, settings


@pytest.mark.parametrize("seed", range(4))
def test_commands_on_hostile_logs(seed, tmp_path):
    assert commands.study(50, 1000 + seed, tmp_path) == []


@pytest.mark.parametrize("seed", range(4))
def test_hostile_settings(seed, tmp_path):
    assert settings.study(400, 1000 + seed, tmp_path) == []


def test_an_oscillator_is_one():
    """Found by the fuzzer: clocks that wander by days a second overflowed."""
    assert (
        settings.run(
            ["simulate", "shi-sim", *settings.SHORT, "--set", "radio.oscillator.skew_walk=1_000"]
        )
        == []
    )
