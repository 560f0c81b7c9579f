"""Lemmas, degenerate motion, names of directions, images and remedies."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clt.observability.analysis import analyse
from clt.observability.codistribution import Motion
from clt.observability.directions import as_residues
from clt.observability.matrix import matrix
from clt.observability.rank import PRIME, echelon, null_space, product, residue
from clt.observability.setup import Setup, every_pair, indices, team
from clt.observability.states import Place, random_state


def setup(moving, static=0, known=0, *, rest=(), straight=(), parallel=(), in_line=(), ego=None):
    nodes = team(moving, static, known)
    motions = dict.fromkeys(straight, Motion.STRAIGHT) | dict.fromkeys(rest, Motion.REST)
    nodes = tuple(replace(node, motion=motions.get(node.name, Motion.FREE)) for node in nodes)
    return Setup(
        nodes,
        every_pair(len(nodes)),
        indices(nodes, parallel),
        indices(nodes, in_line),
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
        A = matrix(case, found.state)
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


def test_robots_that_no_range_ties_together_float_apart():
    nodes = team(4, 0)
    found = analyse(Setup(nodes, ((0, 1), (2, 3))))
    assert found.nullity == 6
    assert "translation in x of R3 and R4" in names(found)
    assert "rotation of R3 and R4 about the origin" in names(found)


def test_without_ranges_nothing_is_seen():
    found = analyse(Setup(team(1, 1, 1), ()))
    assert (found.rank, found.nullity, found.order) == (0, 3, 0)


def test_a_world_made_from_ranges_needs_two_static_robots():
    found = analyse(setup(2, 2))
    assert found.remedies[0].text.startswith("a world made from ranges")
    assert analyse(replace(setup(2, 2), framed=True)).observable


@pytest.mark.parametrize(
    ("case", "nullity"),
    [(setup(50), 3), (setup(48, 2, 2), 0), (setup(30, 20, 1), 1), (setup(50, ego=0), 0)],
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
        for condition in ("rest", "straight", "parallel", "in_line")
    }
    case = setup(moving, static, min(known, static), **chosen)
    state = random_state(case, data.draw(st.integers(0, 1000)))
    turn = Place(
        Fraction(data.draw(st.integers(-9000, 9000))),
        Fraction(data.draw(st.integers(-9000, 9000))),
        Fraction(3, 5),
        Fraction(4, 5),
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
        reduced, pivots = echelon(after)
        assert np.array_equal(product(reduced, carried[pivots]), carried)


def transformed(place, by):
    return Place(
        by.x + by.c * place.x - by.s * place.y,
        by.y + by.s * place.x + by.c * place.y,
        by.c * place.c - by.s * place.s,
        by.s * place.c + by.c * place.s,
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
