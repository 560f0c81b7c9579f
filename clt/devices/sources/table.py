"""The sources that there are, by the scheme of their URLs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from clt.core.errors import CltError, UsageError
from clt.core.settings import did_you_mean
from clt.devices.sources.files import CANDUMP, FILE, STDIN
from clt.devices.sources.serial_port import SERIAL
from clt.devices.sources.socketcan import CAN
from clt.devices.sources.source import SourceKind
from clt.devices.sources.tcp import TCP
from clt.devices.sources.tcp_listen import TCP_LISTEN
from clt.devices.sources.udp import UDP

SOURCE_PLUGIN_GROUP = "clt.sources"
"""Entry points of third parties: each names a SourceKind."""

SOURCES: dict[str, SourceKind] = {
    "serial": SERIAL,
    "udp": UDP,
    "tcp": TCP,
    "tcp-listen": TCP_LISTEN,
    "file": FILE,
    "candump": CANDUMP,
    "-": STDIN,
    "can": CAN,
}
"""Those of clt itself."""


@cache
def source_plugins() -> Mapping[str, EntryPoint]:
    """Sources of third parties, not loaded; a scheme of clt's own cannot be taken."""
    group = entry_points(group=SOURCE_PLUGIN_GROUP)
    return {one.name: one for one in group if one.name not in SOURCES}


def find_source(scheme: str, place: str) -> SourceKind:
    """The kind of source of that scheme; `place` names who asks.

    Raises UsageError for a scheme that is not known, CltError for a plug-in that does not load.
    """
    if scheme in SOURCES:
        return SOURCES[scheme]
    found = source_plugins().get(scheme)
    if found is None:
        guess = did_you_mean(scheme, [*SOURCES, *source_plugins()])
        raise UsageError(f"{place}: unknown source `{scheme}:`{guess}")
    try:
        kind = found.load()
    except Exception as error:  # noqa: BLE001 - a stranger's code may raise anything
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        raise CltError(
            f"{place}: plug-in `{scheme}` ({found.value}) does not load: {why}; "
            "repair or uninstall its package"
        ) from None
    if not isinstance(kind, SourceKind):
        raise CltError(
            f"{place}: plug-in `{scheme}`: {found.value} is a {type(kind).__name__}, "
            "no SourceKind; repair or uninstall its package"
        )
    return kind
