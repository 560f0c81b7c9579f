"""Discrete ambiguities: mirror images that give every range, under every input, the same.

Two states are indistinguishable exactly when all Lie derivatives of all outputs agree, and the
rows' functions span those. Each candidate image of a random state is tested on all of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import chain
from typing import NamedTuple

import numpy as np

from clt.observability.exact.codistribution import Motion, lie_derivatives
from clt.observability.exact.rank import evaluate_polynomial, pair_powers, pairs_by_kind
from clt.observability.exact.setup import Setup, list_names
from clt.observability.exact.states import ExactPose

MAX_ROBOTS_ONE_BY_ONE = 12
"""Beyond this many robots only images of whole groups are tried."""


class MirrorImage(NamedTuple):
    """A candidate: another state of some robots."""

    name: str
    members: frozenset[int]
    """The robots that stand elsewhere in it."""
    state: tuple[ExactPose, ...]


def find_ambiguities(setup: Setup, state: Sequence[ExactPose]) -> tuple[str, ...]:
    """Names of the images of a state that no range can exclude.

    Each is one more choice of two: with k of them, 2^k states give the same ranges.
    """
    found: list[str] = []
    covered: frozenset[int] = frozenset()
    for image in mirror_candidates(setup, state):
        if covered.isdisjoint(image.members) and is_indistinguishable(setup, state, image):
            found.append(image.name)
            covered |= image.members
    for of_pair in course_mirrors(setup, state):
        same = (image.name for image in of_pair if is_indistinguishable(setup, state, image))
        found += [name for name in [next(same, None)] if name is not None]
    return tuple(found)


def is_indistinguishable(setup: Setup, state: Sequence[ExactPose], image: MirrorImage) -> bool:
    """Whether an image is another state and every function of every pair has the same value."""
    if image.state == tuple(state):
        return False
    for kind, pairs in pairs_by_kind(setup).items():
        touched = [pair for pair in pairs if not image.members.isdisjoint(pair)]
        if len(touched) == 0:
            continue
        here, there = pair_powers(setup, touched, state), pair_powers(setup, touched, image.state)
        for row in lie_derivatives(kind):
            if not np.array_equal(
                evaluate_polynomial(row.function, here), evaluate_polynomial(row.function, there)
            ):
                return False
    return True


def mirror_candidates(setup: Setup, state: Sequence[ExactPose]) -> Iterator[MirrorImage]:
    """Mirror images of groups, then of single robots."""
    unknown = frozenset(k for k in range(len(setup.nodes)) if setup.in_state(k))
    if setup.ego is not None:
        ego = setup.nodes[setup.ego].name
        name = f"mirror image of all others at the path of {ego}"
        yield MirrorImage(name, unknown, mirror_at_path(state, unknown, setup.ego))
    else:
        groups = setup.groups()
        for group in groups:
            yield _of_group(setup, state, frozenset(group), whole=len(groups) == 1)
    if len(unknown) <= MAX_ROBOTS_ONE_BY_ONE:
        for k in sorted(unknown):
            yield from _of_one(setup, state, k)


def _of_group(
    setup: Setup, state: Sequence[ExactPose], group: frozenset[int], *, whole: bool
) -> MirrorImage:
    """A group tied together, at the line through two robots that stay, or at any line."""
    fixed = [k for k in range(len(setup.nodes)) if setup.nodes[k].known]
    names = [setup.nodes[k].name for k in fixed]
    of = "the whole team" if whole else list_names([setup.nodes[k].name for k in sorted(group)])
    name = f"mirror image of {of}"
    if len(fixed) >= 2:
        at = f"{name} at the line through {names[0]} and {names[1]}"
        return MirrorImage(at, group, mirror_at_line(state, group, fixed[0], fixed[1]))
    if len(fixed) == 1:
        return MirrorImage(
            f"{name} at a line through {names[0]}", group, mirror_at_path(state, group, fixed[0])
        )
    return MirrorImage(name, group, mirror_at_path(state, group, min(group)))


def _of_one(setup: Setup, state: Sequence[ExactPose], k: int) -> Iterator[MirrorImage]:
    """One robot at the line through its first two partners, or at one's path.

    Of more partners the others stand on that line as well, or exclude every image.
    """
    name, only = setup.nodes[k].name, frozenset([k])
    partners = sorted({b if a == k else a for a, b in setup.pairs if k in {a, b}})
    if len(partners) >= 2:
        a, b = partners[:2]
        line = f"the line through {setup.nodes[a].name} and {setup.nodes[b].name}"
        yield MirrorImage(
            f"mirror image of {name} at {line}", only, mirror_at_line(state, only, a, b)
        )
    for a in partners:
        if not setup.nodes[a].static:
            text = f"mirror image of {name} at the path of {setup.nodes[a].name}"
            yield MirrorImage(text, only, mirror_at_path(state, only, a))


def course_mirrors(setup: Setup, state: Sequence[ExactPose]) -> Iterator[list[MirrorImage]]:
    """By pair of steady robots: a position mirrored at the course relative to the only partner.

    Their distance over time depends on the relative velocity alone, and not on the side on which
    they pass each other. Araki section III-C; errata: four solutions in all. A second partner
    decides the side.
    """
    partners = Counter(chain.from_iterable(setup.pairs))
    for pair in setup.pairs:
        if any(setup.motion(k) is not Motion.STEADY for k in pair):
            continue
        images = []
        for k, other in (pair[::-1], pair):
            if setup.in_state(k) and partners[k] == 1:
                here, there = state[k], state[other]
                ux, uy = here.v * here.c - there.v * there.c, here.v * here.s - there.v * there.s
                name, by = setup.nodes[k].name, setup.nodes[other].name
                text = f"mirror image of {name} at its course relative to {by}, its heading kept"
                moved = mirror_pose(here, there, ux, uy)
                image = tuple(
                    replace(place, x=moved.x, y=moved.y) if j == k else place
                    for j, place in enumerate(state)
                )
                images.append(MirrorImage(text, frozenset([k]), image))
        yield images


def mirror_at_line(
    state: Sequence[ExactPose], members: frozenset[int], a: int, b: int
) -> tuple[ExactPose, ...]:
    """The state with some robots mirrored at the line through two places."""
    ux, uy = state[b].x - state[a].x, state[b].y - state[a].y
    return tuple(
        mirror_pose(place, state[a], ux, uy) if k in members else place
        for k, place in enumerate(state)
    )


def mirror_at_path(
    state: Sequence[ExactPose], members: frozenset[int], a: int
) -> tuple[ExactPose, ...]:
    """The state with some robots mirrored at the line along the heading of one."""
    line = state[a]
    return tuple(
        mirror_pose(place, line, line.c, line.s) if k in members else place
        for k, place in enumerate(state)
    )


def mirror_pose(place: ExactPose, through: ExactPose, ux: Fraction, uy: Fraction) -> ExactPose:
    """A place mirrored at the line through another one along (ux, uy); itself where that is 0."""
    norm = ux * ux + uy * uy
    if norm == 0:
        return place
    a, b = (ux * ux - uy * uy) / norm, 2 * ux * uy / norm
    dx, dy = place.x - through.x, place.y - through.y
    return replace(
        place,
        x=through.x + a * dx + b * dy,
        y=through.y + b * dx - a * dy,
        c=a * place.c + b * place.s,
        s=b * place.c - a * place.s,
    )
