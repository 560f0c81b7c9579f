"""Field paths, `pose.pose.position.x` or `nodes[0].dis`, and what they name in a definition."""

from __future__ import annotations

import re
from dataclasses import dataclass

from clt.core.printable import printable_name as shown
from clt.log.cdr.msgdef import Field, Struct

PATH_STEP_PATTERN = re.compile(r"(?P<name>[A-Za-z]\w*)(?:\[(?P<index>[0-9]{1,9})\])?")
MAX_COLUMN_ELEMENTS = 4096
"""Elements of an array that one column holds per message."""


class PathError(ValueError):
    """A path names nothing that a column can hold; the text says why."""


@dataclass(frozen=True)
class LeafType:
    """A primitive that a path names."""

    kind: str
    """numpy format, or `text`."""
    size: int | None = None
    """Elements of a whole array; None for a single value."""


def resolve_path(struct: Struct, path: str) -> LeafType:
    """What `path` names. Raises PathError for a stranger, a nested type or a whole sequence."""
    here: Struct | str = struct
    leaf = LeafType("")
    for step in path.split("."):
        match = PATH_STEP_PATTERN.fullmatch(step)
        if match is None or not isinstance(here, Struct):
            raise PathError(f"`{path}` is no field of {shown(struct.name)}")
        field = next((field for field in here.fields if field.name == match["name"]), None)
        if field is None:
            raise PathError(
                f"{shown(here.name)} has no field `{match['name']}`; it has: {_field_names(here)}"
            )
        leaf = LeafType("", _size(field, match["index"], path))
        here = field.kind
    if isinstance(here, Struct):
        kind = shown(here.name)
        raise PathError(f"`{path}` is a {kind}, not a number; name one of: {_field_names(here)}")
    if here == "wide" or (here == "text" and leaf.size is not None):
        raise PathError(f"`{path}` is not a number or a plain string")
    return LeafType(here, leaf.size)


def _field_names(struct: Struct) -> str:
    """The fields of a type in one line."""
    return shown(", ".join(field.name for field in struct.fields), 400)


def _size(field: Field, index: str | None, path: str) -> int | None:
    """Elements that one step of a path names."""
    if field.many == "one":
        if index is not None:
            raise PathError(f"`{path}`: `{field.name}` is a single value")
        return None
    if index is not None:
        if field.many == "array" and int(index) >= field.size:
            raise PathError(f"`{path}`: `{field.name}` has only {field.size} elements")
        return None
    if field.many == "sequence" or isinstance(field.kind, Struct):
        raise PathError(f"`{path}`: name one element: `{field.name}[0]`")
    if field.size > MAX_COLUMN_ELEMENTS:
        raise PathError(f"`{path}` has {field.size} elements; name one: `{field.name}[0]`")
    return field.size
