"""Every key of a settings type with its type, unit, default and one line, from the source."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from dataclasses import dataclass, replace
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

UNIT_PATTERN = re.compile(
    r"(?:, |\bin |^)((?:m/s|rad/s|rad|m|s|Hz)(?: per (?:m/s|rad/s|m|s))?)(?=[.;:,)]| and | of |$)"
)
"""How a docstring says a unit: `..., m/s.`, or `x, y in m and heading in rad`."""
TYPE_NAMES: dict[type, str] = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "true or false",
}
BOUND_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


@dataclass(frozen=True)
class SettingKey:
    """One key of `--set`."""

    name: str
    """Dotted."""
    type: str
    """With the bounds of its values."""
    unit: str
    """`-` for what has none."""
    default: Any
    """None where it is taken from elsewhere, as `about` says, or has to be given."""
    about: str
    """One line."""


def setting_keys(model: type[BaseModel], prefix: str = "") -> list[SettingKey]:
    """All keys of a settings type in the order of its source; those of lists have no names."""
    lines = _docstrings(model)
    found: dict[str, SettingKey] = {}
    for name, info in model.model_fields.items():
        tables = [] if get_origin(info.annotation) in {list, tuple} else _tables(info.annotation)
        for table in tables:
            for key in setting_keys(table, f"{prefix}{name}."):
                known = found.setdefault(key.name, key)
                if known.type != key.type:  # the `kind` of tables among which one is chosen
                    found[key.name] = replace(known, type=f"{known.type}, {key.type}")
        if len(tables) == 0:
            about = lines.get(name, "")
            units = dict.fromkeys(UNIT_PATTERN.findall(about))
            found[prefix + name] = SettingKey(
                prefix + name,
                _type(info),
                ", ".join(units) or "-",
                _json_value(info.get_default(call_default_factory=True)),
                about,
            )
    return list(found.values())


def _json_value(value: Any) -> Any:
    """A default as JSON can hold it."""
    if isinstance(value, tuple):
        return [_json_value(item) for item in value]
    return value if isinstance(value, str | int | float | bool) else None


def _docstrings(model: type[BaseModel]) -> dict[str, str]:
    """The text below each attribute of a class, in one line."""
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(model))).body
    found = {}
    previous: ast.stmt | None = None
    for node in getattr(tree, "body", []):
        match previous, node:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=text)):
                found[name] = " ".join(str(text).split())
        previous = node
    return found


def _tables(annotation: Any) -> list[type[BaseModel]]:
    """The settings types of which a value may be one."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [table for part in get_args(annotation) for table in _tables(part)]


def _type(info: FieldInfo) -> str:
    """What a value may be."""
    return f"{_annotation_text(info.annotation)}{_bounds(info.metadata)}"


def _annotation_text(annotation: Any) -> str:
    """An annotation in words."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(str(part) for part in parts)
    if origin in {Union, UnionType}:
        return " or ".join(_annotation_text(part) for part in parts if part is not NoneType)
    if origin is tuple:
        item = _annotation_text(parts[0])
        return f"list of [{item}]" if parts[-1] is Ellipsis else f"[{len(parts)} x {item}]"
    if hasattr(annotation, "__metadata__"):
        inner = [
            bound
            for one in annotation.__metadata__
            for bound in (one.metadata if isinstance(one, FieldInfo) else [one])
        ]
        return f"{_annotation_text(parts[0])}{_bounds(inner)}"
    return TYPE_NAMES.get(annotation, "table")


def _bounds(metadata: list[Any]) -> str:
    """` >= 0, < 1`, as the constraints of a field say; the last one of a kind counts."""
    bounds = {
        key: f"{sign} {getattr(one, key):g}"
        for one in metadata
        for key, sign in BOUND_SIGNS.items()
        if getattr(one, key, None) is not None
    }
    return f" {', '.join(bounds.values())}" if len(bounds) > 0 else ""
