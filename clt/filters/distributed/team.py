"""The robots of a distributed filter: who hears whom, who is there, who follows whose belief.

Robots that fell silent are left out by the others, which go on; they, and those that were cut off,
take over the belief of the group that they come to. Odometry is repeated until it has arrived.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Bools, Floats, Indices, Stamps
from clt.filters.distributed.consensus import LossyNetwork, communication_links, make_network
from clt.filters.distributed.gaussians import GaussianMember, make_gaussian_member
from clt.filters.distributed.member import DistributedMember
from clt.filters.distributed.points import ParticleMember, make_particle_member
from clt.filters.distributed.rounds import (
    Outage,
    PropagatedState,
    Rounds,
    make_rounds,
    twist_statistics,
)
from clt.filters.mixture.gaussian_sum import MixtureOutput, make_mixture_output
from clt.model.problem import Problem
from clt.model.settings import FilterSettings

MAX_SILENCE_NS = 1_000_000_000
"""A robot without odometry for longer than this, ns, has dropped out ..."""
MAX_SILENT_SAMPLES = 3
"""... unless it is a usual time between its samples: longer than so many of them."""
SAMPLE_BYTES = 40
"""Of one odometry sample as sent: stamp, v, omega and their variances."""


@dataclass(frozen=True)
class DistributedTeam:
    """All M robots of a run, in the order of the problem's drivers: the ego is the first."""

    problem: Problem
    settings: FilterSettings
    rounds: Rounds
    members: list[DistributedMember]
    paths: list[PropagatedState]
    """Where each was at the end of the last round."""
    line: Indices
    """Robots with the same number hold beliefs that come from one another, (M,)."""
    there: Bools
    """Who is heard in each round, (K, M)."""
    heard: Stamps
    """Up to when each (row) knows the odometry of each (column), ns, (M, M)."""
    usual: Floats
    """What is known of each driver that is not heard, (M, 3)."""
    links: Bools
    """Who may hear whom, (M, M)."""
    apart: Indices
    """How long each that was there could not reach the ego so far, ns, (M,)."""
    net: LossyNetwork
    draw: np.random.Generator
    trace: MixtureOutput


def assemble_team(problem: Problem, settings: FilterSettings) -> DistributedTeam:
    """Every robot at the start."""
    own = settings.dpf
    rounds, M = make_rounds(problem, own.interval), len(problem.drivers)
    make = make_particle_member if own.likelihood == "shared" else make_gaussian_member
    members: list[DistributedMember] = [make(problem, settings, rounds) for _ in range(M)]
    return DistributedTeam(
        problem,
        settings,
        rounds,
        members,
        [member.path() for member in members],
        np.zeros(M, np.int64),
        robots_present(problem, rounds),
        np.full((M, M), problem.start),
        twist_statistics(problem),
        communication_links(own.graph, problem.drivers),
        np.zeros(M, np.int64),
        make_network(M, own.loss, own.seed),
        np.random.default_rng([own.seed, 2]),
        make_mixture_output(problem.outputs, problem.ranges),
    )


def merge_groups(team: DistributedTeam, parts: Sequence[Indices], up: Bools) -> None:
    """Whoever comes to a group takes over the belief of its largest part from a neighbour."""
    M = len(team.members)
    line = M + np.arange(M)
    for group in parts:
        common = int(np.bincount(team.line[group]).argmax())
        knows = [int(r) for r in group if team.line[r] == common]
        asks = [int(r) for r in group if team.line[r] != common]
        while len(asks) > 0:
            giver, r = next((i, j) for j in asks for i in knows if up[i, j])
            team.members[r] = adopt_belief(team.members[r], team.members[giver])
            team.paths[r] = team.paths[giver]
            team.heard[r] = team.heard[giver]
            team.net.hand_over(giver, r, team.members[r].size)
            knows.append(r)
            asks.remove(r)
        line[group] = group[0]
    team.line[:] = line


def adopt_belief(member: DistributedMember, giver: DistributedMember) -> DistributedMember:
    """A robot with the belief of another; all of a team hold the same kind."""
    if isinstance(member, ParticleMember) and isinstance(giver, ParticleMember):
        return member.adopt(giver)
    if isinstance(member, GaussianMember) and isinstance(giver, GaussianMember):
        return member.adopt(giver)
    raise TypeError("robots of one team hold beliefs of one kind")


def apply_outages(team: DistributedTeam, parts: Sequence[Indices], since: int, until: int) -> None:
    """Take from every robot the odometry of those who are not in its group, until a time (ns)."""
    M = len(team.members)
    for r in range(M):
        group = next((group for group in parts if r in group), np.array([r]))
        team.heard[r, group] = since
        if group.size < M:
            others = np.setdiff1d(np.arange(M), group)
            silent = Outage(others, since, until, team.heard[r, others], team.usual[others])
            team.members[r] = team.members[r].without(silent)


def links_in_reach(team: DistributedTeam) -> Bools:
    """The links within reach, by the distances that the first robot believed in last, (M, M)."""
    position = np.zeros((len(team.members), 2))
    x = team.paths[0].x[: 3 * len(team.problem.robots)].reshape(-1, 3)
    position[team.problem.space.who] = x[:, :2]
    apart = np.linalg.norm(position[:, None] - position, axis=-1)
    up: Bools = team.links & (apart <= team.settings.dpf.reach)
    return up


def robots_present(problem: Problem, rounds: Rounds) -> Bools:
    """Who is heard in each of the K rounds: with ranges in it, or odometry of late, (K, M)."""
    segments, M = problem.segments, len(problem.drivers)
    there = np.ones((rounds.end.size, M), np.bool_)
    for d in range(M):
        end = segments.end[segments.first[d] : segments.first[d + 1]]
        if end.size > 0:
            step = np.diff(end, prepend=problem.start)
            within = np.minimum(np.searchsorted(end, rounds.end), end.size - 1)
            there[:, d] = step[within] <= max(
                MAX_SILENCE_NS, MAX_SILENT_SAMPLES * float(np.median(step))
            )
    there[np.repeat(np.arange(rounds.end.size), np.diff(rounds.first)), rounds.owner] = True
    return there


def count_odometry_traffic(
    team: DistributedTeam, group: Indices, since: int, now: int, up: Bools
) -> None:
    """Count the samples of one round, which all of a group get from each other."""
    segments = team.problem.segments
    for r in group:
        end = segments.end[segments.first[r] : segments.first[r + 1]]
        low, high = np.searchsorted(end, [since, now], side="right")
        if high > low:
            team.net.flood(int(r), up, group, SAMPLE_BYTES, int(high - low))


def count_unreachable(
    team: DistributedTeam, parts: Sequence[Indices], k: int, since: int, now: int
) -> None:
    """Add round k to the time (ns) that robots could not reach the ego, if both were there."""
    for group in parts:
        if 0 in group:
            out = team.there[k].copy()
            out[group] = False
            team.apart[out] += now - since


def unreachable_seconds(team: DistributedTeam) -> dict[str, float]:
    """Seconds that robots could not reach the ego, of those with more than MAX_SILENCE_NS."""
    return {
        name: 1e-9 * float(apart)
        for name, apart in zip(team.problem.drivers, team.apart, strict=True)
        if apart > MAX_SILENCE_NS
    }
