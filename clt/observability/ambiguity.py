"""Discrete ambiguities: mirror images that give every range, under every input, the same.

Two states are indistinguishable exactly when all Lie derivatives of all outputs agree, and the
rows' functions span those. Each candidate image of a random state is tested on all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from clt.observability.codistribution import rows
from clt.observability.rank import by_kind, evaluate, powers_of
from clt.observability.setup import Setup
from clt.observability.states import Place

MOST_SINGLES = 12
"""Beyond this many robots only images of whole groups are tried."""


def ambiguities(setup: Setup, state: Sequence[Place]) -> tuple[str, ...]:
    """Names of the mirror images of a state that no range can exclude."""
    found: list[str] = []
    covered: set[int] = set()
    for name, members, image in images(setup, state):
        moved = tuple(image) != tuple(state) and covered.isdisjoint(members)
        if moved and indistinguishable(setup, state, image, members):
            found.append(name)
            covered |= members
    return tuple(found)


def indistinguishable(
    setup: Setup, state: Sequence[Place], image: Sequence[Place], members: set[int]
) -> bool:
    """Whether every function of every pair has the same value at both states."""
    for kind, pairs in by_kind(setup).items():
        touched = [pair for pair in pairs if not members.isdisjoint(pair)]
        if len(touched) == 0:
            continue
        here, there = powers_of(setup, touched, state), powers_of(setup, touched, image)
        for row in rows(kind):
            if not np.array_equal(evaluate(row.function, here), evaluate(row.function, there)):
                return False
    return True


def images(setup: Setup, state: Sequence[Place]) -> Iterator[tuple[str, set[int], Sequence[Place]]]:
    """Candidate images: name, the robots that move in it, the state it is."""
    unknown = {k for k in range(len(setup.nodes)) if setup.in_state(k)}
    fixed = [k for k in range(len(setup.nodes)) if setup.nodes[k].known]
    if setup.ego is not None:
        ego = setup.nodes[setup.ego].name
        name = f"mirror image of all others at the path of {ego}"
        yield name, unknown, mirrored(state, unknown, state[setup.ego], None)
    else:
        yield from _of_group(setup, state, unknown, fixed)
    if len(unknown) > MOST_SINGLES:
        return
    for k in sorted(unknown):
        yield from _of_one(setup, state, k)


def _of_group(
    setup: Setup, state: Sequence[Place], unknown: set[int], fixed: Sequence[int]
) -> Iterator[tuple[str, set[int], Sequence[Place]]]:
    """The whole team at the line through two robots that stay, or at any line."""
    names = [setup.nodes[k].name for k in fixed]
    if len(fixed) >= 2:
        name = f"mirror image of the whole team at the line through {names[0]} and {names[1]}"
        yield name, unknown, mirrored(state, unknown, state[fixed[0]], state[fixed[1]])
    elif len(fixed) == 1:
        name = f"mirror image of the whole team at a line through {names[0]}"
        yield name, unknown, mirrored(state, unknown, state[fixed[0]], None)
    elif len(unknown) > 0:
        anchor = min(unknown)
        name = "mirror image of the whole team"
        yield name, unknown, mirrored(state, unknown, state[anchor], None)


def _of_one(
    setup: Setup, state: Sequence[Place], k: int
) -> Iterator[tuple[str, set[int], Sequence[Place]]]:
    """One robot at the line through two it ranges with, or at one's path; or its heading alone."""
    name = setup.nodes[k].name
    partners = sorted({b if a == k else a for a, b in setup.pairs if k in {a, b}})
    for first, a in enumerate(partners):
        for b in partners[first + 1 :]:
            line = f"the line through {setup.nodes[a].name} and {setup.nodes[b].name}"
            text = f"mirror image of {name} at {line}"
            yield text, {k}, mirrored(state, {k}, state[a], state[b])
        if not setup.nodes[a].static:
            text = f"mirror image of {name} at the path of {setup.nodes[a].name}"
            yield text, {k}, mirrored(state, {k}, state[a], None)


def mirrored(
    state: Sequence[Place], members: set[int], through: Place, second: Place | None
) -> tuple[Place, ...]:
    """The state with some robots mirrored at a line: through two places, or a place's path."""
    ux, uy = through.c, through.s
    if second is not None:
        ux, uy = second.x - through.x, second.y - through.y
    norm = ux * ux + uy * uy
    if norm == 0:
        return tuple(state)
    a, b = (ux * ux - uy * uy) / norm, 2 * ux * uy / norm
    image = list(state)
    for k in members:
        place = state[k]
        dx, dy = place.x - through.x, place.y - through.y
        image[k] = replace(
            place,
            x=through.x + a * dx + b * dy,
            y=through.y + b * dx - a * dy,
            c=a * place.c + b * place.s,
            s=b * place.c - a * place.s,
        )
    return tuple(image)
