"""What playing out a log as a device found, in words."""

from __future__ import annotations

from clt.cli.messages.words import Texts
from clt.core.diagnostics import Diagnostic

REASONS = {
    "no_id": "samples of robots beyond the ids that the device has",
    "not_carried_pair": "ranges between two tags or two anchors",
    "out_of_scale": "values that the format cannot hold",
    "packet_odometry": "samples of odometry that travel in UWB packets",
    "too_many": "ranges at one time beyond those that a line holds",
    "too_old": "stamps that a counter of 32 bits (67.2 ms) cannot hold",
}
"""By the reasons of `clt.devices.encoders.encoder` and of `clt.devices.emission.emission`."""


def _left_out(found: Diagnostic) -> str:
    parts = [f"{count} {REASONS[reason]}" for reason, count in found.values["counts"].items()]
    return f"{found.subject} cannot carry {', '.join(parts)}: left out"


def _not_reported(found: Diagnostic) -> str:
    parts = [f"{count} of {content}" for content, count in found.values["counts"].items()]
    return f"not in the stream, as {found.subject} reports none: samples {', '.join(parts)}"


EMISSION_TEXTS: Texts = {"left_out": _left_out, "not_reported": _not_reported}
