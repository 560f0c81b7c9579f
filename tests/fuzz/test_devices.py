"""A hundred thousand damaged streams: all that the fuzzer of decoders holds."""

from __future__ import annotations

from tests.fuzz import devices


def test_damaged_streams_lose_samples_at_most():
    assert devices.run(0, 100_000) == []
