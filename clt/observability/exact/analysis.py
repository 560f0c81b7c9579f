"""All that can be said of a setup before any data: rank, open directions, images, remedies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from clt.observability.exact.ambiguity import find_ambiguities
from clt.observability.exact.codistribution import Motion, lie_derivatives
from clt.observability.exact.directions import Direction, name_directions
from clt.observability.exact.rank import null_space
from clt.observability.exact.remedies import OpenQuestions, Remedy, find_remedies
from clt.observability.exact.setup import Setup
from clt.observability.exact.states import ExactPose, random_state

RANDOM_STATES = 2
"""Random states tried; the rank is the largest found."""


@dataclass(frozen=True)
class Analysis:
    """Observability of a setup."""

    setup: Setup
    dimension: int
    rank: int
    order: int
    """Highest order of a Lie derivative that gave a new function."""
    unobservable: tuple[Direction, ...]
    ambiguities: tuple[str, ...]
    """Mirror images that no range can exclude."""
    remedies: tuple[Remedy, ...]
    state: tuple[ExactPose, ...]
    """The random state at which the directions are named."""

    @property
    def nullity(self) -> int:
        """Dimension of what is not observable."""
        return self.dimension - self.rank

    @property
    def observable(self) -> bool:
        """Whether everything is."""
        return self.nullity == 0

    @property
    def solutions(self) -> int | None:
        """How many states, images among them, give the same ranges; None for a continuum."""
        return 2 ** len(self.ambiguities) if self.observable else None

    def as_dict(self) -> dict[str, object]:
        """What `clt observability --json` prints."""
        nodes = self.setup.nodes
        return {
            "dimension": self.dimension,
            "rank": self.rank,
            "nullity": self.nullity,
            "observable": self.observable,
            "unobservable": [direction.name for direction in self.unobservable],
            "second_order": [one.name for one in self.unobservable if not one.hidden],
            "vectors": [dict(direction.components) for direction in self.unobservable],
            "ambiguities": list(self.ambiguities),
            "solutions": self.solutions,
            "remedies": [
                {"add": remedy.text, "nullity": remedy.nullity} for remedy in self.remedies
            ],
            "order": self.order,
            "frame": "world" if self.setup.ego is None else f"ego:{nodes[self.setup.ego].name}",
            "state": {
                node.name: _pose(place, self.setup.motion(k), static=node.static)
                for k, (node, place) in enumerate(zip(nodes, self.state, strict=True))
            },
        }


def _pose(place: ExactPose, motion: Motion, *, static: bool) -> Mapping[str, float]:
    position = {"x": float(place.x), "y": float(place.y)}
    speed = {"speed": float(place.v)} if motion is Motion.STEADY else {}
    return position if static else position | {"heading": place.heading} | speed


def analyse(setup: Setup) -> Analysis:
    """Rank and all else of a setup at random states that meet its conditions."""
    best = random_state(setup, 0)
    space = null_space(setup, best)
    for seed in range(1, RANDOM_STATES if space.shape[1] > 0 else 1):
        state = random_state(setup, seed)
        other = null_space(setup, state)
        if other.shape[1] < space.shape[1]:
            best, space = state, other
    dimension = len(setup.columns)
    return Analysis(
        setup,
        dimension,
        dimension - space.shape[1],
        max((lie_derivatives(setup.kind(pair))[-1].order for pair in setup.pairs), default=0),
        name_directions(setup, best, space),
        find_ambiguities(setup, best),
        find_remedies(setup, left_open),
        best,
    )


def left_open(setup: Setup) -> OpenQuestions:
    """What is left open: nullity, and mirror images."""
    state = random_state(setup, 0)
    nullity = null_space(setup, state).shape[1]
    return nullity, len(find_ambiguities(setup, state)) if nullity == 0 else 0
