"""What the words of a topic's name say: which robots it is about, and what it holds."""

from __future__ import annotations

import re
from collections.abc import Collection


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


TRUTH = _set(
    "truth gt groundtruth mocap vicon optitrack vrpn qualisys natnet phasespace reference leica rtk"
)
"""Words of reference systems."""
RANGING = _set(
    "uwb range ranges ranging dist distance distances tof toa twr dwm dw1000 dwm1000 dwm1001 dw3000"
    " decawave pozyx linktrack nooploop"
)
OTHER_RANGE = _set(
    "ir cliff sonar ultrasonic ultrasound laser lidar scan bumper proximity height altitude"
)
"""Of sensors that measure a distance to no robot."""
COMMAND = _set("cmd command commands goal desired setpoint joy teleop target")
ESTIMATE = _set("amcl estimate estimated estimator ekf ukf slam initialpose initial filtered fused")
GENERIC = (
    TRUTH
    | RANGING
    | ESTIMATE
    | _set(
        "odom odometry wheel wheels encoder encoders pose poses twist velocity vel position"
        " transform raw data calibrated measurement measurements sensor sensors client motion"
        " capture ground ref diff drive differential controller base chassis mobile platform"
        " visual vio inertial stamped with covariance to from and between"
    )
)
"""Words that name no robot."""
WHOLE = _set("node world map robot robots tag tags anchor anchors")
"""Words that name no robot where nothing else stands between two slashes."""
PIECE = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
NUMBER = re.compile(r"([0-9]+)(?![0-9A-Za-z]*[0-9])")
BETWEEN = re.compile(r"_(?:to|from|and)_|__")
TWO = re.compile(r"([A-Za-z]+_?[0-9]+|[0-9]+)_?((?:[A-Za-z]+_?)?[0-9]+)")


def words(topic: str) -> frozenset[str]:
    """The words of a topic in lower case, by `/`, `_` and capitals, and each level as a whole."""
    levels = re.split(r"[/_]+", topic.lower())
    return frozenset(levels) | {piece.lower() for piece in PIECE.findall(topic)}


def labels(topic: str) -> list[str]:
    """What a topic's levels may call robots, as it stands there, generic words left out."""
    found = (_label(level) for level in topic.split("/"))
    return [label for label in found if label != ""]


def _label(level: str) -> str:
    parts = level.split("_")
    if level.lower() in WHOLE or all(part.lower() in GENERIC | WHOLE for part in parts):
        return ""
    first, last = 0, len(parts)
    while parts[first].lower() in GENERIC:
        first += 1
    while parts[last - 1].lower() in GENERIC:
        last -= 1
    return "_".join(parts[first:last])


def robot_of(topic: str, common: Collection[str] = ()) -> str | None:
    """The one robot that a topic is about; `common` are labels that all such topics share."""
    found = labels(topic)
    own = [label for label in found if label not in common]
    return own[0] if len(own) > 0 else found[0] if len(found) > 0 else None


def ends_of(topic: str, known: Collection[str]) -> tuple[str, str] | None:
    """The two robots of a topic of ranges, the measuring one first; `known` are sure labels."""
    found = labels(topic)
    if len(found) > 2:
        sure = [label for label in found if label in known]
        found = sure if len(sure) == 2 else found[-2:]
    if len(found) == 2:
        return (found[0], found[1]) if found[0] != found[1] else None
    return _halves(found[0], known) if len(found) == 1 else None


def _halves(label: str, known: Collection[str]) -> tuple[str, str] | None:
    """Two robots in one level: R1_to_R2, R1_R2, n_1_n_2, 1_2, or beside a known one."""
    parts = BETWEEN.split(label)
    if len(parts) == 2:
        return parts[0], parts[1]
    for one in sorted(known, key=len, reverse=True):
        if label.startswith(f"{one}_"):
            return one, label.removeprefix(f"{one}_")
        if label.endswith(f"_{one}"):
            return label.removesuffix(f"_{one}"), one
    match = TWO.fullmatch(label)
    return None if match is None else (match[1], match[2])


def number_of(label: str) -> int | None:
    """The last number in a label, if it has one."""
    match = NUMBER.search(label)
    return None if match is None else int(match[1][-9:])


def letters_of(label: str) -> str:
    """A label up to its last number, in lower case, without `_`."""
    match = NUMBER.search(label)
    return (label if match is None else label[: match.start()]).lower().replace("_", "")
