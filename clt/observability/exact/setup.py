"""What is asked about: the robots, which of them are placed, how they move, who ranges whom."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

from clt.observability.exact.codistribution import Motion, PairKind

MAX_LISTED_NAMES = 8


@dataclass(frozen=True)
class SetupRobot:
    """One robot of a setup."""

    name: str
    static: bool = False
    known: bool = False
    """A static robot whose position is known; it is not in the state."""
    motion: Motion = Motion.FREE
    """Of a moving robot."""


@dataclass(frozen=True)
class Setup:
    """A team, its motion and its ranges.

    The state holds (x, y, theta) of each moving robot and (x, y) of each static robot of unknown
    position, in the world; with an `ego`, of every other robot in the body frame of the ego.
    """

    nodes: tuple[SetupRobot, ...]
    pairs: tuple[tuple[int, int], ...]
    """Who ranges whom: indices of `nodes`, each pair once."""
    parallel: frozenset[int] = frozenset()
    """Robots that drive straight, with one heading and one common speed."""
    in_line: frozenset[int] = frozenset()
    """Robots on one line, the moving ones driving straight along it."""
    ego: int | None = None
    framed: bool = False
    """The world is what the first two static robots span: origin and x axis."""

    @cached_property
    def columns(self) -> tuple[tuple[str, str], ...]:
        """The state: (robot, `x`, `y` or `heading`) by column."""
        return tuple(
            (node.name, entry)
            for k, node in enumerate(self.nodes)
            if self.in_state(k)
            for entry in (("x", "y") if node.static else ("x", "y", "heading"))
        )

    def in_state(self, k: int) -> bool:
        """Whether a robot's pose is unknown."""
        return k != self.ego and not self.nodes[k].known

    @cached_property
    def first_column(self) -> tuple[int, ...]:
        """Column where each robot's numbers begin, -1 for a robot outside the state."""
        firsts, column = [], 0
        for k, node in enumerate(self.nodes):
            firsts.append(column if self.in_state(k) else -1)
            column += (2 if node.static else 3) if self.in_state(k) else 0
        return tuple(firsts)

    @property
    def frame_robots(self) -> tuple[int, ...]:
        """The static robots that span the world when it is made from ranges (Shi)."""
        return tuple(k for k, node in enumerate(self.nodes) if node.static)[:2]

    def motion(self, k: int) -> Motion:
        """How a robot moves once everything that is said of it is taken together."""
        node = self.nodes[k]
        if node.static or node.motion is Motion.REST:
            return Motion.REST
        kept = node.motion is not Motion.FREE or k not in self.parallel | self.in_line
        return node.motion if kept else Motion.STRAIGHT

    def ordered(self, pair: tuple[int, int]) -> tuple[int, int]:
        """A pair with the ego as its first end."""
        return (pair[1], pair[0]) if pair[1] == self.ego else pair

    def kind(self, pair: tuple[int, int]) -> PairKind:
        """What decides the functions of a pair."""
        a, b = self.ordered(pair)
        a_moves, b_moves = self.motion(a), self.motion(b)
        tied = {a, b} <= self.parallel and Motion.REST not in {a_moves, b_moves}
        return PairKind(a_moves, b_moves, tied, self.ego is not None and a == self.ego)

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Robots of unknown pose that are tied together by ranges among themselves."""
        home = {k: {k} for k in range(len(self.nodes)) if k == self.ego or self.in_state(k)}
        for a, b in self.pairs:
            if a in home and b in home and home[a] is not home[b]:
                home[a] |= home[b]
                for k in home[b]:
                    home[k] = home[a]
        distinct = {id(group): tuple(sorted(group)) for group in home.values()}
        return tuple(sorted(distinct.values()))


def every_pair(count: int) -> tuple[tuple[int, int], ...]:
    """All pairs of `count` robots."""
    return tuple(combinations(range(count), 2))


def setup_robots(moving: int, static: int, known: int = 0) -> tuple[SetupRobot, ...]:
    """R1 .. Rn moving, S1 .. Sm static, the first `known` of them of known position."""
    return (
        *(SetupRobot(f"R{k + 1}") for k in range(moving)),
        *(SetupRobot(f"S{k + 1}", static=True, known=k < known) for k in range(static)),
    )


def setup_indices(nodes: tuple[SetupRobot, ...], names: Iterable[str]) -> frozenset[int]:
    """Indices of robots by name. Raises KeyError for a stranger."""
    places = {node.name: k for k, node in enumerate(nodes)}
    return frozenset(places[name] for name in names)


def list_names(names: Sequence[str]) -> str:
    """Names for people: `R1, R2 and R3`, a long list with its middle left out."""
    if len(names) > MAX_LISTED_NAMES:
        return f"{', '.join(names[: MAX_LISTED_NAMES - 2])} ... {names[-1]}"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
