"""How devices call their nodes, and what a robot is called that no map names."""

from __future__ import annotations

import re
from typing import Literal

IdForm = Literal["decimal", "letter", "hex4", "hex", "name", "robot"]
"""Ids of a format: `12`; `t0`, `a3`; `022E`; `0x0001`; its own names; the robot of `node=` only."""

ID_PATTERNS: dict[IdForm, str] = {
    "decimal": r"\d{1,5}",
    "letter": r"[at]\d{1,5}",
    "hex4": r"[0-9A-F]{4}",
    "hex": r"0x[0-9a-f]{4}",
    "name": r".{1,64}",
    "robot": r"[A-Za-z][A-Za-z0-9_]*",
}
ROBOT_NAME = re.compile(ID_PATTERNS["robot"])


def is_robot_name(text: str) -> bool:
    """Whether a robot may be called so."""
    return ROBOT_NAME.fullmatch(text) is not None


def is_id(form: IdForm, text: str) -> bool:
    """Whether a map of a format with such ids may hold this one."""
    return re.fullmatch(ID_PATTERNS[form], text) is not None


def name_without_map(form: IdForm, device_id: str) -> str | None:
    """What a robot is called where no map is given: `n` and the id, or an id that is a name.

    None for an id that gives no name (a format with its own names, `robot-1`).
    """
    name = device_id if form in {"letter", "name", "robot"} else f"n{device_id}"
    if form == "name" and not is_robot_name(name):
        name = f"n{device_id}"
    return name if is_robot_name(name) else None
