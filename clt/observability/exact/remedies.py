"""Which one added thing makes a team observable: found by asking again with it added."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

from clt.observability.exact.codistribution import Motion
from clt.observability.exact.setup import Setup, SetupRobot, list_names

MAX_REMEDY_STEPS = 3
"""So many things together are tried where no single one suffices."""
MAX_SIMILAR_ROBOTS = 4
"""Of more robots that are alike the first stands for each."""
OpenQuestions = tuple[int, int]
"""Nullity and number of discrete ambiguities of a setup."""


@dataclass(frozen=True)
class Remedy:
    """What to add, and what the team is then."""

    text: str
    nullity: int
    """Of the team with it added."""


class Addition(NamedTuple):
    """One thing added to a setup."""

    text: str
    setup: Setup
    """With it."""
    robots: int = 1
    """Robots that have to do something."""


def find_remedies(setup: Setup, score: Callable[[Setup], OpenQuestions]) -> tuple[Remedy, ...]:
    """Single additions that leave nothing open; where none does, the shortest chain found."""
    here = score(setup)
    if here == (0, 0):
        return ()
    tried = [(score(one.setup), one) for one in additions(setup)]
    enough = [one for left, one in tried if left == (0, 0)]
    if len(enough) == 0:
        enough = [one for left, one in tried if left[0] == 0 < here[0]]
    if len(enough) == 0:
        return _chain(tried, here, score)
    fewest = min(one.robots for one in enough)
    return tuple(Remedy(one.text, 0) for one in enough if one.robots == fewest)


def _chain(
    tried: list[tuple[OpenQuestions, Addition]],
    here: OpenQuestions,
    score: Callable[[Setup], OpenQuestions],
) -> tuple[Remedy, ...]:
    """Of what was tried the addition that helps most, then the next, while something helps."""
    texts: list[str] = []
    while len(tried) > 0:
        left, best = min(tried, key=lambda pair: (pair[0], pair[1].robots))
        if left >= here:
            break
        here = left
        texts.append(best.text)
        if here == (0, 0) or len(texts) == MAX_REMEDY_STEPS:
            break
        tried = [(score(one.setup), one) for one in additions(best.setup)]
    return (Remedy(", then ".join(texts), here[0]),) if len(texts) > 0 else ()


def additions(setup: Setup) -> Iterator[Addition]:
    """Setups with one thing added."""
    yield from _motion(setup)
    if setup.ego is not None:
        return
    yield from _ranges(setup)
    statics = sum(node.static for node in setup.nodes)
    anchored = any(node.known for node in setup.nodes)
    if setup.frame_robots != () and not setup.framed and not anchored:
        yield from _frame(setup)
    unplaced = next((k for k, node in enumerate(setup.nodes) if node.static and not node.known), -1)
    if unplaced >= 0:
        node = setup.nodes[unplaced]
        placed = _with(setup, unplaced, replace(node, known=True))
        yield Addition(f"the position of {node.name}", placed)
    number = {0: "a", 1: "a second", 2: "a third"}.get(statics, "a further")
    yield Addition(f"{number} static robot of known position", _with_static(setup, known=True))
    if anchored:
        text = f"{number} static robot, its position unknown"
        yield Addition(text, _with_static(setup, known=False))


def _ranges(setup: Setup) -> Iterator[Addition]:
    """Ranges between moving and static robots of which some are missing."""
    met = {frozenset(pair) for pair in setup.pairs}
    apart = [
        (k, j)
        for k, j in combinations(range(len(setup.nodes)), 2)
        if setup.nodes[k].static != setup.nodes[j].static and frozenset((k, j)) not in met
    ]
    if len(apart) > 0:
        ends = sorted({k for pair in apart for k in pair})
        moving = list_names([setup.nodes[k].name for k in ends if not setup.nodes[k].static])
        static = list_names([setup.nodes[k].name for k in ends if setup.nodes[k].static])
        joined = replace(setup, pairs=(*setup.pairs, *apart))
        yield Addition(f"ranges of {moving} to {static}", joined)


def _frame(setup: Setup) -> Iterator[Addition]:
    """A world made from ranges instead of given positions."""
    first, *others = (setup.nodes[k].name for k in setup.frame_robots)
    if len(others) > 0:
        text = f"a world made from ranges ({first} its origin, {others[0]} on its x axis)"
        yield Addition(text, replace(setup, framed=True))


def _motion(setup: Setup) -> Iterator[Addition]:
    """Robots freed from their conditions, one by one (or one for all) and all together."""
    moving = [k for k, node in enumerate(setup.nodes) if not node.static]
    rest = [k for k in moving if setup.nodes[k].motion is Motion.REST]
    straight = [k for k in moving if setup.motion(k) in {Motion.STRAIGHT, Motion.STEADY}]
    bound = setup.parallel | setup.in_line
    steady = [k for k in straight if setup.motion(k) is Motion.STEADY and k not in bound]
    abreast = [k for k in straight if k in setup.parallel]
    for robots, text, motion in (
        (rest, "{} moving", Motion.FREE),
        (straight, "a turn of {}", Motion.FREE),
        (steady, "a change of speed of {}", Motion.STRAIGHT),
        (abreast, "another course of {}", Motion.STRAIGHT),
    ):
        single = [[k] for k in robots] if len(robots) <= MAX_SIMILAR_ROBOTS else [robots[:1]]
        for chosen in (*single, *([robots] if len(robots) > 1 else [])):
            names = list_names([setup.nodes[k].name for k in chosen])
            freed = _freed(setup, chosen, motion)
            yield Addition(text.format(names), freed, len(chosen))


def _freed(setup: Setup, robots: list[int], motion: Motion) -> Setup:
    """The setup with some robots moving as given, of their own."""
    for k in robots:
        setup = _with(setup, k, replace(setup.nodes[k], motion=motion))
    return replace(
        setup,
        parallel=setup.parallel.difference(robots),
        in_line=setup.in_line.difference(robots),
    )


def _with(setup: Setup, k: int, node: SetupRobot) -> Setup:
    return replace(setup, nodes=(*setup.nodes[:k], node, *setup.nodes[k + 1 :]))


def _with_static(setup: Setup, *, known: bool) -> Setup:
    """The setup with one more static robot that ranges everyone."""
    count = len(setup.nodes)
    statics = sum(node.static for node in setup.nodes)
    node = SetupRobot(f"S{statics + 1} (new)", static=True, known=known)
    pairs = (*setup.pairs, *((k, count) for k in range(count)))
    return replace(setup, nodes=(*setup.nodes, node), pairs=pairs)
