"""The price of lateness in metres: Araki's cars over a network that delays, loses and batches.

    python benchmarks/lateness.py [--seeds 30] [--out benchmarks/results/lateness.md]

One log per seed, filtered by stamp, as if all delays were known away; as received, fusing late
messages at their stamps; and in the two ways that need no buffer: taking messages as true when they
arrive, and dropping ranges that are late. Every way starts from the same errors, 0.3 m and 0.2 rad.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import TypeVar

import numpy as np
from relative import relative_start, relative_truth

from clt.core.recording import Odometry, Poses, Ranges, Recording
from clt.core.start import Start
from clt.estimation import estimators
from clt.estimation.replay import received
from clt.metrics.associate import interpolate
from clt.model.choices import FrameSpec
from clt.model.settings import FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

EGO = "car1"
VIEW = FrameSpec("ego", (EGO,))
EKF = estimators.Estimator("ekf", VIEW)
SIGMA = (0.3, 0.2)
SCENES = ("araki-semicircles", "araki-five")
"""Two cars: a scene where lateness decides. In `araki-left-turns` wrong modes of the EKF do: its
mean over 30 seeds was 0.49 m by stamp, 0.45 m as received, with medians of 0.28 m and 0.26 m."""
NETWORK = {
    "network.delay_mean": 0.084,
    "network.delay_sd": 0.071,
    "network.batch": 0.03,
    "network.clock_mean": 0.002,
    "network.clock_sd": 0.009,
}
"""As Araki measured; his scenes lose 10 % besides. The ego's own messages take no network."""
MAX_GAP = 0.5
"""Estimates are interpolated over so much, s, as in an evaluation."""
Way = Callable[[Recording, Start], Mapping[str, Poses]]
Stream = TypeVar("Stream", Odometry, Ranges)


HEAD = f"""\
Araki's cars over a network with delays of 84 +- 71 ms, batches of 30 ms, clocks off by 2 +- 9 ms
and a loss of 10 %: {{seeds}} seeds, EKF in the frame of {EGO}, on which the log is written, initial
errors drawn from {SIGMA[0]} m and {SIGMA[1]} rad (`python benchmarks/lateness.py`).
Distance RMSE over a run, mean and median over seeds and cars; the logs are 10 s and 29 s long.
"""


def with_lag(lag: float) -> Way:
    """As received, fusing what is up to `lag` seconds late."""
    settings = FilterSettings(received={"lag": lag})
    return lambda recording, start: received.replay_recording(recording, start, settings, EKF).poses


def by_stamp(recording: Recording, start: Start) -> Mapping[str, Poses]:
    """The sorted replay."""
    return estimators.localize_recording(recording, start, FilterSettings(), EKF).poses


def on_arrival(recording: Recording, start: Start) -> Mapping[str, Poses]:
    """Every message taken as true when it arrived."""
    odometry = {name: restamped(stream) for name, stream in recording.odometry.items()}
    return by_stamp(
        replace(recording, odometry=odometry, ranges=restamped(recording.ranges)), start
    )


def restamped(stream: Stream) -> Stream:
    """A stream in the order of arrival, with the log times as stamps."""
    order = np.argsort(stream.log_time, kind="stable")
    columns = {name: column[order] for name, column in vars(stream).items()}
    return type(stream)(**columns | {"stamp": columns["log_time"]})


def reckoned(recording: Recording, start: Start) -> Mapping[str, Poses]:
    """Odometry alone, as received."""
    return received.dead_reckon_replay(recording, start, FilterSettings(), VIEW)


WAYS: dict[str, Way] = {
    "by stamp, offline": by_stamp,
    "as received, fused up to 1 s late": with_lag(1.0),
    "as received, fused up to 0.1 s late": with_lag(0.1),
    "taken as true on arrival": on_arrival,
    "as received, late ranges dropped": with_lag(0.0),
    "dead reckoning as received": reckoned,
}


def distance_rmse(recording: Recording, poses: Poses, name: str) -> float:
    """Error of the relative position of a car over all stamps of the truth, RMS, m."""
    at = recording.truth[EGO].stamp
    found, estimate, _ = interpolate(poses, at, MAX_GAP)
    d = estimate[:, :2] - relative_truth(recording, EGO, name, at[found])[:, :2]
    return float(np.sqrt(np.mean(np.sum(d**2, axis=1))))


def study(scene: str, seeds: int) -> dict[str, tuple[list[float], float]]:
    """Distance RMSE of each way, one for each seed and car (m), and seconds per log."""
    errors: dict[str, list[float]] = {name: [] for name in WAYS}
    seconds = dict.fromkeys(WAYS, 0.0)
    for seed in range(1, seeds + 1):
        recording = simulate(load_scenario(scene, {"seed": seed, **NETWORK}))
        start = relative_start(recording, EGO, SIGMA, seed)
        for way, run in WAYS.items():
            begin = process_time()
            tracks = run(recording, start)
            seconds[way] += process_time() - begin
            errors[way] += [distance_rmse(recording, tracks[name], name) for name in tracks]
    return {way: (errors[way], seconds[way] / seeds) for way in WAYS}


def table(scene: str, figures: Mapping[str, tuple[list[float], float]]) -> str:
    """The result for one scene as a markdown table."""
    base = float(np.mean(figures["by stamp, offline"][0]))
    lines = [
        f"| {scene} | mean, m | median, m | more than by stamp, m | processor s per log |",
        "|---|---|---|---|---|",
    ]
    for way, (errors, seconds) in figures.items():
        mean, median = float(np.mean(errors)), float(np.median(errors))
        lines.append(f"| {way} | {mean:.3f} | {median:.3f} | {mean - base:+.3f} | {seconds:.2f} |")
    return "\n".join([*lines, ""])


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=30)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    study(SCENES[0], 1)  # Kernels are compiled before anything is timed.
    tables = [table(scene, study(scene, options.seeds)) for scene in SCENES]
    text = "\n".join([HEAD.format(seeds=options.seeds), *tables])
    print(text)
    if options.out is not None:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
