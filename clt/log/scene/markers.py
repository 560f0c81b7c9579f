"""Markers of a `visualization_msgs/msg/MarkerArray` at many times at once, as columns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from clt.core.arrays import Bytes, Floats, Stamps
from clt.log.cdr.writer import PayloadLayout, payload_layout, stamp_columns

ARROW, CUBE, CYLINDER, LINE_STRIP, LINE_LIST, TEXT = 0, 1, 3, 4, 5, 9
LINE_WIDTH = 0.03
"""Width of lines, m."""


@dataclass
class Markers:
    """The markers of k scenes; positions have shape (k, 2) in m, colours (3,) in 0..1."""

    at: Stamps
    """Stamps of the scenes, shape (k,)."""
    constants: dict[str, str | int] = field(default_factory=dict)
    columns: dict[str, ArrayLike] = field(default_factory=dict)
    count: int = 0

    def arrow(
        self,
        ns: str,
        number: int,
        frame: str,
        position: Floats,
        heading: Floats,
        color: Floats,
        alpha: ArrayLike = 1.0,
    ) -> None:
        """An arrow of 0.5 m along `heading` (k,), rad."""
        path = self.add(ARROW, ns, number, frame, (0.5, 0.12, 0.12))
        self.pose(path, position, 0.0, heading)
        self.color(path, color, alpha)

    def cube(self, ns: str, number: int, frame: str, position: Floats, color: Floats) -> None:
        """A cube of 0.3 m on the ground."""
        path = self.add(CUBE, ns, number, frame, (0.3, 0.3, 0.3))
        self.pose(path, position, 0.15)
        self.color(path, color)

    def text(
        self,
        ns: str,
        number: int,
        frame: str,
        position: Floats,
        text: str,
        alpha: ArrayLike = 1.0,
    ) -> None:
        """A text of 0.3 m above `position`."""
        path = self.add(TEXT, ns, number, frame, (0.0, 0.0, 0.3))
        self.constants[f"{path}.text"] = text
        self.pose(path, position, 0.6)
        self.color(path, np.full(3, 0.5), alpha)

    def disc(
        self,
        ns: str,
        number: int,
        frame: str,
        position: Floats,
        angle: Floats,
        axes: Floats,
        color: Floats,
        alpha: ArrayLike = 1.0,
    ) -> None:
        """A flat ellipse with half axes (k, 2), m, the first at `angle` (k,), rad."""
        path = self.add(CYLINDER, ns, number, frame, (0.0, 0.0, 0.01))
        self.columns[f"{path}.scale.x"] = np.maximum(2 * axes[:, 0], 1e-3)
        self.columns[f"{path}.scale.y"] = np.maximum(2 * axes[:, 1], 1e-3)
        self.pose(path, position, 0.0, angle)
        self.color(path, color, 0.3 * np.asarray(alpha))

    def line(self, ns: str, number: int, frame: str, points: Floats, color: Floats) -> None:
        """A line through `points` (k, p, 2)."""
        path = self.add(LINE_STRIP, ns, number, frame, (LINE_WIDTH, 0.0, 0.0))
        self.pose(path, np.zeros((self.at.size, 2)), 0.0)
        self.points(path, points)
        self.color(path, color)

    def links(self, ns: str, number: int, frame: str, points: Floats, colors: Floats) -> None:
        """Segments between `points` (k, 2 p, 2), each end with its colour (k, 2 p, 4)."""
        path = self.add(LINE_LIST, ns, number, frame, (LINE_WIDTH, 0.0, 0.0))
        self.pose(path, np.zeros((self.at.size, 2)), 0.0)
        self.points(path, points)
        self.constants[f"{path}.colors"] = colors.shape[1]
        self.columns[f"{path}.colors"] = colors
        self.color(path, np.ones(3))

    def add(
        self, kind: int, ns: str, number: int, frame: str, scale: tuple[float, float, float]
    ) -> str:
        """A new marker; returns its path."""
        path = f"markers.{self.count}"
        self.count += 1
        self.constants |= {f"{path}.header.frame_id": frame, f"{path}.ns": ns}
        self.columns |= stamp_columns(f"{path}.header.stamp", self.at)
        self.columns |= {f"{path}.id": number, f"{path}.type": kind}
        self.columns |= {f"{path}.scale.{axis}": s for axis, s in zip("xyz", scale, strict=True)}
        return path

    def pose(
        self, path: str, position: Floats, height: float, heading: Floats | float = 0.0
    ) -> None:
        """Where a marker is: position (k, 2) and height, m, heading (k,), rad."""
        half = np.asarray(heading) / 2
        self.columns |= {
            f"{path}.pose.position.x": position[:, 0],
            f"{path}.pose.position.y": position[:, 1],
            f"{path}.pose.position.z": height,
            f"{path}.pose.orientation.z": np.sin(half),
            f"{path}.pose.orientation.w": np.cos(half),
        }

    def points(self, path: str, points: Floats) -> None:
        """Points (k, p, 2) of a marker, m."""
        self.constants[f"{path}.points"] = points.shape[1]
        self.columns[f"{path}.points"] = np.pad(points, ((0, 0), (0, 0), (0, 1)))

    def color(self, path: str, color: Floats, alpha: ArrayLike = 1.0) -> None:
        """Colour of a marker; alpha may be one number or one per scene."""
        self.columns |= {
            f"{path}.color.{part}": value for part, value in zip("rgb", color, strict=True)
        }
        self.columns[f"{path}.color.a"] = alpha

    def layout(self) -> PayloadLayout:
        """The layout of the message so far."""
        name = "visualization_msgs/msg/MarkerArray"
        return payload_layout(name, {"markers": self.count, **self.constants})

    def rows(self) -> Bytes:
        """The payloads, shape (k, size)."""
        return self.layout().rows(self.at.size, self.columns)
