"""Consensus on the ranges' likelihood functions, which frees the robots from shared particles.

The log-likelihood of what one robot measured to another is a parabola in their distance rho,
l(rho) = b rho - c rho^2 / 2 with c = sum 1 / R and b = sum z / R: two numbers, and a third that is
one for the measurer alone. Consensus scales all three by the same share, so their quotients are
exact as soon as the measurer's numbers have come at all, however few iterations there are. Every
robot then corrects what it holds itself: as few Gaussians as its own knowledge needs
(`mixture_kernel`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from clt.core.arrays import Floats, Indices
from clt.filters.distributed.rounds import (
    Outage,
    PropagatedState,
    Rounds,
    extrapolate_odometry,
    select_ranges,
)
from clt.filters.kalman.free import use_first_estimates
from clt.filters.kalman.updates import projected_variance
from clt.filters.mixture.gaussian_sum import (
    GaussianSum,
    MixtureOutput,
    gaussian_sum_belief,
    make_gaussian_sum,
    make_mixture_output,
)
from clt.filters.mixture.mixture import CAPACITY_FACTOR, mixture_kernel
from clt.filters.mixture.reduction import MergeWorkspace, make_merge_workspace
from clt.filters.mixture.splitting import split_prior_headings
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief
from clt.model.filter_inputs import Outputs
from clt.model.problem import Problem
from clt.model.range_model import predict_range
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings

PARABOLA_NUMBERS = 3
"""Numbers for each ordered pair: c, b, and whose they are."""
MAX_START_HEADING_SIGMA = 0.2
"""Heading up to which a Gaussian may be uncertain at the start, rad."""
MIN_REACHED_SHARE = 1e-9
"""Share of a measurer's numbers from which on they count as arrived."""


@dataclass(frozen=True)
class GaussianMember:
    """What one robot holds."""

    problem: Problem
    rounds: Rounds
    gate: float
    gaussians: GaussianSum
    workspace: MergeWorkspace

    @property
    def size(self) -> int:
        """Bytes to hand it over: weight, mean and one triangle of each covariance."""
        K, N = int(self.gaussians.alive[0]), int(self.gaussians.mean.shape[1])
        return 8 * K * (1 + N + N * (N + 1) // 2)

    @property
    def dropped(self) -> float:
        """Probability of what there was no room for."""
        return float(self.gaussians.dropped[0])

    @property
    def belief(self) -> Belief:
        """The Gaussians in use."""
        return gaussian_sum_belief(self.gaussians)

    def copy(self) -> GaussianMember:
        """One that goes its own way."""
        own = (x.copy() if isinstance(x, np.ndarray) else x for x in self.gaussians)
        return replace(self, gaussians=GaussianSum._make(own))

    def adopt(self, giver: GaussianMember) -> GaussianMember:
        """This robot with the belief of another."""
        return replace(self, gaussians=giver.copy().gaussians)

    def without(self, silent: Outage) -> GaussianMember:
        """This robot, which does not hear some others.

        The less is known of where they are heading, the more may their way go anywhere.
        """
        space, blocks = self.problem.space, len(self.problem.robots)
        covariance = self.gaussians.covariance.copy()
        anywhere = 0.5 * silent.usual[:, 0] * (1.0 - np.exp(-silent.lost()[1])) * silent.growth()
        for d, way in zip(silent.drivers.tolist(), anywhere.tolist(), strict=True):
            for i in range(blocks):
                for j in range(blocks):
                    if (space.who[i] == space.who[j] == d) or (space.base[i] == space.base[j] == d):
                        covariance[:, 3 * i, 3 * j] += way
                        covariance[:, 3 * i + 1, 3 * j + 1] += way
        gaussians = self.gaussians._replace(covariance=covariance)
        return replace(
            self,
            gaussians=gaussians,
            problem=extrapolate_odometry(self.problem, silent, straight=True),
        )

    def path(self) -> PropagatedState:
        """The heaviest Gaussian, as it is now."""
        gaussians = self.gaussians
        lead = int(np.argmax(self.belief.log_weight))
        return PropagatedState(
            gaussians.mean[lead].copy(), gaussians.time.copy(), gaussians.cursor.copy()
        )

    def advance(self, until: int) -> None:
        """Bring all to a time (ns)."""
        none = select_ranges(self.problem.ranges, slice(0))
        outputs = Outputs(*(column[:0] for column in self.problem.outputs))
        self._run(until, none, outputs, make_mixture_output(outputs, none))

    def report(self, outputs: Outputs, trace: MixtureOutput) -> None:
        """Fill in the outputs, which are not before the time reached."""
        if outputs.stamp.size > 0:
            self._run(
                int(outputs.stamp[-1]), select_ranges(self.problem.ranges, slice(0)), outputs, trace
            )

    def distances(self, table: RangeTable) -> tuple[Floats, Floats]:
        """Distance of each range by each Gaussian, and its variance within: (n, K) twice."""
        shape = (table.stamp.size, int(self.gaussians.alive[0]))
        h, s = np.empty(shape), np.empty(shape)
        gaussian_distances(self.gaussians, self.problem.lever, table, h, s)
        return h, s

    def message(self, table: RangeTable, _: Floats, link: Indices) -> Floats:
        """The parabolas of own ranges, which belong to some ordered pairs, shape (3 E,)."""
        message = np.zeros((self.rounds.pairs.stamp.size, PARABOLA_NUMBERS))
        np.add.at(message[:, 0], link, 1.0 / table.weight_variance)
        np.add.at(message[:, 1], link, table.range / table.weight_variance)
        message[link, 2] = 1.0
        return message.ravel()

    def fuse(self, average: Floats, _: int, now: int) -> None:
        """Correct by the parabolas of all who were reached: each is one range."""
        c, b, share = average.reshape(-1, PARABOLA_NUMBERS).T
        come = np.flatnonzero((share > MIN_REACHED_SHARE) & (c > 0.0))
        pairs, variance = select_ranges(self.rounds.pairs, come), share[come] / c[come]
        table = pairs._replace(
            stamp=np.full(come.size, now),
            range=b[come] / c[come],
            variance=variance,
            weight_variance=variance,
        )
        outputs = Outputs(*(column[:0] for column in self.problem.outputs))
        self._run(now, table, outputs, make_mixture_output(outputs, table))

    def _run(self, until: int, table: RangeTable, outputs: Outputs, trace: MixtureOutput) -> None:
        """Run the mixture up to a time (ns)."""
        problem = replace(self.problem, ranges=table, outputs=outputs, end=until)
        mixture_kernel(self.gaussians, problem.inputs, self.gate, self.workspace, trace)


def make_gaussian_member(
    problem: Problem, settings: FilterSettings, rounds: Rounds
) -> GaussianMember:
    """What every robot starts with."""
    if problem.prior is None:
        raise ValueError("nothing to start from")
    gaussians = make_gaussian_sum(
        split_prior_headings(problem.prior, MAX_START_HEADING_SIGMA),
        problem,
        CAPACITY_FACTOR * settings.dpf.particles,
        hold=use_first_estimates(problem, settings),
    )
    return GaussianMember(
        problem, rounds, settings.nis_gate, gaussians, make_merge_workspace(gaussians)
    )


@compiled_noalloc
def gaussian_distances(
    gaussians: GaussianSum, lever: Floats, table: RangeTable, h: Floats, s: Floats
) -> None:
    """Distance of each range by each Gaussian and its variance, into h and s (n, K)."""
    for m in range(table.stamp.size):
        a, b, px, py = table.a[m], table.b[m], table.anchor[m, 0], table.anchor[m, 1]
        for k in range(gaussians.alive[0]):
            h[m, k] = predict_range(
                gaussians.mean[k], lever, a, b, px, py, gaussians.J, gaussians.H, 0
            )
            s[m, k] = projected_variance(gaussians.covariance[k], gaussians.J, gaussians.H, 0)
