"""`streams.toml`: which topics of somebody else's log hold what."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from clt.core.document import Document
from clt.core.recording import WORLD_FRAME, TwistSampling
from clt.core.settings import Settings, parse_settings, read_toml
from clt.log.recording.mapping.patterns import check_placeholders, placeholders
from clt.log.recording.metadata import ROBOT_NAME_PATTERN

StampSource = Literal["header", "log_time"]
PositiveNumber = Annotated[float, Field(gt=0.0)]
RobotId = Annotated[int, Field(ge=0, lt=2**16)]


class RobotStreams(Settings):
    """The table `[robots.ROBOT_NAME_PATTERN]`."""

    odometry: str | None = None
    """Topic: nav_msgs/Odometry, geometry_msgs/TwistStamped or TwistWithCovarianceStamped."""
    ground_truth: str | None = None
    """Topic: PoseStamped, PoseWithCovarianceStamped, TransformStamped or Odometry."""
    alias: tuple[str, ...] = ()
    """What topics call it where that is not its name: patterns take either."""
    static: bool = False
    """It stands still for the whole log."""
    position: tuple[float, float] | None = None
    """Known position of a static robot, m."""
    id: RobotId | None = None
    """As clt_msgs/Range names it; otherwise robots count from 1."""
    antenna: tuple[float, float] = (0.0, 0.0)
    """In the body frame, m."""
    twist: TwistSampling = "mean"
    """The twist is the mean over the interval that ends at its stamp, or that of an instant."""
    sigma_v: PositiveNumber | None = None
    """Odometry noise of one sample, m/s."""
    sigma_omega: PositiveNumber | None = None
    """The same, rad/s."""
    stamp: StampSource | None = None
    """Overrides the `stamp` of the file."""

    @field_validator("alias", mode="before")
    @classmethod
    def _one(cls, value: Any) -> Any:
        return (value,) if isinstance(value, str) else value

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
    """A topic, or a pattern with {source}, {target} or both for many."""
    source: str | None = None
    """Robot that measured; left out only where the topic or the messages (clt_msgs/Range) say."""
    target: str | None = None
    """Robot that it measured to; as `source`."""
    field: str | None = None
    """Path of the range in the message, m before gain and offset."""
    sigma: PositiveNumber | None = None
    """Standard deviation of the calibrated range, m."""
    gain: float = 1.0
    """Range over raw value."""
    offset: float = 0.0
    """Added after the gain, m."""
    stamp: StampSource | None = None
    """Overrides the `stamp` of the file."""

    @property
    def pattern(self) -> bool:
        """It stands for many topics."""
        return "{" in self.topic

    @model_validator(mode="after")
    def _consistent(self) -> RangeStreams:
        check_placeholders(self.topic, ("source", "target"))
        found = placeholders(self.topic)
        for end in found:
            if getattr(self, end) is not None:
                raise ValueError(f"`{self.topic}` gives the {end} already; leave one of them out")
        known = [self.source is not None or "source" in found]
        known.append(self.target is not None or "target" in found)
        if any(known) and not all(known):
            raise ValueError("name both source and target, or neither")
        if self.source is not None and self.source == self.target:
            raise ValueError("source and target are the same robot")
        return self


class StreamsFile(Settings):
    """The whole file."""

    robots: dict[str, RobotStreams] = Field(default_factory=dict)
    ranges: tuple[RangeStreams, ...] = ()
    """Topics of ranges, a table each."""
    odometry: str | None = None
    """Pattern with {robot}: odometry of every robot that has such a topic, named by it."""
    ground_truth: str | None = None
    """Pattern with {robot}: truth of the robots that have such a topic."""
    frame: Annotated[str, Field(min_length=1)] = WORLD_FRAME
    """Id of the frame in which the static positions are given."""
    stamp: StampSource = "header"
    """Where stamps come from: the messages' headers where they have one, or `log_time`."""

    @model_validator(mode="after")
    def _named(self) -> StreamsFile:
        if len(self.robots) == 0 and self.odometry is None:
            raise ValueError("no robots; add a table [robots.NAME] for each")
        for name in self.robots:
            if ROBOT_NAME_PATTERN.fullmatch(name) is None:
                raise ValueError(f"`{name}` is not a robot name: a letter, then letters, digits, _")
        ids = [robot.id for robot in self.robots.values() if robot.id is not None]
        if len(set(ids)) < len(ids):
            raise ValueError("two robots share one id")
        labels = [label for robot in self.robots.values() for label in set(robot.alias)]
        for label in labels:
            if label in self.robots or labels.count(label) > 1:
                raise ValueError(f"two robots are called `{label}`, as name or alias")
        return self

    @model_validator(mode="after")
    def _patterns(self) -> StreamsFile:
        for text in (self.odometry, self.ground_truth):
            if text is None:
                continue
            check_placeholders(text, ("robot",))
            if len(placeholders(text)) == 0:
                how = "for all robots it needs {robot}; that of one stands in [robots.NAME]"
                raise ValueError(f"`{text}`: {how}")
        ends = [(entry.topic, end) for entry in self.ranges for end in (entry.source, entry.target)]
        for topic, end in ends if self.odometry is None else ():
            if end is not None and end not in self.robots:
                known = ", ".join(self.robots)
                raise ValueError(f"{topic}: no robot `{end}`; robots: {known}")
        return self

    @property
    def topics(self) -> frozenset[str]:
        """Every topic and pattern that is named."""
        robots = self.robots.values()
        named = [topic for robot in robots for topic in (robot.odometry, robot.ground_truth)]
        named += [entry.topic for entry in self.ranges]
        named += [self.odometry, self.ground_truth]
        return frozenset(topic for topic in named if topic is not None)


def read_streams_file(source: Path | Document) -> StreamsFile:
    """A streams file. Raises UsageError naming the file and the key."""
    return parse_settings(StreamsFile, read_toml(source), str(source))
