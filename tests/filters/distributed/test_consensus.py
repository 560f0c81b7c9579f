"""Average consensus: Metropolis weights, groups, losses, what is counted."""

from __future__ import annotations

import numpy as np
import pytest

from clt.core.errors import UsageError
from clt.filters.distributed.consensus import (
    communication_links,
    connected_groups,
    make_network,
    metropolis_weights,
    traffic_by_robot,
)

NAMES = ("R1", "R2", "R3", "R10")
EVERYONE = np.arange(4)


def disagreement(values):
    return float(np.abs(values - values.mean(axis=0)).max())


@pytest.mark.parametrize("graph", ["complete", "line", "ring", "R1-R2, R2-R3,R10-R2"])
def test_metropolis_weights_keep_the_average(graph):
    U = metropolis_weights(communication_links(graph, NAMES))
    np.testing.assert_allclose(U.sum(axis=1), 1.0, atol=1e-15)
    np.testing.assert_array_equal(U, U.T)
    assert U.min() >= 0.0


def test_complete_graph_needs_one_iteration():
    np.testing.assert_allclose(
        metropolis_weights(communication_links("complete", NAMES)), 0.25, atol=1e-15
    )


def test_lines_follow_the_numbers_in_the_names():
    up = communication_links("line", ("R10", "R2", "R1"))
    np.testing.assert_array_equal(up, [[0, 1, 0], [1, 0, 1], [0, 1, 0]])
    assert communication_links("ring", NAMES).sum(axis=1).tolist() == [2, 2, 2, 2]


@pytest.mark.parametrize(
    ("graph", "said"), [("star", "star"), ("R1-R1", "R1-R1"), ("R1-R7", "no robot `R7`")]
)
def test_unknown_graphs_are_refused(graph, said):
    with pytest.raises(UsageError, match=said):
        communication_links(graph, NAMES)


def test_groups_hold_who_is_connected_and_present():
    up = communication_links("line", NAMES)
    parts = connected_groups(up, np.array([True, True, False, True]))
    assert [part.tolist() for part in parts] == [[0, 1], [3]]


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_robots_come_to_agree(loss):
    values = np.random.default_rng(0).normal(size=(4, 7))
    net, up = make_network(4, loss, 1), communication_links("line", NAMES)
    once = net.average(values, up, EVERYONE, 1)
    often = net.average(values, up, EVERYONE, 60)
    assert disagreement(often) < 1e-3 * disagreement(values) < disagreement(once)
    if loss == 0.0:
        np.testing.assert_allclose(often.mean(axis=0), values.mean(axis=0), atol=1e-12)


def test_messages_and_bytes_are_counted():
    net, up = make_network(4, 0.0, 1), communication_links("line", NAMES)
    net.average(np.zeros((4, 7)), up, EVERYONE, 3)
    counted = traffic_by_robot(net, NAMES)
    one = {"messages_sent": 3, "bytes_sent": 168, "messages_heard": 3, "bytes_heard": 168}
    assert counted["R1"] == one
    assert counted["R2"] == one | {"messages_heard": 6, "bytes_heard": 336}


@pytest.mark.parametrize(
    ("graph", "sent", "heard"),
    [("complete", [5, 0, 0, 0], [0, 5, 5, 5]), ("line", [5, 5, 5, 0], [5, 10, 5, 5])],
)
def test_floods_are_passed_on_only_where_needed(graph, sent, heard):
    net = make_network(4, 0.0, 1)
    net.flood(0, communication_links(graph, NAMES), EVERYONE, 40, messages=5)
    assert net.messages_sent.tolist() == sent
    assert net.messages_heard.tolist() == heard
    assert net.bytes_heard.tolist() == [40 * n for n in heard]


def test_what_must_arrive_is_repeated():
    net = make_network(2, 0.5, 1)
    net.flood(0, communication_links("complete", NAMES[:2]), np.arange(2), 40, messages=1000)
    assert 1800 < net.messages_sent[0] < 2200
    assert net.messages_heard[1] == 1000
