"""The most probable noise of a log: its filter runs again and again, with one after another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from clt.core.recording import Recording
from clt.core.start import Start
from clt.estimation.noise.kinds import (
    GRIDS,
    NO_SLOW,
    SLOW_STARTS,
    Platform,
    Values,
    with_noise,
)
from clt.filters.kalman.gaussian import filter_eskf
from clt.model.choices import FrameSpec
from clt.model.problem import DriverTwists, build_problem, driver_segments
from clt.model.settings import FilterSettings

MIN_GAIN = 10.0
"""Log-likelihood by which another kind of noise must be better than none of it."""
MIN_GAIN_PER_RANGE = {"sigma_range": 0.02, "slow": 0.01}
"""The same for each range, where its own noise is another: outliers are never quite as modelled."""
MIN_STEP_GAIN = 2.0
"""The same for another value of a kind that is taken already."""
ROUNDS = 2
"""How often every kind is looked at."""
THREADS = 2
"""Filters that run at once."""


def changed(chosen: Values, kind: str, value: float) -> Values:
    """What is chosen with another value of one kind; the scales of v and omega are one kind."""
    both = {"scale_omega": value} if kind == "scale" else {}
    return {**chosen, kind: value, **both}


@dataclass(frozen=True)
class NoiseSearch:
    """Runs of the filter over one short log, each once."""

    recording: Recording
    start: Start
    settings: FilterSettings
    view: FrameSpec
    hold: bool
    """What no range observes is held (`kalman.free`)."""
    drivers: tuple[str, ...]
    end: int
    """ns."""
    usual: Mapping[str, float]
    """Values of kinds of noise where none is chosen."""
    pinned: frozenset[str]
    """Kinds that are not looked at."""
    found: dict[tuple[tuple[str, float | None], ...], float] = field(default_factory=dict)
    """Log-likelihoods."""
    twists: dict[tuple[float | None, ...], DriverTwists] = field(default_factory=dict)
    """Odometry by its noise."""

    def log_likelihood(self, values: Values) -> float:
        """Of all ranges, with some noise."""
        return self.log_likelihoods([values])[0]

    def log_likelihoods(self, trials: Sequence[Values]) -> list[float]:
        """The same for several, which run at once."""
        keys = [tuple(sorted(values.items())) for values in trials]
        new = {key: one for key, one in zip(keys, trials, strict=True) if key not in self.found}
        if len(self.found) == 0:  # Kernels are compiled by one thread.
            key, values = next(iter(new.items()))
            self.found[key] = self.run(new.pop(key))
        for values in new.values():
            self.twists_with(values)
        with ThreadPoolExecutor(THREADS) as pool:
            self.found.update(zip(new, pool.map(self.run, new.values()), strict=True))
        return [self.found[key] for key in keys]

    def twists_with(self, values: Values) -> DriverTwists:
        """Odometry with some noise; laid out once for each."""
        key = tuple(values.get(name) for name in Platform._fields[:3])
        if key not in self.twists:
            settings = with_noise(self.settings, values)
            self.twists[key] = driver_segments(
                self.recording, self.drivers, settings, self.start.stamp, self.end
            )
        return self.twists[key]

    def run(self, values: Values) -> float:
        """Log-likelihood by one run; -inf where it is not finite."""
        settings = with_noise(self.settings, values)
        problem = build_problem(
            self.recording, self.start, settings, self.view,
            lasting_range_errors=True, twists=self.twists_with(values), with_outputs=False,
        )  # fmt: skip
        solution = filter_eskf(problem, settings, hold=self.hold)
        total = float(np.sum(solution.log_density)) if solution.log_density is not None else -np.inf
        return total if np.isfinite(total) else -np.inf

    def widest(self, chosen: Values, others: Sequence[Values]) -> Values:
        """The last of some changes that is about as good as the best."""
        trials = [{**chosen, **one} for one in others]
        values = self.log_likelihoods(trials)
        enough = max(values) - MIN_GAIN
        return next(
            trial
            for trial, value in zip(trials[::-1], values[::-1], strict=True)
            if value >= enough or not np.isfinite(enough)
        )

    def least_gain(self, kind: str) -> float:
        """By how much another kind of noise than what is stated must be better."""
        per_range = MIN_GAIN_PER_RANGE.get(kind, 0.0)
        return max(MIN_GAIN, per_range * self.recording.ranges.range.size)

    def begin(self, chosen: Values, kind: str) -> Values:
        """The best value of a kind that is not there yet, where it is worth having."""
        trials = [changed(chosen, kind, value) for value in GRIDS[kind] if value > 0.0]
        best = trials[int(np.argmax(self.log_likelihoods(trials)))]
        return self.better(best, chosen, self.least_gain(kind))

    def climb(self, chosen: Values, kind: str) -> Values:
        """Go from value to value of one kind for as long as that is better."""
        if kind in self.pinned or (kind.startswith("slow_") and not chosen.get("slow")):
            return chosen
        grid = np.array(GRIDS[kind])
        value = chosen.get(kind) or self.usual[kind]
        if value == 0.0:
            return self.begin(chosen, kind)
        at = int(np.argmin(np.abs(np.log((grid + 1e-4) / (value + 1e-4)))))
        for step in (1, -1):
            begun = at
            while 0 <= at + step < grid.size:
                trial = changed(chosen, kind, float(grid[at + step]))
                gain = MIN_STEP_GAIN if chosen.get(kind) else self.least_gain(kind)
                if self.log_likelihood(trial) <= self.log_likelihood(chosen) + gain:
                    break
                chosen, at = trial, at + step
            if at != begun:
                break
        return chosen

    def ascend(self, chosen: Values, odometry: Sequence[Values]) -> Values:
        """The most probable noise that is reached by changing one kind after the other."""
        for _ in range(ROUNDS):
            before = chosen
            chosen = self.widest(chosen, odometry)
            for kind in GRIDS:
                if kind != "slow" or chosen.get("slow"):
                    chosen = self.climb(chosen, kind)
            if chosen == before:
                break
        return chosen

    def search(self, odometry: Sequence[Values]) -> Values:
        """The most probable noise with some classes of odometry; slow errors only where needed."""
        first: Values = {**odometry[0], **({} if "slow" in self.pinned else NO_SLOW)}
        white = self.ascend(first, odometry)
        if "slow" in self.pinned:
            return white
        begun = []
        for one in SLOW_STARTS:
            kept = {key: value for key, value in one.items() if key not in self.pinned}
            begun.append(self.climb(self.widest({**first, **kept}, odometry), "sigma_range"))
        slow = self.ascend(max(begun, key=self.log_likelihood), odometry)
        return self.better(slow, white, self.least_gain("slow"))

    def search_near(self, chosen: Values, odometry: Values) -> Values:
        """The most probable noise with one class of odometry, from that with another one."""
        if "slow" in self.pinned:
            return self.ascend({**chosen, **odometry}, [odometry])
        others = {key: value for key, value in chosen.items() if key != "sigma_range"}
        white = self.ascend({**others, **NO_SLOW, **odometry}, [odometry])
        if not chosen.get("slow"):
            return white
        slow = self.ascend({**chosen, **odometry}, [odometry])
        return self.better(slow, white, self.least_gain("slow"))

    def better(self, one: Values, other: Values, gain: float) -> Values:
        """The one noise where it is better by more than `gain`, else the other."""
        lead = self.log_likelihood(one) - self.log_likelihood(other)
        return one if lead > gain else other
