"""The pictures of `distributed.py`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from distributed_cost import Cost
from matplotlib import pyplot as plt

from clt.core.arrays import Floats

mpl.use("Agg")


def draw_errors(path: Path, step: float, errors: Mapping[str, Floats]) -> None:
    """Error over time, as in the paper's Fig. 8; outputs are `step` seconds apart."""
    figure, axes = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
    for name, error in errors.items():
        axes.plot(np.arange(error.size) * step, error, label=name)
    axes.set(xlabel="time (s)", ylabel="RMS error of relative positions (m)", ylim=(0.0, None))
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_costs(path: Path, costs: Sequence[Cost]) -> None:
    """Time of one robot and round against particles for three robots, as in the paper's Fig. 9."""
    three = [cost for cost in costs if cost.robots == min(c.robots for c in costs)]
    count = [cost.particles for cost in three]
    figure, panels = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
    for axes, title, central, own in (
        (panels[0], "likelihoods alone, as the paper counts",
         [c.all_likelihoods for c in three], [c.own_likelihoods for c in three]),
        (panels[1], "the whole round",
         [c.central for c in three], [c.distributed for c in three]),
    ):  # fmt: skip
        axes.plot(count, np.array(central) * 1e3, "o-", label="centralized")
        axes.plot(count, np.array(own) * 1e3, "s-", label="distributed, one robot")
        axes.set(title=title, xlabel="particles", ylabel="CPU time of a round (ms)")
        axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)
