"""CPU time of one robot and one round of `distributed.py`, part by part, and what it sends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import process_time

import numpy as np
from relative import relative_start

from clt.filters.distributed.gaussians import make_gaussian_member
from clt.filters.distributed.points import ParticleMember, draw_copies, make_particle_member
from clt.filters.distributed.rounds import make_rounds, select_ranges
from clt.model.choices import FrameSpec
from clt.model.problem import Problem, build_problem
from clt.model.range_table import RangeTable
from clt.model.settings import DistributedSettings, FilterSettings
from clt.sim.scenario import load_scenario
from clt.sim.simulate import simulate

PARTICLES = (50, 200, 1000, 5000)
ROBOTS = (3, 5, 10)
LEAST = 0.05
"""CPU seconds over which a part is timed."""
AIR = 6.8e6
"""Bits per second of a UWB radio."""


@dataclass(frozen=True)
class Cost:
    """CPU seconds of one round of 1 s (10 odometry samples of every robot), and bytes."""

    robots: int
    particles: int
    prediction: float
    own_likelihoods: float
    """Of the M - 1 ranges that one robot measures."""
    all_likelihoods: float
    """Of M (M - 1): every robot measures to every other, as in the paper."""
    pair_likelihoods: float
    """Of M (M - 1) / 2: every pair is measured once, as in the logs of clt."""
    averaging: float
    """One iteration of one robot on a complete graph."""
    update: float
    """Weights and, once in three rounds, new particles."""
    sent: int
    """Bytes of one iteration."""
    functions: float
    """All of a round of the default settings, for one robot."""
    functions_sent: int

    @property
    def distributed(self) -> float:
        """All of a round for one robot of the paper's filter."""
        return self.prediction + self.own_likelihoods + self.averaging + self.update

    @property
    def central(self) -> float:
        """All of a round for one computer that has every range."""
        return self.prediction + self.all_likelihoods + self.update


def timed(work: Callable[[], object]) -> float:
    """CPU seconds of one call: the least of three means."""
    work()
    means = []
    for _ in range(3):
        count, begin = 0, process_time()
        while process_time() - begin < LEAST:
            work()
            count += 1
        means.append((process_time() - begin) / count)
    return min(means)


def problem_of(robots: int) -> Problem:
    """Robots that wander in Li's arena, at a start known to 0.1 m and 0.03 rad."""
    scenario = load_scenario("li-three", {"team.moving": robots, "duration": 4.0})
    recording = simulate(scenario.model_copy(update={"robots": ()}))
    start = relative_start(recording, "R1", (0.1, 0.03), 1)
    return build_problem(recording, start, FilterSettings(), FrameSpec("ego", ("R1",)))


def both_ways(table: RangeTable) -> RangeTable:
    """Every range as measured by either end."""
    return RangeTable._make(
        np.concatenate([one, other])
        for one, other in zip(table, table._replace(a=table.b, b=table.a), strict=True)
    )


def cost(robots: int, particles: int) -> Cost:
    """Time the parts of the second round."""
    problem = problem_of(robots)
    settings = FilterSettings(dpf=DistributedSettings(likelihood="shared", particles=particles))
    rounds = make_rounds(problem, 0.1)
    first, second = (int(stamp) for stamp in rounds.end[:2])
    robot = make_particle_member(problem, settings, rounds)
    robot.advance(first)
    pairs = select_ranges(problem.ranges, slice(rounds.first[1], rounds.first[2]))
    own = select_ranges(pairs, np.flatnonzero(rounds.owner[rounds.first[1] : rounds.first[2]] == 0))
    link = np.zeros(0, np.int64)

    def weigh(table: RangeTable, member: ParticleMember = robot) -> np.ndarray:
        return member.message(table, member.distances(table)[0], link)

    message, twice = weigh(own), both_ways(pairs)
    values = np.tile(message, (robots, 1))
    return Cost(
        robots,
        particles,
        timed(lambda: robot.copy().advance(second)),
        timed(lambda: weigh(own)),
        timed(lambda: weigh(twice)),
        timed(lambda: weigh(pairs)),
        timed(lambda: np.full(robots, 1.0 / robots) @ values),
        timed(lambda: robot.copy().fuse(message, robots, second))
        + timed(lambda: renew(robot)) / 3.0,
        8 * particles,
        *functions(problem),
    )


def renew(robot: ParticleMember) -> None:
    """Draw particles anew with weights that are uneven enough."""
    member = robot.copy()
    member.cloud.log_weight[:] = -0.1 * np.arange(member.cloud.log_weight.size)
    member.cloud.log_weight[:] -= np.log(np.exp(member.cloud.log_weight).sum())
    source = draw_copies(member, 0.5)
    assert source is not None
    member.take(source)


def functions(problem: Problem) -> tuple[float, int]:
    """CPU seconds of a round and bytes of an iteration with the default settings."""
    settings, rounds = FilterSettings(), make_rounds(problem, 0.1)
    first, second = (int(stamp) for stamp in rounds.end[:2])
    robots = len(problem.drivers)
    robot = make_gaussian_member(problem, settings, rounds)
    robot.advance(first)
    pairs = select_ranges(problem.ranges, slice(rounds.first[1], rounds.first[2]))
    link = rounds.link[rounds.first[1] : rounds.first[2]]
    own = np.flatnonzero(rounds.owner[rounds.first[1] : rounds.first[2]] == 0)
    share = 1.0 / robots

    def one_round() -> None:
        member = robot.copy()
        member.advance(second)
        table = select_ranges(pairs, own)
        h, _ = member.distances(table)
        message = member.message(table, h, link[own])
        everyone = share * member.message(pairs, h, link)
        np.full(robots, share) @ np.tile(message, (robots, 1))
        member.fuse(everyone, robots, second)

    size = 8 * robot.message(pairs, np.empty(0), link).size
    return timed(one_round), size


def costs() -> list[Cost]:
    """Over all team sizes and numbers of particles."""
    return [cost(robots, particles) for robots in ROBOTS for particles in PARTICLES]


def tables(found: Sequence[Cost]) -> list[str]:
    """Two tables: the paper's counting beside ours, and computing beside sending."""
    lines = [
        (
            "CPU time of one round of 1 s (ranges once, 10 odometry samples of each robot) in us,"
            " one robot of the distributed filter beside one computer that does all. Ratios are"
            " centralized / distributed."
        ),
        "",
        (
            "| robots | particles | predict | likelihoods: own | both ways | once a pair "
            "| average | update | ratio, likelihoods, both ways (the paper's) | once a pair "
            "| whole round |"
        ),
        "|" + "---|" * 11,
    ]
    for c in found:
        parts = (c.prediction, c.own_likelihoods, c.all_likelihoods, c.pair_likelihoods)
        cells = [f"{1e6 * part:,.0f}" for part in (*parts, c.averaging, c.update)]
        ratios = (
            c.all_likelihoods / c.own_likelihoods,
            c.pair_likelihoods / c.own_likelihoods,
            c.central / c.distributed,
        )
        cells += [f"{ratio:.2f}" for ratio in ratios]
        lines.append(f"| {c.robots} | {c.particles:,} | {' | '.join(cells)} |")
    lines += [
        "",
        (
            "What one iteration costs each robot to send, the time that its bits are on a UWB radio"
            f" of {AIR / 1e6:g} Mbit/s, and a whole round of the default settings, whose messages"
            " do not depend on particles."
        ),
        "",
        (
            "| robots | particles | bytes | on air, us | whole round, us | default: bytes |"
            " on air, us | whole round, us |"
        ),
        "|" + "---|" * 8,
    ]
    for c in found:
        lines.append(
            f"| {c.robots} | {c.particles:,} | {c.sent:,} | {8e6 * c.sent / AIR:,.0f} "
            f"| {1e6 * c.distributed:,.0f} | {c.functions_sent:,} "
            f"| {8e6 * c.functions_sent / AIR:,.0f} | {1e6 * c.functions:,.0f} |"
        )
    return lines
