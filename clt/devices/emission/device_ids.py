"""By which ids of a device the robots of a log go."""

from __future__ import annotations

from collections import Counter

from clt.core.recording import Ranges, Team
from clt.devices.decoders.names import IdForm
from clt.devices.encoders.table import EncoderSpec

DeviceIds = dict[int, str]
"""From a robot's index in the team to its id; robots beyond the device's limits are missing."""


def device_ids(form: IdForm, spec: EncoderSpec, team: Team, ranges: Ranges) -> DeviceIds:
    """Ids of all robots, as far as they go."""
    if form == "decimal":
        return _numbers(team, spec.max_id)
    if form == "letter":
        return _tags_and_anchors(team, ranges, spec)
    if form == "hex4":
        return {index: f"{robot.id:04X}" for index, robot in enumerate(team.robots)}
    if form == "hex":
        return {index: f"0x{robot.id:04x}" for index, robot in enumerate(team.robots)}
    return dict(enumerate(team.names))


def _numbers(team: Team, most: int) -> DeviceIds:
    """A robot's own id where the device can have it, else the smallest that is free."""
    found = {index: robot.id for index, robot in enumerate(team.robots) if robot.id <= most}
    for index in range(len(team.robots)):
        free = sorted(set(range(most + 1)) - set(found.values()))
        if index not in found and len(free) > 0:
            found[index] = free[0]
    return {index: str(found[index]) for index in sorted(found)}


def _tags_and_anchors(team: Team, ranges: Ranges, spec: EncoderSpec) -> DeviceIds:
    """Robots that stand still are anchors, the others tags.

    Where none stands still, the one that measured most is a tag and the others are anchors, as
    far as the device has them: that carries most pairs.
    """
    indices = range(len(team.robots))
    anchors = [index for index in indices if team.robots[index].static]
    tags = [index for index in indices if not team.robots[index].static]
    if len(anchors) == 0 and len(tags) > 1:
        measured = Counter(ranges.source.tolist())
        first = max(tags, key=lambda index: (measured[index], -index))
        others = [index for index in tags if index != first]
        anchors, tags = others[: spec.max_anchors], [first, *others[spec.max_anchors :]]
    found = {index: f"a{number}" for number, index in enumerate(anchors[: spec.max_anchors])}
    return found | {index: f"t{number}" for number, index in enumerate(tags[: spec.max_tags])}
