"""The decoders that there are, by the word that `proto=` takes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from clt.core.errors import CltError, UsageError
from clt.devices.decoders.decoder import Decoder
from clt.devices.decoders.dwm1001 import Dwm1001Settings, make_dwm1001
from clt.devices.decoders.lps_sniffer import LpsSnifferSettings, make_lps_sniffer
from clt.devices.decoders.makerfabs import MakerfabsSettings, make_makerfabs
from clt.devices.decoders.names import IdForm
from clt.devices.decoders.ndjson import NdjsonSettings, make_ndjson
from clt.devices.decoders.options import parse_options
from clt.devices.decoders.qorvo_cli import QorvoSettings, make_qorvo_cli
from clt.devices.decoders.rcl import RclSettings, make_rcl
from clt.devices.decoders.trek1000 import Trek1000Settings, make_trek1000
from clt.devices.decoders.vesc import VescSettings, make_vesc
from clt.devices.decoders.vesc_can import VescCanSettings, make_vesc_can

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    SettingsType = TypeVar("SettingsType", bound=DataclassInstance)
else:
    SettingsType = TypeVar("SettingsType")

PLUGIN_GROUP = "clt.decoders"
"""Entry points of third parties: each names a DecoderSpec."""


class DecoderSpec(NamedTuple):
    """One decoder."""

    about: str
    """One line of help."""
    ids: IdForm
    """How its samples name robots, and what a map may hold."""
    device_time: bool
    """Its samples carry the device's time; else `period` spaces its frames at rate 0."""
    keys: tuple[str, ...]
    """Options that it takes. With `node`, samples of the stream's own robot carry that name,
    whatever a map says of the others."""
    make: Callable[[Mapping[str, str], str], Decoder]
    """A decoder from its options and the name of its source. Raises UsageError, one line."""


def decoder_spec(
    about: str,
    ids: IdForm,
    settings: type[SettingsType],
    make: Callable[[SettingsType], Decoder],
    *,
    device_time: bool,
) -> DecoderSpec:
    """A row of the table, from a dataclass of settings and what makes a decoder of them."""
    keys = tuple(one.name for one in fields(settings))

    def from_options(options: Mapping[str, str], source: str) -> Decoder:
        return make(parse_options(settings, options, source))

    return DecoderSpec(about, ids, device_time, keys, from_options)


DECODERS: dict[str, DecoderSpec] = {
    "dwm1001": decoder_spec(
        "Decawave DWM1001 (PANS shell): ranges of one tag",
        "hex4",
        Dwm1001Settings,
        make_dwm1001,
        device_time=False,
    ),
    "lps-sniffer": decoder_spec(
        "Bitcraze LPS sniffer: raw stamps of a broadcast network, for clt range",
        "decimal",
        LpsSnifferSettings,
        make_lps_sniffer,
        device_time=True,
    ),
    "makerfabs": decoder_spec(
        "Makerfabs MaUWB (AT commands): ranges of tags",
        "letter",
        MakerfabsSettings,
        make_makerfabs,
        device_time=False,
    ),
    "ndjson": decoder_spec(
        "neutral JSON lines, for firmware of one's own",
        "name",
        NdjsonSettings,
        make_ndjson,
        device_time=True,
    ),
    "qorvo-cli": decoder_spec(
        "Qorvo DWM3001CDK (command line): ranges of one board",
        "hex",
        QorvoSettings,
        make_qorvo_cli,
        device_time=False,
    ),
    "rcl": decoder_spec(
        "binary stream of Shi's sniffer: ranges, wheel odometry, inertial readings",
        "decimal",
        RclSettings,
        make_rcl,
        device_time=True,
    ),
    "trek1000": decoder_spec(
        "Decawave TREK1000, EVK1000 and clones: ranges of tags and among anchors",
        "letter",
        Trek1000Settings,
        make_trek1000,
        device_time=True,
    ),
    "vesc": decoder_spec(
        "VESC motor controller, polled on its serial port: speed of one robot",
        "robot",
        VescSettings,
        make_vesc,
        device_time=False,
    ),
    "vesc-can": decoder_spec(
        "VESC motor controllers on a CAN bus: speeds of robots",
        "decimal",
        VescCanSettings,
        make_vesc_can,
        device_time=False,
    ),
}
"""Those of clt itself."""


@cache
def plugins() -> Mapping[str, EntryPoint]:
    """Decoders of third parties, not loaded; a name of clt's own cannot be taken."""
    return {one.name: one for one in entry_points(group=PLUGIN_GROUP) if one.name not in DECODERS}


def decoder_names() -> tuple[str, ...]:
    """All words that `proto=` takes, plug-ins included."""
    return tuple(sorted({*DECODERS, *plugins()}))


def find_decoder(proto: str, source: str) -> DecoderSpec:
    """The decoder of that name, for the source of that name.

    Raises:
        UsageError: for a name that is not known.
        CltError: for a plug-in that cannot be loaded.
    """
    if proto in DECODERS:
        return DECODERS[proto]
    found = plugins().get(proto)
    if found is None:
        from clt.core.settings import did_you_mean  # noqa: PLC0415 pydantic, slow to import

        remedy = did_you_mean(proto, decoder_names())
        raise UsageError(f"source {source}: unknown protocol `{proto}`{remedy}")
    try:
        spec = found.load()
    except Exception as error:  # noqa: BLE001 code of others may raise anything
        why = f"{type(error).__name__}: {error}".splitlines()[0]
        raise CltError(
            f"source {source}: plug-in `{proto}` ({found.value}) does not load: {why}; "
            "repair or uninstall its package"
        ) from None
    if not isinstance(spec, DecoderSpec):
        raise CltError(
            f"source {source}: plug-in `{proto}`: {found.value} is a {type(spec).__name__}, "
            "no DecoderSpec; repair or uninstall its package"
        )
    return spec


def make_decoder(proto: str, options: Mapping[str, str], source_name: str) -> Decoder:
    """A decoder from the decoder's own options (`DecoderSpec.keys`) of a source.

    Raises UsageError or CltError: one line that names the source, the key and the remedy.
    """
    return find_decoder(proto, source_name).make(options, source_name)
