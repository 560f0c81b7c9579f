"""The ordinary share of the fuzzer of the log layer."""

from __future__ import annotations

import random

from tests.fuzz import mutate
from tests.fuzz.logs import case, run, seeds

COUNT = 10_000


def test_hostile_logs_are_refused_in_one_line():
    findings, outcomes = run(0, COUNT)
    assert findings == []
    assert min(outcomes["read"], outcomes["refused"]) > COUNT / 100


def test_the_mutators_keep_what_they_should():
    """Taken apart and put together, a log holds the same records; a seed gives the same bytes."""
    for data in seeds():
        parts = mutate.apart(data)
        again = mutate.apart(mutate.together(random.Random(1), parts))
        assert sorted(again) == sorted(parts)
    assert [case(seed) for seed in range(20)] == [case(seed) for seed in range(20)]
    assert len({case(seed) for seed in range(200)}) > 190
