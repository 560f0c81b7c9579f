"""Typed settings from TOML, `CLT_*` environment variables and `--set KEY=VALUE`.

Precedence: defaults < file < environment < options. Unknown keys are refused with the nearest
known one named. A settings type is a frozen pydantic model; `parse_settings` turns every fault of
the input into one line.
"""

from __future__ import annotations

import difflib
import os
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError

from clt.core.document import Document
from clt.core.errors import UsageError
from clt.core.validation import describe_fault, shorten

ENVIRONMENT_PREFIX = "CLT_"


class Settings(BaseModel):
    """Base of every settings type: frozen, unknown keys refused, NaN and infinity refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


SettingsType = TypeVar("SettingsType", bound=BaseModel)


def read_toml(source: Path | Document) -> dict[str, Any]:
    """A TOML file as a dictionary. Raises UsageError naming the file and the line."""
    document = source if isinstance(source, Document) else Document.read(source)
    try:
        return tomllib.loads(document.data.decode())
    except ValueError as error:  # of TOML, of UTF-8, or of a number with thousands of digits
        raise UsageError(f"{source}: not valid TOML: {error}") from None
    except RecursionError:
        raise UsageError(f"{source}: nested too deeply") from None


def set_dotted_key(tree: dict[str, Any], key: str, value: Any) -> None:
    """Set `a.b.c` in a nested dictionary. Raises UsageError where a table is not one."""
    *tables, leaf = key.split(".")
    for name in tables:
        tree = tree.setdefault(name, {})
        if not isinstance(tree, dict):
            raise UsageError(f"{shorten(key)}: {shorten(name)} is not a table")
    tree[leaf] = value


def parse_literal(text: str) -> Any:
    """The TOML value that `text` spells, else `text` itself: 3, 0.1, true, [1, 2], word."""
    try:
        table = tomllib.loads(f"value = {text}")
    except ValueError:  # no TOML, or a number of thousands of digits
        return text
    return table["value"] if len(table) == 1 else text


def parse_assignments(options: Iterable[str]) -> dict[str, Any]:
    """`KEY=VALUE` options as {key: value}. Raises UsageError for one without a key."""
    pairs: dict[str, Any] = {}
    for option in options:
        key, sign, text = option.partition("=")
        if sign == "" or key.strip() == "":
            raise UsageError(f"--set {shorten(option)}: expected KEY=VALUE, e.g. --set duration=60")
        try:
            pairs[key.strip()] = parse_literal(text.strip())
        except RecursionError:
            raise UsageError(f"--set {shorten(key.strip())}: nested too deeply") from None
    return pairs


def known_keys(model: type[BaseModel], prefix: str = "") -> list[str]:
    """Every dotted key of a settings type, tables included; of a choice of tables, all keys."""
    keys: dict[str, None] = {}
    for name, info in model.model_fields.items():
        keys[prefix + name] = None
        if not _is_list(info.annotation):
            for kind in _models(info.annotation):
                keys |= dict.fromkeys(known_keys(kind, f"{prefix}{name}."))
    return list(keys)


def settings_from_environment(
    model: type[BaseModel], environment: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """`CLT_SENSORS__RANGE__SIGMA=0.2` as {"sensors.range.sigma": 0.2} (two underscores = a dot).

    Variables that are no key of `model` are passed over: see `refuse_unknown_variables`.
    Raises UsageError for a value that cannot be read.
    """
    environment = os.environ if environment is None else environment
    pairs: dict[str, Any] = {}
    for key in known_keys(model):
        variable = ENVIRONMENT_PREFIX + _variable_name(key)
        if variable in environment:
            try:
                pairs[key] = parse_literal(environment[variable])
            except RecursionError:
                raise UsageError(f"environment variable {variable}: nested too deeply") from None
    return pairs


def refuse_unknown_variables(
    models: Iterable[type[BaseModel]], environment: Mapping[str, str] | None = None
) -> None:
    """Raise UsageError for a `CLT_*` variable that is no key of any model, naming the nearest."""
    environment = os.environ if environment is None else environment
    known = {_variable_name(key) for model in models for key in known_keys(model)}
    for variable in sorted(environment):
        name = variable.removeprefix(ENVIRONMENT_PREFIX)
        if variable.startswith(ENVIRONMENT_PREFIX) and name not in known:
            close = difflib.get_close_matches(name, sorted(known), n=1, cutoff=0.6)
            hint = f", did you mean `{ENVIRONMENT_PREFIX}{close[0]}`?" if len(close) == 1 else ""
            raise UsageError(f"environment variable {variable}: unknown key{hint}")


def _variable_name(key: str) -> str:
    """A dotted key as the name of an environment variable, without the prefix."""
    return key.replace(".", "__").upper()


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Remedy for an unknown word: the known word closest to it, or the whole list."""
    known = list(known)
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if len(close) == 1:
        return f", did you mean `{close[0]}`?"
    return f"; known: {', '.join(sorted(known))}" if len(known) > 0 else ""


def parse_settings(model: type[SettingsType], data: Mapping[str, Any], source: str) -> SettingsType:
    """Build a settings value. Raises UsageError: one line with source, key and remedy."""
    try:
        return model.model_validate(dict(data))
    except ValidationError as error:
        fault = max(error.errors(), key=lambda fault: len(fault["loc"]))
        table, keys = _locate_fault(model, fault["loc"])
        place = ".".join(keys)
        if fault["type"] == "extra_forbidden":
            key = shorten(str(fault["loc"][-1]))
            place = ".".join([*keys, key])
            hint = did_you_mean(key, table.model_fields)
            raise UsageError(f"{source}: unknown key `{place}`{hint}") from None
        if fault["type"] == "union_tag_not_found":
            key = fault["ctx"]["discriminator"].strip("'")
            raise UsageError(f"{source}: `{place}.{key}` is missing") from None
        text = describe_fault(fault)
        if fault["type"] == "missing" and isinstance(fault["loc"][-1], int):
            place, text = ".".join(keys[:-1]), f"needs {fault['loc'][-1] + 1} values at least"
        where = f"`{place}`: " if place != "" else ""
        raise UsageError(f"{source}: {where}{text}") from None


def _locate_fault(
    model: type[BaseModel], path: Sequence[int | str]
) -> tuple[type[BaseModel], list[str]]:
    """The innermost table on pydantic's path of a fault, and the user's keys along it.

    The keys of a mapping are the user's own. What pydantic adds to name the member of a union is
    followed, not reported; an unknown key is left out.
    """
    keys: list[str] = []
    kinds: list[type[BaseModel]] = []
    free = False
    for part in path:
        tagged = [kind for kind in kinds if _has_tag(kind, part)]
        if isinstance(part, int) or free:
            keys.append(str(part))
            free = False
        elif part in model.model_fields:
            keys.append(part)
            annotation = model.model_fields[part].annotation
            free = get_origin(annotation) in {dict, Mapping}
            kinds = _models(annotation)
            model = kinds[0] if len(kinds) == 1 else model
        elif len(tagged) == 1:
            model, kinds = tagged[0], []
    return model, keys


def _has_tag(kind: type[BaseModel], tag: int | str) -> bool:
    """A literal default of the settings type equals the tag."""
    return any(info.default == tag for info in kind.model_fields.values())


def _is_list(annotation: Any) -> bool:
    """A list or tuple: its items have no dotted keys."""
    return get_origin(annotation) in {list, tuple}


def _models(annotation: Any) -> list[type[BaseModel]]:
    """The settings types named anywhere inside an annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [kind for part in getattr(annotation, "__args__", ()) for kind in _models(part)]
