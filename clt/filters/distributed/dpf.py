"""Li's distributed particle filter: every robot its own, agreeing by consensus (section III-B).

All robots of the team are run as they would on their own boards; the estimates reported are those
of the ego, the relative poses of all others in its body frame. Each round (`rounds`) a robot
weighs its own ranges against what it holds, the robots that hear each other average what these
said (`consensus`), and each corrects its own belief. What they average is the log-likelihood of
particles that all share (`make_particle_member`) or that of the distances
(`make_gaussian_member`). Their relative headings are part of the state; the paper freezes them at
the start.
"""

from __future__ import annotations

import numpy as np

from clt.core.arrays import Bools, Floats, Indices
from clt.core.errors import UsageError
from clt.filters.distributed.consensus import (
    communication_links,
    connected_groups,
    traffic_by_robot,
)
from clt.filters.distributed.member import DistributedMember
from clt.filters.distributed.points import INDEX_BYTES, ParticleMember, draw_copies
from clt.filters.distributed.rounds import ranges_at_round_end, select_ranges
from clt.filters.distributed.team import (
    DistributedTeam,
    apply_outages,
    assemble_team,
    count_odometry_traffic,
    count_unreachable,
    links_in_reach,
    merge_groups,
    unreachable_seconds,
)
from clt.filters.kalman.eskf_state import RANGE_REJECTED, RANGE_USED
from clt.model.filter_inputs import Outputs
from clt.model.problem import Problem
from clt.model.settings import FilterSettings
from clt.model.solution import Solution

MIN_SHARED_PARTICLES = 20
"""Shared particles at least."""


def solve_dpf(problem: Problem, settings: FilterSettings) -> Solution:
    """Run the team's filters; the solution is the ego's, the innovations each measurer's.

    Raises UsageError for other frames than a robot's, for graphs that leave robots out, and for
    delays longer than a round.
    """
    check_dpf_settings(problem, settings)
    team = assemble_team(problem, settings)
    delay = round(settings.dpf.delay * settings.dpf.iterations * 1e9)
    before, reported, since = None, 0, problem.start
    for k, now in enumerate(team.rounds.end.tolist()):
        upto = int(np.searchsorted(problem.outputs.stamp, now))
        report_ego(team, slice(reported, upto), before, since + delay)
        before = consensus_round(team, k, since, now, keep=delay > 0)
        reported, since = upto, now
    report_ego(team, slice(reported, problem.outputs.stamp.size), before, since + delay)
    count_odometry_traffic(
        team, np.arange(len(team.members)), since, problem.end, links_in_reach(team)
    )
    for member in team.members:
        member.advance(problem.end)
    trace = team.trace
    return Solution(
        trace.mean, trace.covariance, trace.residual, trace.variance, trace.verdict,
        np.zeros(len(problem.robots), np.int64), team.members[0].belief, trace.share,
        dropped=team.members[0].dropped, traffic=traffic_by_robot(team.net, problem.drivers),
        apart=unreachable_seconds(team),
    )  # fmt: skip


def check_dpf_settings(problem: Problem, settings: FilterSettings) -> None:
    """Raise UsageError for what the filter cannot do."""
    if np.any(problem.space.base != 0):
        raise UsageError("--filter dpf estimates relative poses: use --frame ego:NAME")
    if problem.prior is None:
        raise UsageError("--filter dpf has delays of its own (dpf.delay): leave out --as-received")
    if settings.dpf.likelihood == "shared" and settings.dpf.particles < MIN_SHARED_PARTICLES:
        raise UsageError(
            f"dpf.particles={settings.dpf.particles}: so few cannot know how sure they are; "
            f"{MIN_SHARED_PARTICLES} at least"
        )
    if settings.dpf.likelihood == "shared" and np.any(problem.space.calibration >= 0):
        raise UsageError(
            "points cannot keep what never changes apart: noise.scale and noise.bias need "
            "dpf.likelihood=fit"
        )
    names = problem.drivers
    first = connected_groups(
        communication_links(settings.dpf.graph, names), np.ones(len(names), np.bool_)
    )[0]
    if first.size < len(names):
        apart = ", ".join(name for i, name in enumerate(names) if i not in first)
        raise UsageError(
            f"dpf.graph={settings.dpf.graph} cuts {apart} off from {names[0]}: link all robots"
        )
    wanted = settings.dpf.iterations * settings.dpf.delay
    if wanted > settings.dpf.interval:
        raise UsageError(
            f"dpf.iterations x dpf.delay = {wanted:g} s is longer than a round: raise dpf.interval"
        )


def report_ego(
    team: DistributedTeam, which: slice, before: DistributedMember | None, until: int
) -> None:
    """The ego's outputs; up to a time (ns) it does not know the last consensus yet."""
    outputs, trace = Outputs(*(column[which] for column in team.problem.outputs)), team.trace
    split = 0 if before is None else int(np.searchsorted(outputs.stamp, until))
    for member, part in ((before, slice(split)), (team.members[0], slice(split, None))):
        if member is not None:
            member.report(
                Outputs(*(column[part] for column in outputs)),
                trace._replace(
                    mean=trace.mean[which][part],
                    covariance=trace.covariance[which][part],
                    share=trace.share[which][part],
                ),
            )


def consensus_round(
    team: DistributedTeam, k: int, since: int, now: int, *, keep: bool
) -> DistributedMember | None:
    """Hold round k, at `now` (ns): what the ego held before it, if that is to be kept."""
    up, members = links_in_reach(team), team.members
    parts = connected_groups(up, team.there[k])
    merge_groups(team, parts, up)
    count_unreachable(team, parts, k, since, now)
    for member in members:
        member.advance(now)
    messages = [robot_message(team, r, k, now) for r in range(len(members))]
    before = members[0].copy() if keep else None
    for group in parts:
        count_odometry_traffic(team, group, since, now, up)
        values = np.array([messages[r] for r in group])
        iterations = team.settings.dpf.iterations
        values = team.net.average(values, up, group, iterations)
        # What nobody else has heard counts once.
        heard = group.size if iterations > 0 else 1
        for r, value in zip(group, values, strict=True):
            members[r].fuse(value, heard, now)
        resample_group(team, group, up)
    team.paths[:] = [member.path() for member in members]
    ends = team.rounds.end
    apply_outages(team, parts, now, int(ends[k + 1]) if k + 1 < ends.size else team.problem.end)
    return before


def robot_message(team: DistributedTeam, r: int, k: int, now: int) -> Floats:
    """What robot r brings to round k; what it finds of its ranges goes to the trace."""
    rounds, member, trace = team.rounds, team.members[r], team.trace
    first, last = rounds.first[k], rounds.first[k + 1]
    row = first + np.flatnonzero(rounds.owner[first:last] == r)
    table = ranges_at_round_end(
        team.paths[r], select_ranges(team.problem.ranges, row), now, member.problem
    )
    h, s = member.distances(table)
    w = np.exp(member.belief.log_weight)
    mean = h @ w
    variance = (s + (h - mean[:, None]) ** 2) @ w + table.variance
    residual, gate = table.range - mean, team.settings.nis_gate
    used = (residual**2 <= gate * variance) | (gate == 0.0)
    trace.residual[row], trace.variance[row] = residual, variance
    trace.verdict[row] = np.where(used, RANGE_USED, RANGE_REJECTED)
    return member.message(select_ranges(table, used), h[used], rounds.link[row[used]])


def resample_group(team: DistributedTeam, group: Indices, up: Bools) -> None:
    """All of a group take the copies of the shared particles that its first robot draws.

    Where nobody says anything (no iterations) every robot draws its own.
    """
    alone = team.settings.dpf.iterations == 0
    for leader in group if alone else group[:1]:
        first = team.members[leader]
        source = (
            draw_copies(first, float(team.draw.random()))
            if isinstance(first, ParticleMember)
            else None
        )
        if source is None:
            continue
        for r in (leader,) if alone else group:
            member = team.members[r]
            if isinstance(member, ParticleMember):
                member.take(source)
        if not alone:
            team.net.flood(int(leader), up, group, INDEX_BYTES * source.size)
