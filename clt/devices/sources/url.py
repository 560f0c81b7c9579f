"""URLs of sources: `serial:/dev/ttyACM0?baud=115200`, `udp:HOST:PORT`, `-`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite

from clt.core.errors import UsageError
from clt.core.settings import did_you_mean
from clt.devices.sources.source import SourceUrl

STDIN_SCHEME = "-"
MAX_RATE = 1e6


def parse_url(text: str) -> SourceUrl:
    """Split a URL; `-` is standard input. Raises UsageError for text that is none."""
    if text == STDIN_SCHEME:
        return SourceUrl(STDIN_SCHEME, "", {}, text)
    scheme, colon, rest = text.partition(":")
    if colon == "" or re.fullmatch(r"[a-z][a-z0-9-]*", scheme) is None:
        raise UsageError(
            f"`{text}` is no source: write SCHEME:TARGET, e.g. serial:/dev/ttyACM0, or - for "
            "standard input"
        )
    target, mark, query = rest.partition("?")
    options: dict[str, str] = {}
    for word in query.split("&") if mark else []:
        key, equals, value = word.partition("=")
        if equals == "" or key == "":
            raise UsageError(f"{text}: `{word}` is not KEY=VALUE")
        options[key] = value
    return SourceUrl(scheme, target, options, text)


def check_options(url: SourceUrl, known: Mapping[str, str]) -> None:
    """Raise UsageError for a key behind `?` that its scheme does not have."""
    for key in url.options:
        if key not in known:
            remedy = did_you_mean(key, known) or f"; {url.scheme}: has no keys"
            raise UsageError(f"{url.text}: unknown key `{key}`{remedy}")


def number_option(url: SourceUrl, key: str, default: float, least: float, most: float) -> float:
    """A number behind `?`. Raises UsageError unless it lies from `least` to `most`."""
    text = url.options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        raise UsageError(f"{url.text}: {key}={text} is not a number") from None
    if not isfinite(value) or not least <= value <= most:
        raise UsageError(f"{url.text}: {key}={text} is not from {least:g} to {most:g}")
    return value


def host_and_port(url: SourceUrl) -> tuple[str, int]:
    """HOST:PORT, HOST perhaps in brackets or empty. Raises UsageError."""
    host, _, port = url.target.rpartition(":")
    if re.fullmatch(r"[0-9]{1,5}", port) is None or not 0 <= int(port) < 1 << 16:
        raise UsageError(f"{url.text}: no port; write {url.scheme}:HOST:PORT")
    return host.removeprefix("[").removesuffix("]"), int(port)


def check_target(url: SourceUrl, what: str) -> None:
    """Raise UsageError for a URL without its target, which is `what`."""
    if url.target == "":
        raise UsageError(f"{url.text}: no {what}; write {url.scheme}:{what.upper()}")
