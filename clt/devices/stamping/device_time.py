"""When bytes were measured by the clock of their device: what paces captured files."""

from __future__ import annotations

from collections.abc import Callable

from clt.devices.decoders.table import find_decoder
from clt.devices.source_spec import SourceSpec


def device_time_of(spec: SourceSpec) -> Callable[[bytes], float | None]:
    """The latest device time of bytes in their order, s, by a decoder of its own; paces files."""
    decoder = find_decoder(spec.proto, spec.name).make(spec.options, spec.name)
    period = spec.join.period

    def device_time(data: bytes) -> float | None:
        times = [
            sample.frame * period if sample.device_ns is None else sample.device_ns * 1e-9
            for sample in decoder.feed(data)
        ]
        return times[-1] if len(times) > 0 else None

    return device_time
