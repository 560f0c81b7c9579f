"""Setups, random states, mirror images, candidates of directions and remedies, by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import pytest

from clt.observability.exact.ambiguity import (
    MAX_ROBOTS_ONE_BY_ONE,
    course_mirrors,
    find_ambiguities,
    is_indistinguishable,
    mirror_at_line,
    mirror_at_path,
    mirror_candidates,
    mirror_pose,
)
from clt.observability.exact.analysis import analyse
from clt.observability.exact.codistribution import Motion
from clt.observability.exact.curvature import is_special
from clt.observability.exact.directions import candidate_changes, name_directions, rotation_change
from clt.observability.exact.rank import null_space
from clt.observability.exact.remedies import (
    MAX_REMEDY_STEPS,
    MAX_SIMILAR_ROBOTS,
    additions,
    find_remedies,
)
from clt.observability.exact.setup import (
    MAX_LISTED_NAMES,
    Setup,
    every_pair,
    list_names,
    setup_indices,
    setup_robots,
)
from clt.observability.exact.states import ExactPose, random_state


def team(moving, static=0, known=0, motions=(), **keys):
    """A complete graph; `motions` of the moving robots in their order."""
    nodes = list(setup_robots(moving, static, known))
    for k, motion in enumerate(motions):
        nodes[k] = replace(nodes[k], motion=motion)
    return Setup(tuple(nodes), every_pair(len(nodes)), **keys)


def exact(x, y, c=1, s=0, v=1):
    return ExactPose(*(Fraction(value) for value in (x, y, c, s, v)))


C, S = Fraction(3, 5), Fraction(4, 5)


def test_columns_and_pairs_of_a_team():
    setup = team(1, 3, 1)
    assert setup.columns == (
        *(("R1", entry) for entry in ("x", "y", "heading")),
        *(("S2", entry) for entry in "xy"),
        *(("S3", entry) for entry in "xy"),
    )
    assert setup.first_column == (0, -1, 3, 5)
    assert [setup.in_state(k) for k in range(4)] == [True, False, True, True]
    assert setup.frame_robots == (1, 2)
    relative = team(2, 1, ego=1)
    assert relative.first_column == (0, -1, 3)
    assert every_pair(3) == ((0, 1), (0, 2), (1, 2))
    assert setup_indices(setup.nodes, ["S2", "R1"]) == frozenset({0, 2})
    with pytest.raises(KeyError):
        setup_indices(setup.nodes, ["nobody"])


def test_how_a_robot_moves_is_the_strictest_that_is_said_of_it():
    motions = (Motion.FREE, Motion.STEADY, Motion.REST, Motion.FREE)
    setup = team(4, 1, 1, motions, parallel=frozenset({0, 1}), in_line=frozenset({2, 3}))
    moved = [setup.motion(k) for k in range(5)]
    assert moved == [Motion.STRAIGHT, Motion.STEADY, Motion.REST, Motion.STRAIGHT, Motion.REST]
    assert setup.kind((0, 1)).tied
    assert not setup.kind((0, 3)).tied
    at_rest = replace(setup, parallel=frozenset({1, 2}))
    assert not at_rest.kind((1, 2)).tied
    assert not setup.kind((0, 1)).ego
    assert replace(setup, ego=1).kind((0, 1)).ego


def test_groups_are_tied_by_ranges_among_robots_of_unknown_pose():
    nodes = setup_robots(4, 2, 1)
    setup = Setup(nodes, ((0, 1), (1, 2), (0, 4), (3, 4), (2, 5)))
    # S1 (4) is known: it ties nobody together. S2 (5) is not.
    assert setup.groups() == ((0, 1, 2, 5), (3,))
    assert Setup(nodes, ()).groups() == ((0,), (1,), (2,), (3,), (5,))
    relative = Setup(setup_robots(3, 0), ((0, 1), (0, 2)), ego=0)
    assert relative.groups() == ((0, 1, 2),)


def test_long_lists_of_names_are_cut():
    names = [f"R{k}" for k in range(1, MAX_LISTED_NAMES + 2)]
    assert list_names([]) == ""
    assert list_names(names[:1]) == "R1"
    assert list_names(names[:3]) == "R1, R2 and R3"
    assert list_names(names[:MAX_LISTED_NAMES]).endswith("R7 and R8")
    assert list_names(names) == "R1, R2, R3, R4, R5, R6 ... R9"


def test_a_pose_seen_from_another_one():
    seen = exact(4, 3, 0, 1, 2).seen_from(exact(1, -1, C, S, 7))
    # 3 m along x and 4 m along y: 5 m straight ahead.
    assert (seen.x, seen.y) == (5, 0)
    assert (seen.c, seen.s, seen.v) == (S, C, 2)
    own = exact(1, -1, C, S)
    assert own.seen_from(own) == exact(0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_random_states_meet_the_conditions_of_their_setup(seed):
    setup = team(4, 1, 0, parallel=frozenset({0, 1}), in_line=frozenset({2, 3, 4}))
    state = random_state(setup, seed)
    assert all(p.c**2 + p.s**2 == 1 for p in state)
    assert len({(p.x, p.y) for p in state}) == 5
    assert (state[0].c, state[0].s, state[0].v) == (state[1].c, state[1].s, state[1].v)
    for k in (3, 4):
        dx, dy = state[k].x - state[2].x, state[k].y - state[2].y
        assert dx * state[2].s == dy * state[2].c
    assert state[2].c == state[3].c
    assert state == random_state(setup, seed)
    assert state != random_state(setup, seed + 1)
    relative = random_state(replace(setup, ego=2), seed)
    assert relative[2] == exact(0, 0, 1, 0, state[2].v)
    assert relative[0] == state[0].seen_from(state[2])


def test_a_mirrored_pose_by_hand():
    through = exact(1, 1)
    found = mirror_pose(exact(3, 2, C, S, 5), through, Fraction(1), Fraction(0))
    assert found == exact(3, 0, C, -S, 5)
    found = mirror_pose(exact(3, 2, C, S, 5), through, Fraction(2), Fraction(2))
    assert found == exact(2, 3, S, C, 5)
    place = exact(3, 2)
    assert mirror_pose(place, through, Fraction(0), Fraction(0)) is place


def test_only_members_are_mirrored():
    state = (exact(0, 0), exact(4, 0), exact(1, 2, C, S), exact(3, -1, 0, 1))
    found = mirror_at_line(state, frozenset({2}), 0, 1)
    assert found == (*state[:2], exact(1, -2, C, -S), state[3])
    found = mirror_at_path(state, frozenset({0, 2}), 3)
    # At the line x = 3 along +y.
    assert found == (exact(6, 0, -1, 0), state[1], exact(5, 2, -C, S), state[3])


def test_with_one_known_robot_the_image_is_a_line_through_it_that_leaves_it_in_place():
    setup = team(2, 1, 1)
    state = random_state(setup, 1)
    group = next(iter(mirror_candidates(setup, state)))
    assert group.name == "mirror image of the whole team at a line through S1"
    assert group.members == {0, 1}
    assert group.state[2] == state[2]
    before = [(p.x - state[2].x) ** 2 + (p.y - state[2].y) ** 2 for p in state]
    after = [(p.x - state[2].x) ** 2 + (p.y - state[2].y) ** 2 for p in group.state]
    assert before == after
    assert group.state[0] != state[0]


def test_images_of_groups_and_of_single_robots_by_name():
    state = random_state(team(2, 2, 2), 1)
    names = [one.name for one in mirror_candidates(team(2, 2, 2), state)]
    assert names == [
        "mirror image of the whole team at the line through S1 and S2",
        "mirror image of R1 at the line through R2 and S1",
        "mirror image of R1 at the path of R2",
        "mirror image of R2 at the line through R1 and S1",
        "mirror image of R2 at the path of R1",
    ]
    free = [one.name for one in mirror_candidates(team(2), state[:2])]
    assert free[0] == "mirror image of the whole team"
    apart = Setup(setup_robots(4, 0), ((0, 1), (2, 3)))
    found = [one.name for one in mirror_candidates(apart, random_state(apart, 0))]
    assert found[:2] == ["mirror image of R1 and R2", "mirror image of R3 and R4"]
    relative = team(2, ego=0)
    found = [one.name for one in mirror_candidates(relative, random_state(relative, 0))]
    assert found[0] == "mirror image of all others at the path of R1"


@pytest.mark.parametrize("over", [0, 1])
def test_of_large_teams_only_groups_are_mirrored(over):
    setup = team(MAX_ROBOTS_ONE_BY_ONE + over, 1, 1)
    count = len(list(mirror_candidates(setup, random_state(setup, 0))))
    assert (count > 1) == (over == 0)


def test_an_image_that_is_the_state_itself_is_none():
    """Robots on the line of the anchors are their own images."""
    setup = team(1, 2, 2, in_line=frozenset({0, 1, 2}))
    state = random_state(setup, 2)
    image = next(iter(mirror_candidates(setup, state)))
    assert image.state == state
    assert not is_indistinguishable(setup, state, image)
    straight = team(1, 2, 2, (Motion.STRAIGHT,))
    assert len(find_ambiguities(straight, random_state(straight, 2))) == 1


def test_courses_are_mirrored_of_steady_robots_with_one_partner_only():
    steady = (Motion.STEADY, Motion.STEADY)
    setup = team(2, motions=steady)
    state = random_state(setup, 3)
    ((second, first),) = course_mirrors(setup, state)
    assert (first.members, second.members) == ({0}, {1})
    for k, image in ((0, first), (1, second)):
        moved, there, own = image.state[k], state[1 - k], state[k]
        assert (moved.c, moved.s) == (own.c, own.s)
        u = (own.v * own.c - there.v * there.c, own.v * own.s - there.v * there.s)
        before = (own.x - there.x) * u[0] + (own.y - there.y) * u[1]
        assert (moved.x - there.x) * u[0] + (moved.y - there.y) * u[1] == before
        cross = (own.x - there.x) * u[1] - (own.y - there.y) * u[0]
        assert (moved.x - there.x) * u[1] - (moved.y - there.y) * u[0] == -cross
        assert is_indistinguishable(setup, state, image)
    third = team(3, motions=(*steady, Motion.STEADY))
    assert all(images == [] for images in course_mirrors(third, random_state(third, 3)))
    free = team(2, motions=(Motion.STEADY, Motion.STRAIGHT))
    assert list(course_mirrors(free, random_state(free, 3))) == []


def test_a_rotation_moves_positions_across_and_turns_what_moves():
    setup = team(1, 2, 1)
    state = (exact(3, 4), exact(1, 1), exact(0, 2))
    assert rotation_change(setup, state, [0, 2], None) == {0: -4, 1: 3, 2: 1, 3: -2, 4: 0}
    assert rotation_change(setup, state, [0], 1) == {0: -3, 1: 2, 2: 1}
    assert rotation_change(setup, state, [0], 1, turning=False) == {0: -3, 1: 2}


def changes(setup, state):
    return dict(candidate_changes(setup, state))


def test_candidates_of_one_robot_in_the_world():
    setup = team(2, 1, 1)
    state = (exact(3, 4, C, S), exact(1, 1), exact(0, 2))
    found = changes(setup, state)
    assert found["translation in x"] == {0: 1, 3: 1}
    assert found["translation in y"] == {1: 1, 4: 1}
    assert found["heading of R2"] == {5: 1}
    assert found["position of R1 along its path"] == {0: C, 1: S}
    assert found["position of R1 across its path"] == {0: -S, 1: C}
    assert found["bearing of R1 from S1"] == {0: -2, 1: 3}
    assert found["rotation of R1 about R2"] == {0: -3, 1: 2, 2: 1}
    assert found["common heading of the whole team"] == {2: 1, 5: 1}
    assert found["rotation about static robot S1"] == {0: -2, 1: 3, 2: 1, 3: 1, 4: 1, 5: 1}


def test_candidates_of_groups_and_of_static_robots():
    setup = Setup(setup_robots(2, 2, 0), ((0, 1), (2, 3)))
    state = (exact(3, 4), exact(1, 1), exact(0, 2), exact(5, 5))
    found = changes(setup, state)
    assert found["translation in y of R1 and R2"] == {1: 1, 4: 1}
    assert found["translation in x of S1 and S2"] == {6: 1, 8: 1}
    assert found["rotation of S1 and S2 about the origin"] == {6: -2, 7: 0, 8: -5, 9: 5}
    assert found["common heading of R1 and R2"] == {2: 1, 5: 1}
    assert found["position of S1 along its line"] == {6: 1, 7: 0}
    assert "heading of S1" not in found
    assert "rotation of S1 about R1" not in found
    relative = team(3, ego=0)
    found = changes(relative, (exact(0, 0), exact(1, 2), exact(3, 4)))
    assert found["rotation of all others around R1"] == {0: -2, 1: 1, 2: 1, 3: -4, 4: 3, 5: 1}
    assert found["bearing of all others from R1"] == {0: -2, 1: 1, 3: -4, 4: 3}


def test_the_headings_of_robots_at_rest_are_open_one_by_one():
    setup = team(2, 2, 2, (Motion.REST, Motion.REST))
    found = analyse(setup)
    assert [one.name for one in found.unobservable] == ["heading of R1", "heading of R2"]
    assert all(one.hidden for one in found.unobservable)
    assert not is_special(setup)
    assert is_special(replace(setup, parallel=frozenset({0})))


def test_a_null_space_that_is_empty_has_no_names():
    setup = team(2, 2, 2)
    state = random_state(setup, 0)
    assert name_directions(setup, state, null_space(setup, state)) == ()


def added(setup):
    return {one.text: one for one in additions(setup)}


def test_what_may_be_added_to_a_team_in_the_world():
    motions = (Motion.REST, Motion.STEADY)
    found = added(team(2, 1, 0, motions))
    assert list(found) == [
        "R1 moving",
        "a turn of R2",
        "a change of speed of R2",
        "the position of S1",
        "a second static robot of known position",
    ]
    assert found["R1 moving"].setup.motion(0) is Motion.FREE
    assert found["a change of speed of R2"].setup.motion(1) is Motion.STRAIGHT
    assert found["the position of S1"].setup.nodes[2].known
    more = found["a second static robot of known position"].setup
    assert (more.nodes[3].name, more.nodes[3].known) == ("S2 (new)", True)
    assert set(more.pairs) == set(every_pair(4))
    unknown = added(team(2, 2, 0))
    assert unknown["a world made from ranges (S1 its origin, S2 on its x axis)"].setup.framed
    known = added(team(1, 1, 1))
    assert not known["a second static robot, its position unknown"].setup.nodes[2].known
    assert not any(text.startswith("a world") for text in known)
    assert not any(text.startswith("a world") for text in added(team(2, 2, 0, framed=True)))
    numbers = [next(t for t in added(team(1, n, n)) if "known position" in t) for n in range(4)]
    assert [text.split(" static")[0] for text in numbers] == [
        "a",
        "a second",
        "a third",
        "a further",
    ]


def test_missing_ranges_between_moving_and_static_robots_may_be_added():
    setup = Setup(setup_robots(3, 2, 2), ((0, 1), (0, 3), (3, 1)))
    found = added(setup)["ranges of R1, R2 and R3 to S1 and S2"].setup
    assert set(found.pairs) == {*setup.pairs, (0, 4), (1, 4), (2, 3), (2, 4)}
    assert not any(text.startswith("ranges") for text in added(team(2, 2, 2)))


def test_in_a_body_frame_only_motion_helps():
    setup = team(3, ego=0, motions=(Motion.REST, Motion.REST, Motion.REST))
    found = added(setup)
    assert list(found) == ["R1 moving", "R2 moving", "R3 moving", "R1, R2 and R3 moving"]
    assert [one.robots for one in found.values()] == [1, 1, 1, 3]
    many = team(MAX_SIMILAR_ROBOTS + 1, ego=0, motions=[Motion.REST] * (MAX_SIMILAR_ROBOTS + 1))
    assert [one.robots for one in additions(many)] == [1, MAX_SIMILAR_ROBOTS + 1]


def test_robots_abreast_may_take_another_course_of_their_own():
    setup = team(2, ego=0, parallel=frozenset({0, 1}))
    found = added(setup)
    assert "another course of R1" in found
    freed = found["another course of R1"].setup
    assert freed.parallel == {1}
    assert freed.motion(0) is Motion.STRAIGHT
    both = found["a turn of R1 and R2"].setup
    assert (both.parallel, both.motion(0), both.motion(1)) == (set(), Motion.FREE, Motion.FREE)
    assert "a change of speed of R1" not in found


def test_remedies_that_leave_nothing_open_come_before_those_that_leave_images():
    setup = team(3, ego=0, motions=(Motion.REST, Motion.REST, Motion.REST))

    def texts(score):
        return [(one.text, one.nullity) for one in find_remedies(setup, score)]

    def moving(one):
        return sum(one.motion(k) is Motion.FREE for k in range(3))

    assert texts(lambda _: (0, 0)) == []
    # One is enough: of those with the fewest robots all are listed.
    found = texts(lambda one: (0, 0) if moving(one) > 0 else (2, 0))
    assert found == [("R1 moving", 0), ("R2 moving", 0), ("R3 moving", 0)]
    assert texts(lambda one: (0, 0) if moving(one) == 3 else (2, 0)) == [
        ("R1, R2 and R3 moving", 0)
    ]
    # Nothing settles the images, but one settles the rest.
    assert texts(lambda one: (0, 1) if one.motion(1) is Motion.FREE else (2, 0))[0] == (
        "R2 moving",
        0,
    )
    # Nothing helps, or only a chain does.
    assert texts(lambda _: (2, 0)) == []
    chain = texts(lambda one: (3 - min(moving(one), 2), 0) if moving(one) < 3 else (3, 0))
    assert chain == [("R1 moving, then R2 moving", 1)]


def test_chains_of_remedies_end():
    setup = team(5, ego=0, motions=[Motion.REST] * 5)

    def score(one):
        return 9 - sum(one.motion(k) is Motion.FREE for k in range(4)), 0

    (found,) = find_remedies(replace(setup, nodes=setup.nodes[:4], pairs=every_pair(4)), score)
    assert found.text.count("moving") <= MAX_REMEDY_STEPS
    assert found.nullity == score(setup)[0] - 4
