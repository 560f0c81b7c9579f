"""The words of `--source` that read an emitted stream back."""

from __future__ import annotations

import shlex

from clt.devices.decoders.table import DECODERS
from clt.devices.emission.emission import Emission
from clt.devices.sources.source import SourceUrl
from clt.devices.sources.url import STDIN_SCHEME

CANDUMP_PROTO = "vesc-can"
"""Its bytes are lines of candump, which hold their time."""


def source_words(emission: Emission, url: SourceUrl | None, path: str) -> str:
    """NAME=URL,proto=P and the keys, quoted for a shell; `url` is None for a file."""
    name = "odo" if emission.spec.carries == {"odometry"} else "uwb"
    words = [f"{name}={reading_url(emission.proto, url, path)}", f"proto={emission.proto}"]
    if emission.node != "":
        words.append(f"node={emission.node}")
    if len(emission.robots) > 0:
        robots = "+".join(f"{number}:{robot}" for number, robot in emission.robots.items())
        words.append(f"map={robots}")
    period = frame_period_s(emission)
    if period is not None:
        words.append(f"period={period:.9g}")
    return shlex.quote(",".join(words))


def reading_url(proto: str, url: SourceUrl | None, path: str) -> str:
    """The other end of what was written to."""
    if url is None:
        scheme = "candump" if proto == CANDUMP_PROTO else "file"
        return f"{scheme}:{path}"
    if url.scheme == STDIN_SCHEME:
        return STDIN_SCHEME
    other = {"tcp": "tcp-listen", "tcp-listen": "tcp"}.get(url.scheme, url.scheme)
    target = "OTHER_END" if url.scheme == "serial" else url.target
    return f"{other}:{target}"


def frame_period_s(emission: Emission) -> float | None:
    """Mean time between frames, s; None where the stream itself holds times, or too few frames."""
    if DECODERS[emission.proto].device_time or emission.proto == CANDUMP_PROTO:
        return None
    times = [time for time, _ in emission]
    if len(times) < 2 or times[-1] == times[0]:
        return None
    return (times[-1] - times[0]) / (len(times) - 1) * 1e-9
