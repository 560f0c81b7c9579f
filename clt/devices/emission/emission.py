"""What a device would send for a log: bytes with their times, and what it could not carry."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from clt.core.errors import CltError
from clt.core.recording import Recording
from clt.devices.decoders.table import DECODERS
from clt.devices.emission.device_ids import device_ids
from clt.devices.emission.log_samples import Stream, log_samples, log_streams
from clt.devices.encoders.encoder import Encoder, Timed
from clt.devices.encoders.table import ENCODERS, Content, EncoderSpec

NO_ID = "no_id"
"""Of a robot beyond the ids that the device has."""


@dataclass(frozen=True)
class Emission:
    """A log that a device of one kind plays out; iterating over it makes the bytes, each time.

    An item holds the time by the device's clock, ns from the beginning of the log, and the bytes.
    """

    proto: str
    spec: EncoderSpec
    streams: Sequence[Stream]
    robots: Mapping[str, str]
    """From the device's ids to the robots, but for the robot of a stream of one."""
    node: str
    """The robot of a stream of one, else empty."""
    unnamed: int
    """Samples of robots that have no id."""
    left_out: Counter[str] = field(default_factory=Counter)
    """What could not be carried, by reason, as far as the bytes were made."""

    def __iter__(self) -> Iterator[Timed]:
        encoder = self.spec.make(self.node)
        self._note(encoder)
        for _, samples in log_samples(self.streams):
            yield from encoder.encode(samples)
            self._note(encoder)
        yield from encoder.finish()
        self._note(encoder)

    def _note(self, encoder: Encoder) -> None:
        self.left_out.clear()
        self.left_out.update(+encoder.left_out + Counter({NO_ID: self.unnamed}))

    @property
    def samples(self) -> dict[Content, int]:
        """Samples by content that the device reports, those left out included."""
        counts: Counter[Content] = Counter()
        for stream in self.streams:
            counts[stream.content] += len(stream.stamp)
        return dict(counts)


def prepare_emission(recording: Recording, proto: str, robot: str | None, log: str) -> Emission:
    """Plan how a log is played out; `robot` is whose device it is, where it is of one.

    Raises CltError for a log without anything that the device reports.
    """
    spec, form = ENCODERS[proto], DECODERS[proto].ids
    only = None if robot is None else recording.team.index(robot)
    ids = device_ids(form, spec, recording.team, recording.ranges)
    if only is not None:
        ids[only] = recording.team.names[only]
    streams, unnamed = log_streams(recording, ids, spec.carries, only)
    if len(streams) == 0:
        what = " or ".join(sorted(spec.carries))
        whose = "" if robot is None else f" of {robot}"
        remedy = "; clt info shows what it holds"
        raise CltError(f"{log}: no {what}{whose}, which is what {proto} carries{remedy}")
    mapped = form not in {"name", "robot"}
    robots = {ids[index]: recording.team.names[index] for index in ids if mapped and index != only}
    node = "" if only is None else ids[only]
    return Emission(proto, spec, streams, robots, node, unnamed.total())
