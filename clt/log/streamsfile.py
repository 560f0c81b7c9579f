"""`streams.toml`: which topics of somebody else's log hold what."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from clt.document import Document
from clt.errors import UsageError
from clt.log.metadata import NAME
from clt.settings import Settings, nearest, parse, read_toml
from clt.streams import Twist

StampFrom = Literal["header", "log_time"]
Positive = Annotated[float, Field(gt=0.0)]
Id = Annotated[int, Field(ge=0, lt=2**16)]


class RobotStreams(Settings):
    """The table `[robots.NAME]`."""

    odometry: str | None = None
    """Topic: nav_msgs/Odometry, geometry_msgs/TwistStamped or TwistWithCovarianceStamped."""
    ground_truth: str | None = None
    """Topic: PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry."""
    static: bool = False
    position: tuple[float, float] | None = None
    """Known position of a static robot, m."""
    id: Id | None = None
    """As clt_msgs/Range names it; otherwise robots count from 1."""
    antenna: tuple[float, float] = (0.0, 0.0)
    """In the body frame, m."""
    twist: Twist = "mean"
    sigma_v: Positive | None = None
    """Odometry noise of one sample, m/s."""
    sigma_omega: Positive | None = None
    """The same, rad/s."""
    stamp: StampFrom | None = None
    """Overrides the `stamp` of the file."""

    @model_validator(mode="after")
    def _consistent(self) -> RobotStreams:
        if self.static and self.odometry is not None:
            raise ValueError("a static robot has no odometry; leave out one of the two")
        if not self.static and self.position is not None:
            raise ValueError("only a static robot has a position; add static = true")
        return self


class RangeStreams(Settings):
    """One of the tables `[[ranges]]`: range = gain * raw + offset."""

    topic: str
    source: str | None = None
    """Robot that measured; left out only for clt_msgs/Range, whose messages tell."""
    target: str | None = None
    field: str | None = None
    """Path of the range in the message, m before gain and offset."""
    sigma: Positive | None = None
    """Standard deviation of the calibrated range, m."""
    gain: float = 1.0
    offset: float = 0.0
    stamp: StampFrom | None = None

    @model_validator(mode="after")
    def _consistent(self) -> RangeStreams:
        if (self.source is None) != (self.target is None):
            raise ValueError("name both source and target, or neither")
        if self.source is not None and self.source == self.target:
            raise ValueError("source and target are the same robot")
        return self


class StreamsFile(Settings):
    """The whole file."""

    robots: dict[str, RobotStreams]
    ranges: tuple[RangeStreams, ...] = ()
    stamp: StampFrom = "header"
    """Where stamps come from: the messages' headers where they have one, or `log_time`."""

    @model_validator(mode="after")
    def _consistent(self) -> StreamsFile:
        for name in self.robots:
            if NAME.fullmatch(name) is None:
                raise ValueError(f"`{name}` is not a robot name: a letter, then letters, digits, _")
        ids = [robot.id for robot in self.robots.values() if robot.id is not None]
        if len(set(ids)) < len(ids):
            raise ValueError("two robots share one id")
        for entry in self.ranges:
            for end in (entry.source, entry.target):
                if end is not None and end not in self.robots:
                    known = ", ".join(self.robots)
                    raise ValueError(f"{entry.topic}: no robot `{end}`; robots: {known}")
        return self

    @property
    def topics(self) -> frozenset[str]:
        """Every topic that is named."""
        robots = self.robots.values()
        named = [topic for robot in robots for topic in (robot.odometry, robot.ground_truth)]
        named += [entry.topic for entry in self.ranges]
        return frozenset(topic for topic in named if topic is not None)

    def check(self, topics: Collection[str], place: str) -> None:
        """Raise UsageError for a named topic that is not among `topics`."""
        for topic in sorted(self.topics):
            if topic not in topics:
                raise UsageError(f"{place} has no topic `{topic}`{nearest(topic, topics)}")


def read_streams(source: Path | Document) -> StreamsFile:
    """A streams file. Raises UsageError naming the file and the key."""
    return parse(StreamsFile, read_toml(source), str(source))
