"""What the words of a topic's name say: which robots it is about, and what it holds."""

from __future__ import annotations

import re
from collections.abc import Collection


def _set(text: str) -> frozenset[str]:
    return frozenset(text.split())


TRUTH_WORDS = _set(
    "truth gt groundtruth mocap vicon optitrack vrpn qualisys natnet phasespace reference leica rtk"
)
"""Words of reference systems."""
RANGING_WORDS = _set(
    "uwb range ranges ranging dist distance distances tof toa twr dwm dw1000 dwm1000 dwm1001 dw3000"
    " decawave pozyx linktrack nooploop"
)
OTHER_RANGE_WORDS = _set(
    "ir cliff sonar ultrasonic ultrasound laser lidar scan bumper proximity height altitude"
)
"""Of sensors that measure a distance to no robot."""
COMMAND_WORDS = _set("cmd command commands goal desired setpoint joy teleop target")
ESTIMATE_WORDS = _set(
    "amcl estimate estimated estimator ekf ukf slam initialpose initial filtered fused"
)
GENERIC_WORDS = (
    TRUTH_WORDS
    | RANGING_WORDS
    | ESTIMATE_WORDS
    | _set(
        "odom odometry wheel wheels encoder encoders pose poses twist velocity vel position"
        " transform raw data calibrated measurement measurements sensor sensors client motion"
        " capture ground ref diff drive differential controller base chassis mobile platform"
        " visual vio inertial stamped with covariance to from and between"
    )
)
"""Words that name no robot."""
GENERIC_LEVELS = _set("node world map robot robots tag tags anchor anchors")
"""Words that name no robot where nothing else stands between two slashes."""
WORD_PATTERN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+")
LAST_NUMBER_PATTERN = re.compile(r"([0-9]+)(?![0-9A-Za-z]*[0-9])")
ENDS_SEPARATOR_PATTERN = re.compile(r"_(?:to|from|and)_|__")
TWO_LABELS_PATTERN = re.compile(r"([A-Za-z]+_?[0-9]+|[0-9]+)_?((?:[A-Za-z]+_?)?[0-9]+)")


def topic_words(topic: str) -> frozenset[str]:
    """The words of a topic in lower case, by `/`, `_` and capitals, and each level as a whole."""
    levels = re.split(r"[/_]+", topic.lower())
    return frozenset(levels) | {piece.lower() for piece in WORD_PATTERN.findall(topic)}


def robot_labels(topic: str) -> list[str]:
    """What a topic's levels may call robots, as it stands there, generic words left out."""
    found = (_label(level) for level in topic.split("/"))
    return [label for label in found if label != ""]


def _label(level: str) -> str:
    parts = level.split("_")
    if level.lower() in GENERIC_LEVELS or all(
        part.lower() in GENERIC_WORDS | GENERIC_LEVELS for part in parts
    ):
        return ""
    first, last = 0, len(parts)
    while parts[first].lower() in GENERIC_WORDS:
        first += 1
    while parts[last - 1].lower() in GENERIC_WORDS:
        last -= 1
    return "_".join(parts[first:last])


def robot_label(topic: str, common: Collection[str] = ()) -> str | None:
    """The one robot that a topic is about; `common` are labels that all such topics share."""
    found = robot_labels(topic)
    own = [label for label in found if label not in common]
    return own[0] if len(own) > 0 else found[0] if len(found) > 0 else None


def range_end_labels(topic: str, known: Collection[str]) -> tuple[str, str] | None:
    """The two robots of a topic of ranges, the measuring one first; `known` are sure labels."""
    found = robot_labels(topic)
    if len(found) > 2:
        sure = [label for label in found if label in known]
        found = sure if len(sure) == 2 else found[-2:]
    if len(found) == 2:
        return (found[0], found[1]) if found[0] != found[1] else None
    return _split_label(found[0], known) if len(found) == 1 else None


def _split_label(label: str, known: Collection[str]) -> tuple[str, str] | None:
    """Two robots in one level: R1_to_R2, R1_R2, n_1_n_2, 1_2, or beside a known one."""
    parts = ENDS_SEPARATOR_PATTERN.split(label)
    if len(parts) == 2:
        return parts[0], parts[1]
    for one in sorted(known, key=len, reverse=True):
        if label.startswith(f"{one}_"):
            return one, label.removeprefix(f"{one}_")
        if label.endswith(f"_{one}"):
            return label.removesuffix(f"_{one}"), one
    match = TWO_LABELS_PATTERN.fullmatch(label)
    return None if match is None else (match[1], match[2])


def label_number(label: str) -> int | None:
    """The last number in a label, if it has one."""
    match = LAST_NUMBER_PATTERN.search(label)
    return None if match is None else int(match[1][-9:])


def label_letters(label: str) -> str:
    """A label up to its last number, in lower case, without `_`."""
    match = LAST_NUMBER_PATTERN.search(label)
    return (label if match is None else label[: match.start()]).lower().replace("_", "")
