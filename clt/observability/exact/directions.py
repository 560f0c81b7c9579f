"""Unobservable directions in plain words: named candidates that lie in the null space exactly.

A candidate is an infinitesimal change of the state at hand: a translation or rotation of robots
tied together by ranges, one robot's heading, a step along or across its path, an orbit around
another one. Those that the null space holds are named, the general ones first.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain

import numpy as np

from clt.observability.exact.curvature import is_special, second_order_test
from clt.observability.exact.matrix import observability_matrix
from clt.observability.exact.rank import PRIME, Residues, column_echelon, residue
from clt.observability.exact.setup import Setup, list_names
from clt.observability.exact.states import ExactPose

StateChange = dict[int, Fraction]
"""Column of the state -> its change."""
MIN_LISTED_COMPONENT = 0.3
"""Components of an unnamed direction are named from this share of its largest one."""


@dataclass(frozen=True)
class Direction:
    """A change of the state that no range notices."""

    name: str
    components: Mapping[str, float]
    """`R1.x`, `R1.heading` ... -> change, in m and rad."""
    hidden: bool
    """No range depends on it; False where ranges do to second order."""


def name_directions(
    setup: Setup, state: Sequence[ExactPose], space: Residues
) -> tuple[Direction, ...]:
    """Name a basis of a null space (dimension, k) at a state, what stays hidden first.

    At a special state motions of whole groups come first where they are hidden: they may combine
    what each by itself is determined to second order.
    """
    reduced, pivots = column_echelon(space)
    stays = second_order_test(setup, state)
    found: list[Direction] = []
    # Dual coordinates: what vanishes on all directions found so far.
    left, free = np.eye(space.shape[1], dtype=np.int64), np.arange(space.shape[1])
    preferred = rigid_body_changes(setup, state) if is_special(setup) else iter(())
    choices = chain(
        ((*one, True) for one in preferred),
        ((*one, False) for one in candidate_changes(setup, state)),
    )
    for name, change, only_hidden in choices:
        if left.shape[1] == 0:
            break
        vector = as_residues(change, len(setup.columns))
        at_pivots = vector[pivots]
        if not np.array_equal(_combined(reduced, at_pivots), vector):
            continue
        seen = _combined(at_pivots[None, :], left)[0]
        if not np.any(seen):
            continue
        mark = stays(vector)
        if mark or not only_hidden:
            found.append(Direction(name, _components(setup, change), mark))
            j = int(np.flatnonzero(seen)[0])
            left, free = _without(left, seen, j), np.delete(free, j)
    found += [_unnamed(setup, state, reduced, int(k), stays(reduced[:, k])) for k in free]
    return tuple(sorted(found, key=lambda one: not one.hidden))


def _combined(matrix: Residues, factors: Residues) -> Residues:
    """Multiply modulo PRIME: (m, k) with (k,) or (k, n)."""
    if factors.ndim == 1:
        return np.asarray(np.sum(matrix * factors % PRIME, axis=1) % PRIME)
    return np.asarray(np.sum(matrix[:, :, None] * factors[None] % PRIME, axis=1) % PRIME)


def _without(left: Residues, seen: Residues, j: int) -> Residues:
    """Of the dual coordinates `left` (k, l) those that vanish on one more direction."""
    share = seen * pow(int(seen[j]), -1, PRIME) % PRIME
    share[j] = 0
    return np.delete((left - left[:, [j]] * share) % PRIME, j, axis=1)


def as_residues(change: StateChange, size: int) -> Residues:
    """A change as a full vector modulo PRIME."""
    vector = np.zeros(size, np.int64)
    for column, value in change.items():
        vector[column] = residue(value)
    return vector


def _components(setup: Setup, change: StateChange) -> dict[str, float]:
    return {
        ".".join(setup.columns[column]): float(value)
        for column, value in sorted(change.items())
        if value != 0
    }


def _unnamed(
    setup: Setup, state: Sequence[ExactPose], reduced: Residues, k: int, mark: bool
) -> Direction:
    """A direction that no candidate explains, named by its largest components.

    Its support is exact, its numbers are those of the matrix in floating point.
    """
    columns = np.flatnonzero(reduced[:, k])
    vector = np.linalg.svd(observability_matrix(setup, state)[:, columns])[2][-1]
    vector = vector / vector[np.argmax(np.abs(vector))]
    parts = {
        ".".join(setup.columns[column]): float(value)
        for column, value in zip(columns, vector, strict=True)
    }
    large = [name for name in parts if abs(parts[name]) >= MIN_LISTED_COMPONENT]
    return Direction("joint change of " + list_names(large), parts, mark)


def candidate_changes(
    setup: Setup, state: Sequence[ExactPose]
) -> Iterator[tuple[str, StateChange]]:
    """Names and changes, the general ones first."""
    yield from rigid_body_changes(setup, state)
    unknown = tuple(k for k in range(len(setup.nodes)) if setup.in_state(k))
    for k in unknown:
        yield from _single(setup, state, k)
    for k in unknown:
        for centre in range(len(setup.nodes)):
            if centre != k:
                yield from _orbit(setup, state, k, centre)
    groups = setup.groups()
    for group in groups:
        turning = [k for k in group if setup.in_state(k) and not setup.nodes[k].static]
        names = (
            "the whole team"
            if len(groups) == 1
            else list_names([setup.nodes[k].name for k in turning])
        )
        yield (
            f"common heading of {names}",
            {setup.first_column[k] + 2: Fraction(1) for k in turning},
        )


def rigid_body_changes(
    setup: Setup, state: Sequence[ExactPose]
) -> Iterator[tuple[str, StateChange]]:
    """Changes of groups tied together by ranges."""
    groups = setup.groups()
    for group in groups:
        yield from _rigid(setup, state, group, whole=len(groups) == 1)


def _rigid(
    setup: Setup, state: Sequence[ExactPose], group: Sequence[int], *, whole: bool
) -> Iterator[tuple[str, StateChange]]:
    """Translations and rotations of a group as one body."""
    members = [k for k in group if setup.in_state(k)]
    names = list_names([setup.nodes[k].name for k in members])
    scope = "" if whole else f" of {names}"
    body = "the whole team" if whole else names
    if len(members) == 1 and setup.ego is not None:
        yield from _single(setup, state, members[0])
    if setup.ego is not None:
        ego = setup.nodes[setup.ego].name
        yield (
            f"rotation of all others around {ego}",
            rotation_change(setup, state, members, setup.ego),
        )
        if len(members) > 1:
            circling = rotation_change(setup, state, members, setup.ego, turning=False)
            yield f"bearing of all others from {ego}", circling
        return
    for entry, axis in enumerate("xy"):
        change = {setup.first_column[k] + entry: Fraction(1) for k in members}
        yield f"translation in {axis}{scope}", change
    if len(members) == 1:
        yield from _single(setup, state, members[0])
    yield f"rotation of {body} about the origin", rotation_change(setup, state, members, None)
    for centre, node in enumerate(setup.nodes):
        if node.static:
            name = f"rotation{scope} about static robot {node.name}"
            yield name, rotation_change(setup, state, members, centre)


def rotation_change(
    setup: Setup,
    state: Sequence[ExactPose],
    members: Sequence[int],
    centre: int | None,
    *,
    turning: bool = True,
) -> StateChange:
    """Rotation of robots about another one or the origin by 1 rad; as one body if `turning`."""
    change: StateChange = {}
    for k in members:
        change |= _turned(setup, state, k, centre)
        if turning and not setup.nodes[k].static:
            change[setup.first_column[k] + 2] = Fraction(1)
    return change


def _turned(setup: Setup, state: Sequence[ExactPose], k: int, centre: int | None) -> StateChange:
    """One robot's position on its circle around another one or the origin, by 1 rad."""
    zero = Fraction(0)
    x, y = (zero, zero) if centre is None else (state[centre].x, state[centre].y)
    first = setup.first_column[k]
    return {first: y - state[k].y, first + 1: state[k].x - x}


def _single(setup: Setup, state: Sequence[ExactPose], k: int) -> Iterator[tuple[str, StateChange]]:
    """One robot's own numbers."""
    first, name = setup.first_column[k], setup.nodes[k].name
    if not setup.nodes[k].static:
        yield f"heading of {name}", {first + 2: Fraction(1)}
    for entry, axis in enumerate("xy"):
        yield f"position of {name} in {axis}", {first + entry: Fraction(1)}
    place = state[k]
    across = "its line" if setup.nodes[k].static else "its path"
    yield f"position of {name} along {across}", {first: place.c, first + 1: place.s}
    yield f"position of {name} across {across}", {first: -place.s, first + 1: place.c}


def _orbit(
    setup: Setup, state: Sequence[ExactPose], k: int, centre: int
) -> Iterator[tuple[str, StateChange]]:
    """One robot around another, its heading turning with it or not."""
    name, other = setup.nodes[k].name, setup.nodes[centre].name
    if not setup.nodes[k].static:
        yield f"rotation of {name} about {other}", rotation_change(setup, state, [k], centre)
    yield f"bearing of {name} from {other}", _turned(setup, state, k, centre)
