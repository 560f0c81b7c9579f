"""Average consensus among the robots that hear each other, and what it costs to send.

xi_i <- U_ii xi_i + sum over neighbours j of U_ij xi_j (Li 2020, eq. (26), whose second xi must be
the neighbour's) with the Metropolis weights of Xiao, Boyd and Lall (2005). What a robot sends is
heard by all its neighbours at once, as on a radio.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clt.core.arrays import Bools, Floats, Indices
from clt.core.errors import UsageError
from clt.core.settings import did_you_mean


def communication_links(graph: str, names: Sequence[str], key: str = "dpf.graph") -> Bools:
    """Who may hear whom, shape (M, M), symmetric.

    `complete`; `line` and `ring` in the order of the names, R2 before R10; or links as in
    `R1-R2,R2-R3`. Raises UsageError, naming the key, for robots that are not there.
    """
    M = len(names)
    if graph == "complete":
        return ~np.eye(M, dtype=np.bool_)
    up = np.zeros((M, M), np.bool_)
    if graph in {"line", "ring"}:
        order = sorted(range(M), key=lambda i: (len(names[i]), names[i]))
        up[order[:-1], order[1:]] = True
        up[order[-1], order[0]] |= graph == "ring" and M > 1
    else:
        for link in graph.split(","):
            a, b = link_robots(link, names, key)
            up[a, b] = True
    return up | up.T


def link_robots(link: str, names: Sequence[str], key: str) -> tuple[int, int]:
    """Indices of the two robots of a link `A-B`. Raises UsageError where it is none."""
    parts = tuple(part.strip() for part in link.split("-"))
    if len(parts) != 2 or parts[0] == parts[1]:
        raise UsageError(f"{key}: `{link}` is not complete, line, ring or links as A-B,B-C")
    for name in parts:
        if name not in names:
            raise UsageError(f"{key}: no robot `{name}` in the team{did_you_mean(name, names)}")
    return names.index(parts[0]), names.index(parts[1])


def metropolis_weights(up: Bools) -> Floats:
    """U_ij = 1 / (1 + max(d_i, d_j)) on links, the rest to oneself: rows sum to one, U = U^T."""
    degree = up.sum(axis=1)
    U: Floats = up / (1.0 + np.maximum(degree[:, None], degree))
    return U + np.diag(1.0 - U.sum(axis=1))


def connected_groups(up: Bools, present: Bools) -> list[Indices]:
    """The sets of present robots that are connected, each sorted, by their first robot."""
    left, found = [int(i) for i in np.flatnonzero(present)], []
    while len(left) > 0:
        reached, edge = {left[0]}, {left[0]}
        while len(edge) > 0:
            edge = {j for j in left if j not in reached and up[j, list(edge)].any()}
            reached |= edge
        found.append(np.array(sorted(reached)))
        left = [i for i in left if i not in reached]
    return found


@dataclass(frozen=True)
class LossyNetwork:
    """A lossy network and what each of its M robots sent and heard so far."""

    loss: float
    """Probability that a message does not reach one neighbour."""
    draw: np.random.Generator
    messages_sent: Indices
    """(M,), as the following."""
    bytes_sent: Indices
    messages_heard: Indices
    bytes_heard: Indices

    def average(self, values: Floats, up: Bools, group: Indices, iterations: int) -> Floats:
        """Values (G, K) of a group after some iterations; a robot counts as its own what is lost.

        Each iteration every robot sends its K numbers once.
        """
        heard = up[np.ix_(group, group)]
        U = metropolis_weights(heard)
        for _ in range(iterations if group.size > 1 else 0):
            arrived = heard & (self.draw.random(heard.shape) >= self.loss)
            W = np.where(arrived, U, 0.0)
            values = (W + np.diag(1.0 - W.sum(axis=1))) @ values
            self.count(
                group, np.ones(group.size, np.int64), arrived.sum(axis=1), values.shape[1] * 8
            )
        return values

    def flood(self, origin: int, up: Bools, group: Indices, size: int, messages: int = 1) -> None:
        """Count messages of `size` bytes that all of a group get, repeated until they did.

        Those who hear the origin get them from it. Where that is not all, every robot with another
        neighbour passes them on once.
        """
        if group.size == 1:
            return
        heard = up[np.ix_(group, group)]
        first = group == origin
        direct = bool((heard[first][0] | first).all())
        senders = first if direct else first | (heard.sum(axis=1) > 1)
        sent = np.zeros(group.size, np.int64)
        for i in np.flatnonzero(senders):
            sent[i] = self.copies(messages, int(heard[i].sum()))
        self.count(group, sent, messages * heard[:, senders].sum(axis=1), size)

    def hand_over(self, sender: int, receiver: int, size: int) -> None:
        """Count one message of `size` bytes between two neighbours."""
        pair, copies = np.array([sender, receiver]), self.copies(1, 1)
        self.count(pair, np.array([copies, 0]), np.array([0, 1]), size)

    def copies(self, messages: int, neighbours: int) -> int:
        """How often in all some messages are sent until every neighbour has each."""
        if self.loss == 0.0 or neighbours == 0:
            return messages
        tries = self.draw.geometric(1.0 - self.loss, (messages, neighbours))
        return int(tries.max(axis=1).sum())

    def count(self, group: Indices, sent: Indices, heard: Indices, size: int) -> None:
        """Add messages of `size` bytes to what the robots of a group sent and heard."""
        self.messages_sent[group] += sent
        self.bytes_sent[group] += sent * size
        self.messages_heard[group] += heard
        self.bytes_heard[group] += heard * size


def make_network(robots: int, loss: float, seed: int) -> LossyNetwork:
    """A network over which nothing went yet."""
    counts = (np.zeros(robots, np.int64) for _ in range(4))
    return LossyNetwork(loss, np.random.default_rng([seed, 1]), *counts)


def traffic_by_robot(net: LossyNetwork, names: Sequence[str]) -> Mapping[str, Mapping[str, int]]:
    """Messages and bytes sent and heard by each robot."""
    columns = ("messages_sent", "bytes_sent", "messages_heard", "bytes_heard")
    return {
        name: {column: int(getattr(net, column)[i]) for column in columns}
        for i, name in enumerate(names)
    }
