"""Lemmas, degenerate motion, names of directions, images and remedies."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from clt.observability.exact.analysis import analyse
from clt.observability.exact.codistribution import Motion, lie_derivatives
from clt.observability.exact.directions import as_residues
from clt.observability.exact.matrix import evaluate_as_float, observability_matrix
from clt.observability.exact.rank import (
    PRIME,
    column_echelon,
    multiply_modulo_prime,
    null_space,
    residue,
)
from clt.observability.exact.setup import Setup, every_pair, setup_indices, setup_robots
from clt.observability.exact.states import ExactPose, random_state


def setup(moving, static=0, known=0, *, parallel=(), in_line=(), ego=None, **motion):
    nodes = setup_robots(moving, static, known)
    motions = {}
    for kind in ("straight", "steady", "rest"):
        motions |= dict.fromkeys(motion.pop(kind, ()), Motion(kind))
    assert motion == {}
    nodes = tuple(replace(node, motion=motions.get(node.name, Motion.FREE)) for node in nodes)
    return Setup(
        nodes,
        every_pair(len(nodes)),
        setup_indices(nodes, parallel),
        setup_indices(nodes, in_line),
        ego,
    )


def names(found):
    return [direction.name for direction in found.unobservable]


LEMMAS = [
    *[((n, 0, 0), 3 * n, 3 * (n - 1)) for n in (2, 3, 4, 5, 9)],  # lemmas 1 to 3
    ((1, 1, 1), 3, 2),  # lemma 4
    ((1, 2, 2), 3, 3),  # lemma 5
    *[((n, 2, 2), 3 * n, 3 * n) for n in (2, 3, 6)],
    *[((n, 1, 1), 3 * n, 3 * n - 1) for n in (2, 5)],
    ((3, 2, 0), 13, 10),
    ((0, 3, 2), 2, 2),
]


@pytest.mark.parametrize(("counts", "dimension", "rank"), LEMMAS)
def test_lemmas(counts, dimension, rank):
    found = analyse(setup(*counts))
    assert (found.dimension, found.rank, found.nullity) == (dimension, rank, dimension - rank)
    assert found.observable == (rank == dimension)
    assert len(found.unobservable) == found.nullity


@pytest.mark.parametrize("counts", [(2, 0), (4, 0), (3, 2), (1, 3), (5, 1)])
def test_relative_poses_are_observable_without_any_frame(counts):
    found = analyse(setup(*counts, ego=0))
    assert found.observable
    assert found.dimension == 3 * (counts[0] - 1) + 2 * counts[1]
    assert found.ambiguities == ()
    assert found.remedies == ()


def test_a_team_without_a_frame_is_named_as_such():
    found = analyse(setup(3))
    assert names(found) == [
        "translation in x",
        "translation in y",
        "rotation of the whole team about the origin",
    ]
    assert [remedy.nullity for remedy in found.remedies] == [0]
    assert found.remedies[0].text.count("static robot of known position") == 2


def test_one_anchor_leaves_the_rotation_about_it_and_a_second_one_cures_it():
    found = analyse(setup(2, 1, 1))
    assert names(found) == ["rotation about static robot S1"]
    assert [remedy.text for remedy in found.remedies] == ["a second static robot of known position"]


def test_vectors_are_null_vectors_of_the_floating_point_matrix():
    for case in (
        setup(3),
        setup(2, 1, 1),
        setup(3, 2, 2, rest=("R2",)),
        setup(2, ego=0, parallel=("R1", "R2")),
        setup(1, 2, 2, in_line=("R1", "S1", "S2")),
        setup(3, 1, 0, straight=("R1",), in_line=("R2", "S1")),
    ):
        found = analyse(case)
        A = observability_matrix(case, found.state)
        columns = [".".join(column) for column in case.columns]
        vectors = np.array(
            [[d.components.get(name, 0.0) for name in columns] for d in found.unobservable]
        )
        assert np.linalg.matrix_rank(vectors) == found.nullity
        assert np.max(np.abs(A @ vectors.T)) < 1e-9 * np.max(np.abs(vectors)) * np.max(np.abs(A))
        assert np.linalg.matrix_rank(A, tol=1e-7 * np.max(np.abs(A))) == found.rank


ARAKI = [
    ({}, 3, []),
    ({"rest": ("R2",)}, 2, ["heading of R2"]),
    ({"rest": ("R1",)}, 2, ["rotation of all others around R1"]),
    ({"rest": ("R1", "R2")}, 1, None),
    ({"parallel": ("R1", "R2")}, 2, ["bearing of R2 from R1"]),
    ({"in_line": ("R1", "R2")}, 1, ["heading of R2", "position of R2 in y"]),
    ({"straight": ("R1", "R2")}, 3, []),
    ({"steady": ("R1", "R2")}, 3, []),
    ({"steady": ("R1", "R2"), "parallel": ("R1", "R2")}, 2, ["bearing of R2 from R1"]),
]


@pytest.mark.parametrize(("conditions", "rank", "open_directions"), ARAKI)
def test_where_arakis_codistribution_drops(conditions, rank, open_directions):
    found = analyse(setup(2, ego=0, **conditions))
    assert (found.dimension, found.rank) == (3, rank)
    if open_directions is not None:
        assert names(found) == open_directions


def test_a_robot_at_rest_hides_its_heading_until_it_moves():
    found = analyse(setup(3, 2, 2, rest=("R3",)))
    assert names(found) == ["heading of R3"]
    assert [remedy.text for remedy in found.remedies] == ["R3 moving"]


def test_a_path_on_the_line_of_the_static_robots():
    found = analyse(setup(1, 2, 2, in_line=("R1", "S1", "S2")))
    assert names(found) == ["heading of R1", "position of R1 across its path"]
    cures = [remedy.text for remedy in found.remedies]
    assert cures == ["a turn of R1", "a third static robot of known position"]


def test_the_mirror_image_is_excluded_only_by_a_turn():
    straight = analyse(setup(2, 2, 2, straight=("R1", "R2")))
    assert straight.observable
    assert straight.ambiguities == ("mirror image of the whole team at the line through S1 and S2",)
    assert "a turn of R1" in [remedy.text for remedy in straight.remedies]
    assert analyse(setup(2, 2, 2, straight=("R1",))).ambiguities == ()
    relative = analyse(setup(2, ego=0, straight=("R1", "R2")))
    assert relative.observable
    assert relative.ambiguities == ("mirror image of all others at the path of R1",)


@pytest.mark.parametrize(("motion", "solutions"), [("straight", 2), ("steady", 4)])
def test_two_straight_drives_have_discrete_solutions(motion, solutions):
    """Araki III-C; errata: at constant speeds four states give the same ranges, else two."""
    case = setup(2, ego=0, **{motion: ("R1", "R2")})
    found = analyse(case)
    assert (found.observable, found.solutions) == (True, solutions)
    assert len(solved(case, found.state)) == solutions


def solved(case, state):
    """All poses of R2 in R1's frame where every function is what it is at a state."""
    functions = [row.function for row in lie_derivatives(case.kind((0, 1)))]
    true = state[1]
    speeds = [float(state[0].v), float(true.v)]

    def values(pose):
        x, y, theta = pose
        numbers = np.array([0, 0, 1, 0, x, y, np.cos(theta), np.sin(theta), *speeds])
        return np.array([evaluate_as_float(one, numbers) for one in functions])

    wanted = values([float(true.x), float(true.y), true.heading])
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        start = [*rng.uniform(-10.0, 10.0, 2), rng.uniform(-np.pi, np.pi)]
        result = least_squares(lambda pose: values(pose) - wanted, start, xtol=1e-14, ftol=1e-14)
        x, y, theta = result.x
        place = np.array([x, y, np.cos(theta), np.sin(theta)])
        new = all(np.linalg.norm(place - other) > 1e-4 for other in found)
        if np.max(np.abs(result.fun)) < 1e-8 and new:
            found.append(place)
    return found


def test_steady_robots_are_distinguished_by_a_third_and_by_a_change_of_speed():
    pair = analyse(setup(2, ego=0, steady=("R1", "R2")))
    assert pair.ambiguities == (
        "mirror image of all others at the path of R1",
        "mirror image of R2 at its course relative to R1, its heading kept",
    )
    assert [remedy.text for remedy in pair.remedies] == ["a turn of R1", "a turn of R2"]
    assert analyse(setup(2, ego=0, steady=("R1",), straight=("R2",))).solutions == 2
    assert analyse(setup(3, ego=0, steady=("R1", "R2", "R3"))).solutions == 2
    world = analyse(setup(2, steady=("R1", "R2")))
    assert len(world.ambiguities) == 2
    assert world.solutions is None


def test_robots_that_range_no_one_but_anchors_have_images_of_their_own():
    nodes = setup(2, 2, 2, straight=("R1", "R2")).nodes
    alone = Setup(nodes, ((0, 2), (0, 3), (1, 2), (1, 3)))
    assert analyse(alone).ambiguities == (
        "mirror image of R1 at the line through S1 and S2",
        "mirror image of R2 at the line through S1 and S2",
    )
    assert analyse(alone).solutions == 4


IN_LINE = [
    (setup(2, ego=0, in_line=("R1", "R2")), 2),
    (setup(1, 2, 2, in_line=("R1", "S1", "S2")), 2),
    (setup(3, in_line=("R1", "R2", "R3")), 4),
    (setup(1, 1, 1, in_line=("R1", "S1")), 1),
    (setup(2, ego=0, parallel=("R1", "R2")), 0),
    (setup(3, parallel=("R1", "R2", "R3")), 0),
    (setup(3, 2, 2, rest=("R3",)), 0),
]


@pytest.mark.parametrize(("case", "bent"), IN_LINE)
def test_what_ranges_show_to_second_order_stands_apart(case, bent):
    """Steps of h along a hidden direction, and a correction of h^2, change F by h^3; not else."""
    found = analyse(case)
    assert sum(not one.hidden for one in found.unobservable) == bent
    hidden = [one.hidden for one in found.unobservable]
    assert hidden == sorted(hidden, reverse=True)
    columns = [".".join(column) for column in case.columns]
    A = observability_matrix(case, found.state)
    for one in found.unobservable:
        v = np.array([one.components.get(name, 0.0) for name in columns])
        v /= np.linalg.norm(v)
        h = 1e-3
        bend = (functions_at(case, found.state, h * v) + functions_at(case, found.state, -h * v)
                - 2 * functions_at(case, found.state, 0 * v)) / h**2  # fmt: skip
        left = bend - A @ np.linalg.lstsq(A, bend, rcond=1e-9)[0]
        assert (np.max(np.abs(left)) < 1e-4) == one.hidden, one.name


def functions_at(case, state, change):
    """All functions of all pairs after a change of the state, in floating point."""
    values = []
    for pair in case.pairs:
        poses, speeds = [], []
        for k in case.ordered(pair):
            place, first = state[k], case.first_column[k]
            own = np.zeros(3)
            if first >= 0:
                size = 2 if case.nodes[k].static else 3
                own[:size] = change[first : first + size]
            theta = place.heading + own[2]
            poses += [float(place.x) + own[0], float(place.y) + own[1]]
            poses += [np.cos(theta), np.sin(theta)]
            speeds.append(float(place.v))
        numbers = np.array([*poses, *speeds])
        values += [
            evaluate_as_float(row.function, numbers) for row in lie_derivatives(case.kind(pair))
        ]
    return np.array(values)


def test_robots_that_no_range_ties_together_float_apart():
    nodes = setup_robots(4, 0)
    found = analyse(Setup(nodes, ((0, 1), (2, 3))))
    assert found.nullity == 6
    assert "translation in x of R3 and R4" in names(found)
    assert "rotation of R3 and R4 about the origin" in names(found)


def test_without_ranges_nothing_is_seen():
    found = analyse(Setup(setup_robots(1, 1, 1), ()))
    assert (found.rank, found.nullity, found.order) == (0, 3, 0)


def test_a_world_made_from_ranges_needs_two_static_robots():
    found = analyse(setup(2, 2))
    assert found.remedies[0].text.startswith("a world made from ranges")
    assert analyse(replace(setup(2, 2), framed=True)).observable


@pytest.mark.parametrize(
    ("case", "nullity"),
    [
        (setup(50), 3),
        (setup(48, 2, 2), 0),
        (setup(30, 20, 1), 1),
        (setup(50, ego=0), 0),
        (setup(50, parallel=[f"R{k + 1}" for k in range(50)]), 4),
        (setup(50, steady=[f"R{k + 1}" for k in range(50)]), 3),
    ],
)
def test_large_teams(case, nullity):
    assert analyse(case).nullity == nullity


ROBOTS = st.tuples(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.data())


@settings(max_examples=40, deadline=None)
@given(ROBOTS)
def test_rank_and_directions_survive_moving_the_whole_team(drawn):
    """Translation by rational steps and rotation by a Pythagorean angle, exactly."""
    moving, static, known, data = drawn
    robots = [f"R{k + 1}" for k in range(moving)]
    chosen = {
        condition: tuple(data.draw(st.sets(st.sampled_from(robots))))
        for condition in ("rest", "straight", "steady", "parallel", "in_line")
    }
    case = setup(moving, static, min(known, static), **chosen)
    state = random_state(case, data.draw(st.integers(0, 1000)))
    turn = ExactPose(
        Fraction(data.draw(st.integers(-9000, 9000))),
        Fraction(data.draw(st.integers(-9000, 9000))),
        Fraction(3, 5),
        Fraction(4, 5),
        Fraction(0),
    )
    moved = tuple(transformed(place, turn) for place in state)
    before, after = null_space(case, state), null_space(case, moved)
    assert before.shape == after.shape
    carried = np.zeros_like(before)
    for k, node in enumerate(case.nodes):
        first = case.first_column[k]
        if first >= 0:
            c, s = residue(turn.c), residue(turn.s)
            carried[first] = (c * before[first] - s * before[first + 1]) % PRIME
            carried[first + 1] = (s * before[first] + c * before[first + 1]) % PRIME
            if not node.static:
                carried[first + 2] = before[first + 2]
    if after.shape[1] > 0:
        reduced, pivots = column_echelon(after)
        assert np.array_equal(multiply_modulo_prime(reduced, carried[pivots]), carried)


def transformed(place, by):
    return ExactPose(
        by.x + by.c * place.x - by.s * place.y,
        by.y + by.s * place.x + by.c * place.y,
        by.c * place.c - by.s * place.s,
        by.s * place.c + by.c * place.s,
        place.v,
    )


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 4), st.integers(0, 3), st.integers(0, 99))
def test_the_ego_frame_sees_what_the_world_sees_but_its_pose(moving, static, seed):
    """Without known positions three numbers, the pose of the team, make the difference."""
    world, ego = setup(moving, static), setup(moving, static, ego=0)
    ranks = [
        len(case.columns) - null_space(case, random_state(case, seed)).shape[1]
        for case in (world, ego)
    ]
    assert ranks[0] == ranks[1] == 3 * moving + 2 * static - 3


def test_residues_of_a_change_are_exact():
    vector = as_residues({1: Fraction(1, 3)}, 3)
    assert vector[1] * 3 % PRIME == 1
    assert vector[0] == vector[2] == 0
