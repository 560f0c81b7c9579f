"""What a user says of one source: `NAME=URL,proto=P,KEY=VALUE...`, or a table of a TOML file."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from clt.core.document import Document
from clt.core.errors import LogError, UsageError
from clt.core.settings import did_you_mean
from clt.devices.decoders.names import is_id, is_robot_name, usual_id
from clt.devices.decoders.options import parse_options
from clt.devices.decoders.table import DecoderSpec, find_decoder
from clt.devices.intake.joining import JoinSettings
from clt.devices.sources.source import SourceUrl
from clt.devices.sources.table import find_source
from clt.devices.sources.url import STDIN_SCHEME, parse_url

SOURCE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
OWN_KEYS = ("map", "period", "steer", "wheelbase")
"""Keys of the recorder itself; the others are the decoder's."""
PASSING_SCHEMES = ("file", "candump")


@dataclass(frozen=True)
class SourceSpec:
    """One source."""

    name: str
    url: SourceUrl
    proto: str
    robots: Mapping[str, str] | None = None
    """From the device's ids to names of robots; None without a map."""
    options: Mapping[str, str] = field(default_factory=dict)
    """Of the decoder."""
    join: JoinSettings = field(default_factory=JoinSettings)

    @property
    def decoder(self) -> DecoderSpec:
        """What its bytes mean. Raises UsageError for an unknown protocol."""
        return find_decoder(self.proto, self.name)

    @property
    def past(self) -> bool:
        """Its bytes do not arrive at the pace of the device: stamps keep the device's spacing."""
        if self.url.scheme == STDIN_SCHEME:
            return True
        return self.url.scheme in PASSING_SCHEMES and float(self.url.options.get("rate", "0")) != 1

    @property
    def live(self) -> bool:
        """Its bytes come from a device, at whatever pace; not from a file or a pipe."""
        return self.url.scheme not in {*PASSING_SCHEMES, STDIN_SCHEME}

    @property
    def pulled(self) -> bool:
        """Read whenever there is nothing else to do: as fast as possible."""
        rate = float(self.url.options.get("rate", "0"))
        return self.url.scheme in PASSING_SCHEMES and rate == 0

    def document(self) -> dict[str, Any]:
        """As it is stored in a log."""
        words: dict[str, Any] = {"url": self.url.text, "proto": self.proto, **self.options}
        if self.robots is not None:
            words["map"] = dict(self.robots)
        return words | {key: one for key, one in vars(self.join).items() if one is not None}


def parse_source(text: str) -> SourceSpec:
    """A source from the words of `--source`. Raises UsageError, CltError for a plug-in."""
    head, *rest = text.split(",")
    name, equals, url = head.partition("=")
    if equals == "" or url == "":
        raise UsageError(
            f"--source {text}: write NAME=URL,proto=P, e.g. uwb=serial:/dev/ttyACM0,proto=rcl"
        )
    values: dict[str, object] = {"url": url}
    for word in rest:
        key, equals, value = word.partition("=")
        if equals == "":
            raise UsageError(
                f"--source {name}: `{word}` is not KEY=VALUE (a path with a comma needs --sources)"
            )
        if key in values:
            raise UsageError(f"--source {name}: `{key}` is given twice")
        values[key] = value
    return source_of(name, values)


def sources_of_file(document: Document) -> list[SourceSpec]:
    """The sources of a TOML file: `[sources.NAME]`. Raises UsageError."""
    try:
        table = tomllib.loads(document.data.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise UsageError(f"{document}: not a TOML file: {error}") from None
    sources = table.pop("sources", None)
    if not isinstance(sources, dict) or len(sources) == 0 or len(table) > 0:
        extra = f"`{next(iter(table))}` is not known" if len(table) > 0 else "no [sources.NAME]"
        raise UsageError(f"{document}: {extra}; write a table [sources.NAME] for each source")
    try:
        return [source_of(name, values) for name, values in sources.items()]
    except UsageError as error:
        raise UsageError(f"{document}: {error}") from None


def sources_of_log(text: str, place: str) -> list[SourceSpec]:
    """The sources that a log stores as JSON. Raises LogError."""
    try:
        table = json.loads(text)
        return [source_of(name, values, opened=False) for name, values in table.items()]
    except (ValueError, AttributeError, UsageError) as error:
        raise LogError(f"{place}: the sources in its metadata make no sense: {error}") from None


def store_sources(specs: Sequence[SourceSpec]) -> str:
    """The sources as JSON."""
    return json.dumps({spec.name: spec.document() for spec in specs})


def source_of(name: str, values: object, *, opened: bool = True) -> SourceSpec:
    """A source from its table; `opened`: its bytes are to come from there, not from a log.

    Raises UsageError naming source, key and remedy.
    """
    place = f"source {name}"
    if SOURCE_NAME.fullmatch(name) is None:
        raise UsageError(f"{place}: a name is a letter, then letters, digits or _")
    if not isinstance(values, dict):
        raise UsageError(f"{place}: not a table of url, proto and keys")
    left = {key: _text(place, key, value) for key, value in values.items() if key != "map"}
    if "url" not in left or "proto" not in left:
        missing = "url" if "url" not in left else "proto"
        raise UsageError(f"{place}: `{missing}` is missing; add {missing}=...")
    url = parse_url(left.pop("url"))
    if opened or url.scheme in PASSING_SCHEMES:
        find_source(url.scheme, place).check(url)
    proto = left.pop("proto")
    decoder = find_decoder(proto, name)
    own = {key: left.pop(key) for key in tuple(left) if key in OWN_KEYS and key not in decoder.keys}
    for key in left:
        if key not in decoder.keys:
            known = (*decoder.keys, *OWN_KEYS)
            guess = did_you_mean(key, known)
            raise UsageError(f"{place}: unknown key `{key}`{guess}")
    decoder.make(left, name)
    robots = _map(place, decoder, values["map"]) if "map" in values else None
    return SourceSpec(name, url, proto, robots, left, parse_options(JoinSettings, own, name))


def override(stored: Sequence[SourceSpec], given: Sequence[SourceSpec]) -> list[SourceSpec]:
    """The stored sources, those that are given too in their place; new ones are refused."""
    names = [spec.name for spec in stored]
    for spec in given:
        if spec.name not in names:
            raise UsageError(
                f"source {spec.name}: the log has no bytes of it; it has {', '.join(names)}"
            )
    by_name = {spec.name: spec for spec in given}
    return [
        replace(by_name[spec.name], url=spec.url) if spec.name in by_name else spec
        for spec in stored
    ]


def check_sources(specs: Sequence[SourceSpec]) -> None:
    """Raise UsageError for names given twice and steering of a source that there is not."""
    names = [spec.name for spec in specs]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"source {name}: given twice; names of sources differ")
    for spec in specs:
        steer = spec.join.steer
        if steer is not None and steer not in names:
            guess = did_you_mean(steer, names)
            raise UsageError(f"source {spec.name}: steer={steer} is no source{guess}")
    if sum(spec.url.scheme == STDIN_SCHEME for spec in specs) > 1:
        raise UsageError("two sources want standard input; name a file for one of them")


def _text(place: str, key: str, value: object) -> str:
    """A value as the text that a command line would hold."""
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise UsageError(f"{place}: `{key}` is neither text nor a number")
    return str(value)


def _map(place: str, decoder: DecoderSpec, value: object) -> dict[str, str]:
    """From ids to robots: `ID:robot+ID:robot`, or a table."""
    if isinstance(value, dict):
        pairs = [(str(key), str(name)) for key, name in value.items()]
    else:
        pairs = []
        for word in str(value).split("+"):
            key, colon, name = word.rpartition(":")
            if colon == "":
                raise UsageError(f"{place}: map: `{word}` is not ID:ROBOT; join them with +")
            pairs.append((key, name))
    robots: dict[str, str] = {}
    for word, name in pairs:
        key = usual_id(decoder.ids, word)
        if not is_id(decoder.ids, key):
            raise UsageError(f"{place}: map: `{word}` is no id of this protocol ({decoder.ids})")
        if not is_robot_name(name):
            raise UsageError(
                f"{place}: map: `{name}` is no name of a robot: a letter, then letters, digits, _"
            )
        if key in robots or name in robots.values():
            raise UsageError(f"{place}: map: `{key}:{name}` is given twice")
        robots[key] = name
    return robots
