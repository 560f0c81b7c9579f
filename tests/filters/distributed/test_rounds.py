"""Rounds, silences and messages of a distributed team by themselves."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from clt.filters.distributed import team as team_module
from clt.filters.distributed.consensus import connected_groups, make_network
from clt.filters.distributed.gaussians import MIN_REACHED_SHARE, GaussianMember
from clt.filters.distributed.motion import (
    RoundTwists,
    SharedParticles,
    cut_at_rounds,
    normal_deviates,
    propagate_shared,
)
from clt.filters.distributed.points import ParticleMember, draw_copies
from clt.filters.distributed.rounds import (
    UNKNOWN_HEADING_VARIANCE,
    Outage,
    PropagatedState,
    distance_and_variance,
    drive_along_odometry,
    extrapolate_odometry,
    make_rounds,
    ranges_at_round_end,
    select_ranges,
    twist_statistics,
)
from clt.filters.distributed.team import (
    MAX_SILENCE_NS,
    apply_outages,
    count_unreachable,
    links_in_reach,
    merge_groups,
    robots_present,
    unreachable_seconds,
)
from clt.initialization.given.truth import from_truth
from clt.model.problem import build_problem
from clt.model.settings import FilterSettings
from clt.model.state_space import make_state_space, world_state_space
from clt.model.twist_segments import TwistSegments
from tests.filters.kalman.test_search_parts import SECOND, table
from tests.filters.teams import team_recording

pytestmark = pytest.mark.usefixtures("interpreted")


def segments_of(*ends, v=1.0, omega=0.0, var=0.04):
    """Twist segments of some drivers that end at these seconds."""
    first = np.cumsum([0, *map(len, ends)])
    end = np.rint(np.concatenate(ends) * SECOND).astype(np.int64)
    n = end.size
    return TwistSegments(
        first, end, np.full(n, v), np.full(n, omega), np.full(n, 0.5), np.full(n, var),
        np.full(n, 2.0 * var),
    )  # fmt: skip


TWO = segments_of(0.5 * np.arange(1, 11), 0.5 * np.arange(1, 11))


def problem_of(rows, segments=TWO, space=None, end=5.0):
    """What rounds read of a problem of two robots in the world."""
    return SimpleNamespace(
        ranges=table(rows), space=world_state_space(2) if space is None else space,
        segments=segments, start=0, end=round(end * SECOND), lever=np.zeros((2, 2)),
        drivers=("R1", "R2"), robots=("R1", "R2"),
    )  # fmt: skip


ROWS = [(0.2, 0, -1, 0, 0, 3.0), (0.6, 1, -1, 0, 0, 3.0), (1.0, 0, 1, 0, 0, 3.0),
        (1.1, 1, 0, 0, 0, 3.0), (4.9, 0, -1, 0, 0, 3.0)]  # fmt: skip


def test_ranges_belong_to_the_round_in_which_they_were_measured():
    found = make_rounds(problem_of(ROWS), 1.0)
    assert (found.end / SECOND).tolist() == [1.0, 2.0, 5.0]
    assert found.first.tolist() == [0, 3, 4, 5]
    assert found.owner.tolist() == [0, 1, 0, 1, 0]
    assert found.link.tolist() == [0, 1, 2, 3, 0]
    assert found.pairs.a.tolist() == [0, 1, 0, 1]
    assert found.pairs.b.tolist() == [-1, -1, 1, 0]
    instants = make_rounds(problem_of(ROWS), 0.0)
    assert instants.end.tolist() == table(ROWS).stamp.tolist()
    late = make_rounds(problem_of(ROWS, end=4.95), 1.0)
    assert late.end[-1] == round(4.95 * SECOND)


def test_ranges_of_the_ego_belong_to_it():
    """In its frame it is no block: its end is fixed at the origin."""
    space = make_state_space([1], [0])
    rows = [(0.2, -1, 0, 0, 0, 3.0), (0.3, 0, -1, 0, 0, 3.0)]
    found = make_rounds(problem_of(rows, space=space), 1.0)
    assert found.owner.tolist() == [0, 1]


def test_odometry_is_cut_at_rounds_with_as_much_noise_in_all():
    segments = segments_of([1.0, 2.0], [2.0])
    found = cut_at_rounds(segments, 0, np.array([SECOND // 2, 3 * SECOND // 2, 9 * SECOND]))
    assert found.first.tolist() == [0, 4, 7]
    assert (found.end / SECOND).tolist() == [0.5, 1.0, 1.5, 2.0, 0.5, 1.5, 2.0]
    lengths = np.array([0.5, 0.5, 0.5, 0.5, 0.5, 1.0, 0.5])
    np.testing.assert_allclose(found.sigma_v**2 * lengths, 0.04 * 0.5)
    np.testing.assert_allclose(found.sigma_omega**2 * lengths, 0.08 * 0.5)
    late = cut_at_rounds(segments, SECOND // 2, np.array([SECOND // 4]))
    assert (late.end[:2] / SECOND).tolist() == [1.0, 2.0]


def test_deviates_are_standard_normal_and_functions_of_seed_row_and_particle():
    with np.errstate(over="ignore"):
        drawn = np.array(
            [normal_deviates(np.uint64(7), row, q) for row in range(40) for q in range(50)]
        )
        again = normal_deviates(np.uint64(7), 3, 4)
        other = normal_deviates(np.uint64(8), 3, 4)
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=0.07)
    np.testing.assert_allclose(np.cov(drawn.T), np.eye(2), atol=0.08)
    assert drawn[3 * 50 + 4].tolist() == list(again)
    assert other[0] != again[0]
    assert np.unique(drawn).size == drawn.size


def test_shared_particles_do_not_depend_on_where_they_are_stopped():
    drive = RoundTwists(
        np.array([0, 2]), np.array([SECOND, 2 * SECOND]), np.ones(2), np.full(2, 0.3),
        np.full(2, 0.1), np.full(2, 0.1),
    )  # fmt: skip
    ends = []
    for stops in ((3.0,), (0.3, 1.0, 1.7, 3.0)):
        cloud = SharedParticles(
            np.zeros((5, 3)), np.zeros(5), np.zeros(1, np.int64), np.zeros(1, np.int64)
        )
        with np.errstate(over="ignore"):
            for stop in stops:
                until = round(stop * SECOND)
                propagate_shared(cloud, until, drive, world_state_space(1), np.uint64(1))
                assert cloud.time[0] == until
        assert cloud.cursor[0] == 2
        ends.append(cloud.x)
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)
    assert np.ptp(ends[0][:, 0]) > 0.01


def test_what_is_usual_of_a_driver():
    segments = segments_of([1.0, 2.0], [])
    segments = segments._replace(v=np.array([1.0, 3.0]), omega=np.array([0.5, -0.5]))
    found = twist_statistics(SimpleNamespace(segments=segments))
    np.testing.assert_allclose(found, [[5.0, 2.0, 0.5], [0.0, 0.0, 0.0]])


def outage(since=2.0, until=3.0, last=1.0, usual=(4.0, 0.5, 0.2)):
    return Outage(
        np.array([1]), round(since * SECOND), round(until * SECOND),
        np.array([round(last * SECOND)]), np.array([usual]),
    )  # fmt: skip


def test_a_silence_grows_with_the_square_of_time():
    found = outage()
    np.testing.assert_allclose(found.growth(), [4.0 - 1.0])
    before, after = found.lost()
    np.testing.assert_allclose([before[0], after[0]], [0.2, 0.8])
    long = outage(until=99.0).lost()[1]
    assert long[0] == UNKNOWN_HEADING_VARIANCE


@pytest.mark.parametrize("straight", [True, False])
def test_the_last_twist_of_who_is_not_heard_is_held(straight):
    v = np.arange(1.0, 21.0)
    problem = build(TWO._replace(v=v, omega=0.1 * v))
    found = extrapolate_odometry(problem, outage(), straight=straight).segments
    # The sample that ends at 2 s is known, those up to 3 s are not: rows 14 and 15 of robot 2.
    slower = np.exp(0.5 * (0.2 - 0.8)) if straight else 1.0
    np.testing.assert_allclose(found.v[14:16], slower * v[13])
    np.testing.assert_allclose(found.omega[14:16], 0.1 * v[13])
    np.testing.assert_allclose(found.interval[14:16], 3.0)
    np.testing.assert_allclose(found.var_v[14:16], 0.04 + 0.5)
    np.testing.assert_allclose(found.var_omega[14:16], 0.08 + (0.8 - 0.2) / 3.0)
    rest = [*range(14), *range(16, 20)]
    for name in ("v", "omega", "interval", "var_v", "var_omega"):
        known = getattr(problem.segments, name)
        np.testing.assert_array_equal(getattr(found, name)[rest], known[rest])


def build(segments):
    recording = team_recording(moving=2, seconds=1.0)
    made = build_problem(recording, from_truth(recording, (0.1, 0.1, 0.1)), FilterSettings())
    return replace(made, segments=segments)


def test_a_path_goes_along_odometry_and_its_variance_adds_up():
    path = PropagatedState(np.zeros(6), np.zeros(2, np.int64), TWO.first[:-1].copy())
    added = drive_along_odometry(path, 1, round(1.2 * SECOND), TWO, world_state_space(2))
    assert added == pytest.approx(0.04 * 0.5 * 1.2)
    np.testing.assert_allclose(path.x, [0, 0, 0, 1.2, 0, 0], atol=1e-12)
    assert (path.time.tolist(), path.cursor.tolist()) == ([0, round(1.2 * SECOND)], [0, 12])


def test_ranges_are_carried_to_the_end_of_their_round():
    """The ego drives towards robot 2, which stands: either of them may measure."""
    segments = TWO._replace(v=np.concatenate([np.ones(10), np.zeros(10)]))
    space = make_state_space([1], [0])
    problem = problem_of([(0.5, -1, 0, 0, 0, 7.5), (0.5, 0, -1, 0, 0, 7.5)], segments, space)
    path = PropagatedState(np.array([8.0, 0, 0]), np.zeros(2, np.int64), TWO.first[:-1])
    found = ranges_at_round_end(path, problem.ranges, 2 * SECOND, problem)
    np.testing.assert_allclose(found.range, [6.0, 6.0])
    way = 2.0 * 0.04 * 0.5 * 1.5
    np.testing.assert_allclose(found.variance, 0.01 + way)
    np.testing.assert_allclose(found.weight_variance, found.variance)
    assert found.stamp.tolist() == [2 * SECOND] * 2
    assert path.x[0] == 8.0
    now = ranges_at_round_end(path, problem.ranges, SECOND // 2, problem)
    assert now is problem.ranges


def test_the_variance_of_a_distance_is_that_of_the_ways_of_its_ends():
    space, lever = make_state_space([1, 2], [0, 0]), np.zeros((2, 2))
    x, way = np.array([3.0, 4.0, 0, 3.0, 16.0, 0]), np.array([0.5, 0.3, 0.7])
    ranges = table([(1, 0, -1, 0, 0, 5.0), (1, -1, 1, 0, 0, 5.0), (1, 0, 1, 0, 0, 5.0)])
    found = [distance_and_variance(x, space, lever, ranges, m, way) for m in range(3)]
    np.testing.assert_allclose(found, [[5.0, 0.8], [np.hypot(3.0, 16.0), 1.2], [12.0, 1.0]])


def test_a_robot_is_there_with_ranges_or_with_odometry_of_late():
    """Robot 2's odometry has a hole from 1 s to 4 s; it measures at 2 s."""
    segments = segments_of(np.arange(1, 51) / 10, [*np.arange(1, 11) / 10, *np.arange(40, 51) / 10])
    rows = [(0.5, 0, 1, 0, 0, 3.0), (1.5, 0, -1, 0, 0, 3.0), (2.0, 1, 0, 0, 0, 3.0),
            (3.0, 0, 1, 0, 0, 3.0), (4.5, 0, 1, 0, 0, 3.0)]  # fmt: skip
    problem = problem_of(rows, segments)
    rounds = make_rounds(problem, 0.0)
    found = robots_present(problem, rounds)
    assert found[:, 0].all()
    assert found[:, 1].tolist() == [True, False, True, False, True]
    none = robots_present(problem_of(rows, segments_of(np.arange(1, 51) / 10, [])), rounds)
    assert none.all()


def test_groups_are_those_who_hear_each_other():
    up = np.zeros((5, 5), np.bool_)
    for a, b in ((0, 3), (3, 4), (1, 2)):
        up[a, b] = up[b, a] = True
    found = connected_groups(up, np.array([True, True, True, True, False]))
    assert [group.tolist() for group in found] == [[0, 3], [1, 2]]
    found = connected_groups(up, np.array([True, False, True, False, True]))
    assert [group.tolist() for group in found] == [[0], [2], [4]]


class Fake:
    """A member that says what was done to it."""

    size = 100

    def __init__(self, name):
        self.name, self.silent = name, None

    def without(self, silent):
        self.silent = silent
        return self


def team_of(M, **columns):
    values = {
        "members": [Fake(k) for k in range(M)], "paths": list(range(M)),
        "line": np.zeros(M, np.int64), "heard": np.zeros((M, M), np.int64),
        "usual": np.arange(3.0 * M).reshape(M, 3), "apart": np.zeros(M, np.int64),
        "net": make_network(M, 0.0, 1),
    }  # fmt: skip
    return SimpleNamespace(**{**values, **columns})


def test_who_comes_to_a_group_takes_over_from_a_neighbour(monkeypatch):
    monkeypatch.setattr(team_module, "adopt_belief", lambda _, giver: giver)
    up = np.zeros((4, 4), np.bool_)
    for a, b in ((0, 1), (1, 2), (2, 3)):
        up[a, b] = up[b, a] = True
    team = team_of(4, line=np.array([5, 5, 6, 7]), heard=np.arange(16).reshape(4, 4))
    merge_groups(team, [np.arange(4)], up)
    assert [member.name for member in team.members] == [0, 1, 1, 1]
    assert team.paths == [0, 1, 1, 1]
    assert team.heard[3].tolist() == [4, 5, 6, 7]
    assert team.line.tolist() == [0, 0, 0, 0]
    assert team.net.messages_sent.tolist() == [0, 1, 1, 0]
    assert team.net.bytes_heard.tolist() == [0, 0, 100, 100]
    apart = team_of(3)
    merge_groups(apart, [np.array([0, 2])], up[:3, :3])
    assert apart.line[0] == apart.line[2] != apart.line[1]


def test_odometry_of_other_groups_is_taken_away():
    team = team_of(3)
    team.heard[:] = 1
    apply_outages(team, [np.array([0, 2])], 5, 9)
    silent = team.members[0].silent
    assert (silent.drivers.tolist(), silent.since, silent.until) == ([1], 5, 9)
    assert silent.last.tolist() == [1]
    assert silent.usual.tolist() == [[3.0, 4.0, 5.0]]
    assert team.members[1].silent.drivers.tolist() == [0, 2]
    assert team.heard.tolist() == [[5, 1, 5], [1, 5, 1], [5, 1, 5]]
    whole = team_of(2)
    apply_outages(whole, [np.arange(2)], 5, 9)
    assert whole.members[0].silent is None


def test_time_out_of_reach_of_the_ego_adds_up():
    team = team_of(
        3, there=np.array([[True, True, False]]),
        problem=SimpleNamespace(drivers=("A", "B", "C")),
    )  # fmt: skip
    parts = [np.array([0]), np.array([1])]
    count_unreachable(team, parts, 0, 0, MAX_SILENCE_NS)
    assert team.apart.tolist() == [0, MAX_SILENCE_NS, 0]
    assert unreachable_seconds(team) == {}
    count_unreachable(team, parts, 0, 0, 1)
    assert unreachable_seconds(team) == {"B": pytest.approx(1.0, abs=1e-6)}
    silent = team_of(2, there=np.array([[False, True]]))
    count_unreachable(silent, [np.array([1])], 0, 0, SECOND)
    assert silent.apart.tolist() == [0, 0]


def test_links_end_where_robots_are_out_of_reach():
    path = PropagatedState(np.array([0, 0, 1.0, 3, 4, 1.0]), None, None)
    links = ~np.eye(2, dtype=np.bool_)
    for reach, up in ((5.0, True), (4.99, False)):
        team = team_of(
            2, paths=[path], links=links,
            problem=SimpleNamespace(robots=("A", "B"), space=world_state_space(2)),
            settings=SimpleNamespace(dpf=SimpleNamespace(reach=reach)),
        )  # fmt: skip
        assert links_in_reach(team)[0, 1] == up
        assert not links_in_reach(team)[0, 0]


def member(kind, **columns):
    """A member of which only some columns are read."""
    made = object.__new__(kind)
    for name, value in columns.items():
        object.__setattr__(made, name, value)
    return made


def test_parabolas_add_up_and_come_out_as_single_ranges():
    own = table([(1, 0, 1, 0, 0, 3.0), (1, 0, 1, 0, 0, 5.0), (1, 1, 0, 0, 0, 4.0)])
    own = own._replace(weight_variance=np.array([0.01, 0.04, 0.02]))
    pairs = select_ranges(own, np.array([0, 2]))
    rounds = SimpleNamespace(pairs=pairs)
    one = member(GaussianMember, rounds=rounds, problem=None)
    message = GaussianMember.message(one, own, None, np.array([0, 0, 1])).reshape(-1, 3)
    np.testing.assert_allclose(message, [[125.0, 425.0, 1.0], [50.0, 200.0, 1.0]])


def test_numbers_that_came_only_in_part_show_the_same_range(monkeypatch):
    own = table([(1, 0, 1, 0, 0, 3.0), (1, 1, 0, 0, 0, 4.0)])
    seen = []
    monkeypatch.setattr(GaussianMember, "_run", lambda self, *arguments: seen.append(arguments))
    problem = SimpleNamespace(outputs=[np.empty(0, np.int64), np.empty(0, np.int64)])
    one = member(GaussianMember, rounds=SimpleNamespace(pairs=own), problem=problem)
    share = np.array([[0.25], [0.1 * MIN_REACHED_SHARE]])
    average = np.array([[125.0, 425.0, 1.0], [50.0, 200.0, 1.0]]) * share
    GaussianMember.fuse(one, average.ravel(), 4, 7)
    until, found, _, _ = seen[0]
    assert until == 7
    np.testing.assert_allclose(found.range, [425.0 / 125.0])
    np.testing.assert_allclose(found.variance, [1.0 / 125.0])
    assert found.stamp.tolist() == [7]
    assert (found.a.tolist(), found.b.tolist()) == ([0], [1])


def test_particles_are_weighed_by_all_members_of_a_group():
    cloud = SharedParticles(np.arange(9.0).reshape(3, 3), np.log([0.5, 0.3, 0.2]), None, None)
    one = member(ParticleMember, cloud=cloud)
    h = np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 2.0]])
    ranges = table([(1, 0, 1, 0, 0, 2.0), (1, 0, 1, 0, 0, 2.5)])
    ranges = ranges._replace(weight_variance=np.array([0.5, 0.25]))
    message = ParticleMember.message(one, ranges, h, None)
    np.testing.assert_allclose(message, [-1.0 - 0.5, -0.5, -1.0 - 0.5])
    ParticleMember.fuse(one, message, 2, 0)
    share = np.array([0.5, 0.3, 0.2]) * np.exp(2.0 * message)
    np.testing.assert_allclose(np.exp(cloud.log_weight), share / share.sum())
    ParticleMember.take(one, np.array([2, 2, 0]))
    assert cloud.x[:, 0].tolist() == [6.0, 6.0, 0.0]
    np.testing.assert_allclose(np.exp(cloud.log_weight), 1.0 / 3.0)


@pytest.mark.parametrize("offset", [0.0, 0.5, 0.999])
def test_copies_are_drawn_when_weights_are_uneven(offset):
    even = SharedParticles(np.zeros((4, 3)), np.log(np.full(4, 0.25)), None, None)
    assert draw_copies(member(ParticleMember, cloud=even), offset) is None
    weight = np.array([0.02, 0.9, 0.05, 0.03])
    uneven = SharedParticles(np.zeros((4, 3)), np.log(weight), None, None)
    found = draw_copies(member(ParticleMember, cloud=uneven), offset)
    comb = (np.arange(4) + offset) / 4
    assert found.tolist() == [int(np.argmax(np.cumsum(weight) > tooth)) for tooth in comb]
