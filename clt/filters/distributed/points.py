"""Consensus on the likelihoods of particles that all robots share (Li 2020, section III-B).

Every robot holds the same Q particles of the team's shape: same start, same odometry, same random
numbers (`motion`). It weighs them by its own ranges; the average of all robots' log-likelihoods
times their number updates the weights, eq. (24). When the first robot of a group finds its weights
too uneven, all of the group take the copies that it draws: their particles stay the same ones
however few iterations leave their weights different, as long as all hear the same odometry.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from clt.core.arrays import Floats, Indices, Stamps
from clt.filters.distributed.motion import (
    RoundTwists,
    SharedParticles,
    cut_at_rounds,
    propagate_shared,
)
from clt.filters.distributed.rounds import Outage, PropagatedState, Rounds, extrapolate_odometry
from clt.filters.mixture.gaussian_sum import MixtureOutput
from clt.filters.particle.resampling import MIN_EFFECTIVE_SHARE, effective_sample_size
from clt.jit.compiled import compiled_noalloc
from clt.model.belief import Belief, sample_prior
from clt.model.filter_inputs import Outputs
from clt.model.mixture_moments import ROWS, mixture_block_moments, particle_mode_probability
from clt.model.problem import Problem
from clt.model.range_model import predict_distance
from clt.model.range_table import RangeTable
from clt.model.settings import FilterSettings
from clt.model.state_space import StateSpace

MAX_STRAY_WEIGHT = 0.05
"""Particles of no more weight in all, away from the leading mode, are no other mode."""
INDEX_BYTES = 4
"""Of the number of a particle, as sent."""


@dataclass(frozen=True)
class ParticleMember:
    """What one robot holds."""

    problem: Problem
    ends: Stamps
    """Of the rounds, ns."""
    drive: RoundTwists
    seed: np.uint64
    cloud: SharedParticles

    @property
    def size(self) -> int:
        """Bytes to hand it over."""
        return int(8 * (self.cloud.x.size + self.cloud.log_weight.size))

    @property
    def dropped(self) -> float:
        """Probability of what there was no room for: points stand for everything."""
        return 0.0

    @property
    def belief(self) -> Belief:
        """As points without width."""
        K = self.cloud.log_weight.size
        return Belief(self.cloud.log_weight, self.cloud.x, np.zeros((K, 0, 0)))

    def copy(self) -> ParticleMember:
        """One that goes its own way."""
        return replace(self, cloud=SharedParticles._make(array.copy() for array in self.cloud))

    def adopt(self, giver: ParticleMember) -> ParticleMember:
        """This robot with the belief of another."""
        return replace(self, cloud=giver.copy().cloud)

    def without(self, silent: Outage) -> ParticleMember:
        """This robot, which does not hear some others."""
        problem = extrapolate_odometry(self.problem, silent, straight=False)
        return replace(
            self, problem=problem, drive=cut_at_rounds(problem.segments, problem.start, self.ends)
        )

    def path(self) -> PropagatedState:
        """The heaviest particle, as it is now."""
        x, log_weight, time, cursor = self.cloud
        return PropagatedState(x[np.argmax(log_weight)].copy(), time.copy(), cursor.copy())

    def advance(self, until: int) -> None:
        """Bring all to a time (ns)."""
        propagate_shared(self.cloud, until, self.drive, self.problem.space, self.seed)

    def report(self, outputs: Outputs, trace: MixtureOutput) -> None:
        """Fill in the outputs, which are not before the time reached."""
        K = self.cloud.log_weight.size
        space, scratch = self.problem.space, np.zeros((ROWS, 3))
        none = np.zeros((K, 0, 0))
        write_particle_outputs(
            self.cloud, outputs, self.drive, space, self.seed, none, scratch, trace
        )

    def distances(self, table: RangeTable) -> tuple[Floats, Floats]:
        """Distance of each range by each particle, and its variance within: (n, Q) twice."""
        h = np.empty((table.stamp.size, self.cloud.log_weight.size))
        particle_distances(self.cloud.x, self.problem.lever, table, h)
        return h, np.zeros(h.shape)

    def message(self, table: RangeTable, h: Floats, _: Indices) -> Floats:
        """Log-likelihood of every particle by own ranges at distances h (n, Q), shape (Q,)."""
        r = table.range[:, None] - h
        message: Floats = -0.5 * np.sum(r * r / table.weight_variance[:, None], axis=0)
        return message

    def fuse(self, average: Floats, members: int, _: int) -> None:
        """Update the weights by what the members of a group found on average, eq. (24)."""
        log_weight = self.cloud.log_weight
        log_weight += members * average
        log_weight -= log_weight.max()
        log_weight -= math.log(np.exp(log_weight).sum())

    def take(self, source: Indices) -> None:
        """Become copies, equally probable, of the particles `source` (Q,)."""
        self.cloud.x[:] = self.cloud.x[source]
        self.cloud.log_weight[:] = -math.log(source.size)


def make_particle_member(
    problem: Problem, settings: FilterSettings, rounds: Rounds
) -> ParticleMember:
    """What every robot starts with."""
    Q, D, seed = settings.dpf.particles, len(problem.drivers), settings.dpf.seed
    if problem.prior is None:
        raise ValueError("nothing to start from")
    x = sample_prior(problem.prior, Q, np.random.default_rng(seed))
    cloud = SharedParticles(
        x,
        np.full(Q, -math.log(Q)),
        np.full(D, problem.start),
        problem.segments.first[:-1].copy(),
    )
    drive = cut_at_rounds(problem.segments, problem.start, rounds.end)
    cloud.cursor[:] = drive.first[:-1]
    return ParticleMember(problem, rounds.end, drive, np.uint64(seed), cloud)


def draw_copies(points: ParticleMember, offset: float) -> Indices | None:
    """Which particles to copy, (Q,), by a comb of Q teeth; None while the weights are even enough.

    Systematic resampling with an offset in [0, 1).
    """
    log_weight = points.cloud.log_weight
    Q = log_weight.size
    if effective_sample_size(log_weight) >= MIN_EFFECTIVE_SHARE * Q:
        return None
    reached = np.cumsum(np.exp(log_weight))
    source = np.searchsorted(reached, (np.arange(Q) + offset) / Q * reached[-1], side="right")
    taken: Indices = np.minimum(source, Q - 1)
    return taken


@compiled_noalloc
def particle_distances(x: Floats, lever: Floats, table: RangeTable, h: Floats) -> None:
    """Distance of each range by each particle into h (n, Q)."""
    for m in range(table.stamp.size):
        px, py = table.anchor[m, 0], table.anchor[m, 1]
        for q in range(x.shape[0]):
            h[m, q] = predict_distance(x[q], lever, table.a[m], table.b[m], px, py)


@compiled_noalloc
def write_particle_outputs(
    cloud: SharedParticles, outputs: Outputs, drive: RoundTwists, space: StateSpace,
    seed: np.uint64, none: Floats,
    scratch: Floats, trace: MixtureOutput,
) -> None:  # fmt: skip
    """Moments and leading share of each output's block at its time."""
    w, x = cloud.log_weight, cloud.x
    for o in range(outputs.stamp.size):
        i = outputs.robot[o]
        propagate_shared(cloud, outputs.stamp[o], drive, space, seed)
        mixture_block_moments(w, x, none, w.size, i, trace.mean[o], trace.covariance[o])
        share = particle_mode_probability(w, x, none, i, trace.covariance[o], scratch)
        trace.share[o] = 1.0 if share >= 1.0 - MAX_STRAY_WEIGHT else share
