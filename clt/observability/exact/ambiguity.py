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

from clt.observability.exact.codistribution import Motion, rows
from clt.observability.exact.rank import by_kind, evaluate, powers_of
from clt.observability.exact.setup import Setup, listed
from clt.observability.exact.states import Place

MOST_SINGLES = 12
"""Beyond this many robots only images of whole groups are tried."""


class Image(NamedTuple):
    """A candidate: another state of some robots."""

    name: str
    members: frozenset[int]
    """The robots that stand elsewhere in it."""
    state: tuple[Place, ...]


def ambiguities(setup: Setup, state: Sequence[Place]) -> tuple[str, ...]:
    """Names of the images of a state that no range can exclude.

    Each is one more choice of two: with k of them, 2^k states give the same ranges.
    """
    found: list[str] = []
    covered: frozenset[int] = frozenset()
    for image in mirrors(setup, state):
        if covered.isdisjoint(image.members) and indistinguishable(setup, state, image):
            found.append(image.name)
            covered |= image.members
    for of_pair in courses(setup, state):
        same = (image.name for image in of_pair if indistinguishable(setup, state, image))
        found += [name for name in [next(same, None)] if name is not None]
    return tuple(found)


def indistinguishable(setup: Setup, state: Sequence[Place], image: Image) -> bool:
    """Whether an image is another state and every function of every pair has the same value."""
    if image.state == tuple(state):
        return False
    for kind, pairs in by_kind(setup).items():
        touched = [pair for pair in pairs if not image.members.isdisjoint(pair)]
        if len(touched) == 0:
            continue
        here, there = powers_of(setup, touched, state), powers_of(setup, touched, image.state)
        for row in rows(kind):
            if not np.array_equal(evaluate(row.function, here), evaluate(row.function, there)):
                return False
    return True


def mirrors(setup: Setup, state: Sequence[Place]) -> Iterator[Image]:
    """Mirror images of groups, then of single robots."""
    unknown = frozenset(k for k in range(len(setup.nodes)) if setup.in_state(k))
    if setup.ego is not None:
        ego = setup.nodes[setup.ego].name
        name = f"mirror image of all others at the path of {ego}"
        yield Image(name, unknown, at_path(state, unknown, setup.ego))
    else:
        groups = setup.groups()
        for group in groups:
            yield _of_group(setup, state, frozenset(group), whole=len(groups) == 1)
    if len(unknown) <= MOST_SINGLES:
        for k in sorted(unknown):
            yield from _of_one(setup, state, k)


def _of_group(setup: Setup, state: Sequence[Place], group: frozenset[int], *, whole: bool) -> Image:
    """A group tied together, at the line through two robots that stay, or at any line."""
    fixed = [k for k in range(len(setup.nodes)) if setup.nodes[k].known]
    names = [setup.nodes[k].name for k in fixed]
    of = "the whole team" if whole else listed([setup.nodes[k].name for k in sorted(group)])
    name = f"mirror image of {of}"
    if len(fixed) >= 2:
        at = f"{name} at the line through {names[0]} and {names[1]}"
        return Image(at, group, at_line(state, group, fixed[0], fixed[1]))
    if len(fixed) == 1:
        return Image(f"{name} at a line through {names[0]}", group, at_path(state, group, fixed[0]))
    return Image(name, group, at_path(state, group, min(group)))


def _of_one(setup: Setup, state: Sequence[Place], k: int) -> Iterator[Image]:
    """One robot at the line through its first two partners, or at one's path.

    Of more partners the others stand on that line as well, or exclude every image.
    """
    name, only = setup.nodes[k].name, frozenset([k])
    partners = sorted({b if a == k else a for a, b in setup.pairs if k in {a, b}})
    if len(partners) >= 2:
        a, b = partners[:2]
        line = f"the line through {setup.nodes[a].name} and {setup.nodes[b].name}"
        yield Image(f"mirror image of {name} at {line}", only, at_line(state, only, a, b))
    for a in partners:
        if not setup.nodes[a].static:
            text = f"mirror image of {name} at the path of {setup.nodes[a].name}"
            yield Image(text, only, at_path(state, only, a))


def courses(setup: Setup, state: Sequence[Place]) -> Iterator[list[Image]]:
    """By pair of steady robots: a position mirrored at the course relative to the only partner.

    Their distance over time depends on the relative velocity alone, and not on the side on which
    they pass each other. Araki section III-C; errata: four solutions in all. A second partner
    tells the side.
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
                moved = mirrored(here, there, ux, uy)
                image = tuple(
                    replace(place, x=moved.x, y=moved.y) if j == k else place
                    for j, place in enumerate(state)
                )
                images.append(Image(text, frozenset([k]), image))
        yield images


def at_line(state: Sequence[Place], members: frozenset[int], a: int, b: int) -> tuple[Place, ...]:
    """The state with some robots mirrored at the line through two places."""
    ux, uy = state[b].x - state[a].x, state[b].y - state[a].y
    return tuple(
        mirrored(place, state[a], ux, uy) if k in members else place
        for k, place in enumerate(state)
    )


def at_path(state: Sequence[Place], members: frozenset[int], a: int) -> tuple[Place, ...]:
    """The state with some robots mirrored at the line along the heading of one."""
    line = state[a]
    return tuple(
        mirrored(place, line, line.c, line.s) if k in members else place
        for k, place in enumerate(state)
    )


def mirrored(place: Place, through: Place, ux: Fraction, uy: Fraction) -> Place:
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
