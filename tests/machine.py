"""How slow this machine is, so that limits of processor time hold on any."""

from __future__ import annotations

import time

LOOP, USUAL_S = 1_000_000, 0.05
"""Steps of a plain loop, and what they usually take, s of processor time."""


def times_slower() -> float:
    """How many times longer than usual plain Python takes here now; never below 1."""
    took = []
    for _ in range(3):
        began, total = time.process_time(), 0
        for k in range(LOOP):
            total += k
        took.append(time.process_time() - began)
    return max(1.0, max(took) / USUAL_S)
