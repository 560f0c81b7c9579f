"""Which fields of a topic's messages the conversion to streams will ask for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from clt.log.cdr.msgdef import Struct
from clt.log.cdr.paths import PathError, resolve_path
from clt.log.recording import convert, packets, ranging
from clt.log.recording.roles import RangeTopic, StreamTopic, TopicRoles


def needed_fields(
    roles: TopicRoles, topic: str, struct: Struct, brief: bool
) -> tuple[str, ...] | None:
    """The paths of every role of a topic of type `struct`, each once.

    None where there are none or not all exist: the conversion says what is wrong.
    """
    found = [
        path
        for one, paths in _readers(roles, struct, brief)
        if one.topic == topic
        for path in (*convert.clock_paths(struct, one.log_time), *paths)
    ]
    if roles.innovation == topic:
        found += [*convert.clock_paths(struct, False), *ranging.INNOVATION_FIELDS]
    try:
        for path in found:
            resolve_path(struct, path)
    except PathError:
        return None
    return tuple(dict.fromkeys(found)) if len(found) > 0 else None


def _readers(
    roles: TopicRoles, struct: Struct, brief: bool
) -> Iterator[tuple[StreamTopic | RangeTopic, Sequence[str]]]:
    """Every stream of the roles, with what its conversion would read of a type besides the time."""
    for one in roles.odometry.values():
        yield one, convert.twist_paths(struct, brief)
    for one in roles.truth.values():
        yield one, convert.pose_paths(struct, False)
    for one in (*roles.estimate.values(), *roles.dead_reckoning.values()):
        yield one, convert.pose_paths(struct, True)
    for _, stream in roles.ranges:
        yield stream, ranging.range_paths(struct, stream, brief)
    for one in roles.frames.values():
        yield one, packets.UWB_FRAME_FIELDS
