"""Ranges out of raw UWB packets: accuracy against the simulated truth, and speed.

    python benchmarks/radio.py [--seeds 3] [--runs 5] [--out benchmarks/results/radio.md]

1. Both methods on shi-sim's five nodes over 60 s, rms of measured minus true distance from 2 s on;
   `error / sigma` is 1 where each range's own sigma is true.
2. Skew: `clt range`'s median of every pair against that of the counters themselves, over 60 s in
   which oscillators do not wander.
3. `clt range` as a whole warm process on 300 s at 100 Hz, beside a process in which the official
   `mcap` reader does nothing but iterate that log's messages. Runs take turns; medians.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
from pathlib import Path

import numpy as np
from processes import CLT, iterating, wall

from clt.core.arrays import Floats
from clt.core.recording import Ranges, Recording
from clt.core.ticks import COUNTER_PERIOD_TICKS, TICKS_PER_SECOND
from clt.ranging.recover import range_packets
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

BRISK = {
    "trajectory.speed": 1.5,
    "trajectory.acceleration": 1.0,
    "trajectory.turn_rate": 1.5,
}
CASES: dict[str, dict[str, object]] = {
    "standing": {"trajectory": {"kind": "stand"}},
    "driving at 0.74 m/s": {},
    "driving at 1.5 m/s": BRISK,
    "circles of 1 m at 1.5 m/s": {"trajectory": {"kind": "circle", "radius": 1.0, "speed": 1.5}},
    "1.5 m/s, 10 % loss": {**BRISK, "radio.loss": 0.1},
    "0.74 m/s, 20 Hz": {"radio.rate": 20.0},
    "0.74 m/s, 5 Hz": {"radio.rate": 5.0, "duration": 300.0},
    "0.74 m/s, 1 Hz": {"radio.rate": 1.0, "duration": 300.0},
    "0.74 m/s, 1 Hz, slots of 0.2 s": {
        "radio.rate": 1.0,
        "radio.slot": 0.2,
        "duration": 300.0,
    },
}


def network(seed: int, **overrides: object) -> Recording:
    """Raw packets of five nodes, with truth at 500 Hz."""
    base = {"radio.rate": 100.0, "duration": 60.0, "sensors.truth.rate": 500.0, "seed": seed}
    return simulate(load_scenario("shi-sim", {**base, **overrides}))


def errors(recording: Recording, ranges: Ranges) -> Floats:
    """Measured minus true distance, m."""
    spots = np.empty((2, 2, ranges.stamp.size))
    for index, name in enumerate(recording.team.names):
        truth = recording.truth[name]
        t, at = truth.stamp - truth.stamp[0], ranges.stamp - truth.stamp[0]
        for end, column in enumerate((ranges.source, ranges.target)):
            own = column == index
            spots[end, 0, own] = np.interp(at[own], t, truth.x)
            spots[end, 1, own] = np.interp(at[own], t, truth.y)
    return ranges.range - np.hypot(*(spots[0] - spots[1]))


def accuracy(seeds: int) -> list[str]:
    """One row per case."""
    rows = [
        "| robots | clock: cm rms | error / sigma | double-sided: cm rms | error / sigma | auto |",
        "|---|---|---|---|---|---|",
    ]
    for name, overrides in CASES.items():
        cells, chosen = [], set()
        recordings = [network(seed, **overrides) for seed in range(1, seeds + 1)]
        for method in ("clock", "double-sided"):
            square, ratio = [], []
            for recording in recordings:
                ranges = range_packets(recording, method).recording.ranges
                keep = ranges.stamp > recording.frames.stamp[0] + 2_000_000_000
                error = errors(recording, ranges)[keep]
                square.append(np.mean(error**2))
                ratio.append(np.mean((error / ranges.sigma[keep]) ** 2))
            cells += [f"{100 * np.mean(square) ** 0.5:.2f}", f"{np.mean(ratio) ** 0.5:.3f}"]
        chosen = {range_packets(recording).method for recording in recordings}
        rows.append(f"| {name} | {' | '.join(cells)} | {', '.join(sorted(chosen))} |")
    return rows


def true_rates(recording: Recording) -> Floats:
    """Mean rate of every counter against true time, from its first and last packet."""
    frames, rates = recording.frames, []
    for robot in range(len(recording.team.robots)):
        own = frames.source == robot
        seconds = (frames.stamp[own][-1] - frames.stamp[own][0]) * 1e-9
        step = int(frames.transmit[own][-1] - frames.transmit[own][0]) % COUNTER_PERIOD_TICKS
        rates.append(
            (
                step
                + COUNTER_PERIOD_TICKS
                * round((seconds * TICKS_PER_SECOND - step) / COUNTER_PERIOD_TICKS)
            )
            / (seconds * TICKS_PER_SECOND)
        )
    return np.array(rates)


def skew_error(seeds: int) -> float:
    """Largest error of a pair's skew."""
    still = {"radio.oscillator.skew_walk": 0.0, "radio.oscillator.skew": 20e-6, **BRISK}
    worst = 0.0
    for seed in range(1, seeds + 1):
        recording = network(seed, **still)
        rates, index = true_rates(recording), recording.team.index
        for (a, b), one in range_packets(recording, "clock").clocks.items():
            worst = max(worst, abs(one.skew - (rates[index(a)] / rates[index(b)] - 1.0)))
    return worst


def speed(runs: int) -> tuple[float, float]:
    """Median seconds of `clt range` and of iterating the same log."""
    with tempfile.TemporaryDirectory() as folder:
        log, out = f"{folder}/raw.mcap", f"{folder}/ranges.mcap"
        wall(*CLT, "simulate", "shi-sim", "--set", "radio.rate=100", "-q", "-o", log)
        ranging = (*CLT, "range", log, "-q", "--force", "-o", out)
        iterate = iterating(log)
        wall(*ranging)
        wall(*iterate)
        pairs = [(wall(*ranging), wall(*iterate)) for _ in range(runs)]
    ours, theirs = zip(*pairs, strict=True)
    return statistics.median(ours), statistics.median(theirs)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    ours, theirs = speed(options.runs)
    skew = 1e9 * skew_error(options.seeds)
    pace = f"{ours:.2f} s; official reader iterating the log: {theirs:.2f} s"
    lines = [
        f"Five nodes, 100 Hz unless said, stamps 150 ps, {options.seeds} seeds.",
        "",
        *accuracy(options.seeds),
        "",
        f"Skew of a pair up to 40 ppm apart: worst error {skew:.2f} ppb.",
        "",
        f"`clt range`, whole warm process, five nodes, 300 s: {pace}; ratio {ours / theirs:.2f}.",
        "",
    ]
    text = "\n".join(lines)
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
