"""The encoders that there are, by the word that `--proto` takes: one beside every decoder."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

from clt.devices.decoders.vesc import VescSettings
from clt.devices.encoders import makerfabs, trek1000
from clt.devices.encoders.dwm1001 import Dwm1001Encoder
from clt.devices.encoders.encoder import Encoder
from clt.devices.encoders.lps_sniffer import LpsSnifferEncoder
from clt.devices.encoders.makerfabs import MakerfabsEncoder
from clt.devices.encoders.ndjson import NdjsonEncoder
from clt.devices.encoders.qorvo_cli import QorvoEncoder
from clt.devices.encoders.rcl import RclEncoder
from clt.devices.encoders.trek1000 import Trek1000Encoder
from clt.devices.encoders.vesc import VescEncoder
from clt.devices.encoders.vesc_can import VescCanEncoder

Content = Literal["ranges", "odometry", "packets", "truth"]


class EncoderSpec(NamedTuple):
    """One encoder."""

    carries: frozenset[Content]
    """What of a log its device reports at all."""
    make: Callable[[str], Encoder]
    """From the id of the stream's own robot, where it is a stream of one."""
    one_robot: bool = False
    max_id: int = 0xFFFF
    """Of decimal ids."""
    max_anchors: int = 0
    """Of ids with a letter; the others are tags."""
    max_tags: int = 0
    answers: bool = False
    """It sends when it is polled."""


ENCODERS: dict[str, EncoderSpec] = {
    "dwm1001": EncoderSpec(frozenset({"ranges"}), Dwm1001Encoder, one_robot=True),
    "lps-sniffer": EncoderSpec(
        frozenset({"packets"}), lambda _node: LpsSnifferEncoder(), max_id=0xFF
    ),
    "makerfabs": EncoderSpec(
        frozenset({"ranges"}),
        lambda _node: MakerfabsEncoder(),
        max_anchors=makerfabs.ANCHORS,
        max_tags=64,
    ),
    "ndjson": EncoderSpec(
        frozenset({"ranges", "odometry", "packets", "truth"}), lambda _node: NdjsonEncoder()
    ),
    "qorvo-cli": EncoderSpec(frozenset({"ranges"}), QorvoEncoder, one_robot=True),
    "rcl": EncoderSpec(frozenset({"ranges", "odometry"}), lambda _node: RclEncoder(), max_id=5),
    "trek1000": EncoderSpec(
        frozenset({"ranges"}),
        lambda _node: Trek1000Encoder(),
        max_anchors=trek1000.ANCHORS,
        max_tags=8,
    ),
    "vesc": EncoderSpec(
        frozenset({"odometry"}),
        lambda node: VescEncoder(VescSettings(node)),
        one_robot=True,
        answers=True,
    ),
    "vesc-can": EncoderSpec(frozenset({"odometry"}), lambda _node: VescCanEncoder(), max_id=0xFF),
}
