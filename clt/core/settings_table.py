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

UNIT = re.compile(
    r"(?:, |\bin |^)((?:m/s|rad/s|rad|m|s|Hz)(?: per (?:m/s|rad/s|m|s))?)(?=[.;:,)]| and | of |$)"
)
"""How a docstring says a unit: `..., m/s.`, or `x, y in m and heading in rad`."""
NAMES: dict[type, str] = {
    float: "number",
    int: "whole number",
    str: "text",
    bool: "true or false",
}
SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


@dataclass(frozen=True)
class Key:
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


def keys_of(model: type[BaseModel], prefix: str = "") -> list[Key]:
    """All keys of a settings type in the order of its source; those of lists have no names."""
    lines = _docstrings(model)
    found: dict[str, Key] = {}
    for name, info in model.model_fields.items():
        tables = [] if get_origin(info.annotation) in {list, tuple} else _tables(info.annotation)
        for table in tables:
            for key in keys_of(table, f"{prefix}{name}."):
                known = found.setdefault(key.name, key)
                if known.type != key.type:  # the `kind` of tables among which one is chosen
                    found[key.name] = replace(known, type=f"{known.type}, {key.type}")
        if len(tables) == 0:
            about = lines.get(name, "")
            units = dict.fromkeys(UNIT.findall(about))
            found[prefix + name] = Key(
                prefix + name,
                _type(info),
                ", ".join(units) or "-",
                _plain(info.get_default(call_default_factory=True)),
                about,
            )
    return list(found.values())


def _plain(value: Any) -> Any:
    """A default as JSON can hold it."""
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
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
    return f"{_words(info.annotation)}{_bounds(info.metadata)}"


def _words(annotation: Any) -> str:
    """An annotation in words."""
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        return ", ".join(str(part) for part in parts)
    if origin in {Union, UnionType}:
        return " or ".join(_words(part) for part in parts if part is not NoneType)
    if origin is tuple:
        item = _words(parts[0])
        return f"list of [{item}]" if parts[-1] is Ellipsis else f"[{len(parts)} x {item}]"
    if hasattr(annotation, "__metadata__"):
        inner = [
            bound
            for one in annotation.__metadata__
            for bound in (one.metadata if isinstance(one, FieldInfo) else [one])
        ]
        return f"{_words(parts[0])}{_bounds(inner)}"
    return NAMES.get(annotation, "table")


def _bounds(metadata: list[Any]) -> str:
    """` >= 0, < 1`, as the constraints of a field say; the last one of a kind counts."""
    bounds = {
        key: f"{sign} {getattr(one, key):g}"
        for one in metadata
        for key, sign in SIGNS.items()
        if getattr(one, key, None) is not None
    }
    return f" {', '.join(bounds.values())}" if len(bounds) > 0 else ""
