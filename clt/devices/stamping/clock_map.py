r"""From the time of a device to the clock of the host, by minimum delay.

A sample that was true at device time d arrives at host time h > d's true instant: delays are only
ever positive. With x = d - d_0 and r = (h - h_0) - x for the first sample (d_0, h_0),

    r_k = o + g x_k + delay_k,      delay_k >= 0,

where o is a constant offset and g the relative rate of the two clocks. The line below all points
(x_k, r_k) that lies closest to them,

    min sum_w (r_w - a - b x_w)   subject to   r_w >= a + b x_w,   |b| <= MAX_RATE,

is the linear programme of Moon, Skelly and Towsley ("Estimation and removal of clock skew from
network delay measurements", INFOCOM 1999). Its solution is the edge of the lower convex hull of the
points that spans their mean x. Only the lowest point of each WINDOW_S is kept, for WINDOWS of them,
so that memory is bounded and a rate that drifts slowly is followed. What stays in the estimate is
the least delay, which no passive observer can know.

The map in force is causal and steady: it falls at once where a sample arrives sooner than it says
(a stamp is never later than the arrival), and turns towards the newest line only when a window
ends, by its rate, so that it never jumps upwards. Stamps of increasing device times increase.

A device that begins again (its time steps back by more than RESTART_S, or runs ahead of the host by
more than that) gets a new map once CONFIRMATIONS samples in a row agree on it; a single wild time
is stamped with its arrival. So does one whose clock stood still: all of a window comes later than
the map says by more than RESTART_S.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

WINDOW_S = 10
WINDOWS = 30
MAX_RATE = 5e-4
"""Relative; oscillators keep 1e-4."""
RATE_WINDOWS = 3
"""Windows that must have been seen before a rate is estimated."""
RESTART_S = 1
CONFIRMATIONS = 3
NS = 1_000_000_000

Point = tuple[int, int]
"""x and r, ns."""


class MapSegment(NamedTuple):
    """host time = host + (1 + rate) (device time - device), from here on; ns."""

    device: int
    host: int
    rate: float
    restart: int


def lower_line(points: Sequence[Point]) -> tuple[float, float]:
    """The line (a, b), r = a + b x, below all points and closest to them; |b| <= MAX_RATE.

    `points` in increasing x, at least one.
    """
    hull: list[Point] = []
    for x, r in points:
        while len(hull) >= 2 and _not_below(hull[-2], hull[-1], (x, r)):
            hull.pop()
        hull.append((x, r))
    mean = sum(x for x, _ in points) / len(points)
    rate = 0.0
    for (x0, r0), (x1, r1) in pairwise(hull):
        if x1 > x0:
            rate = (r1 - r0) / (x1 - x0)
        if x1 >= mean:
            break
    rate = min(max(rate, -MAX_RATE), MAX_RATE)
    return min(r - rate * x for x, r in points), rate


def _not_below(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


class ClockMap:
    """The map of one clock. Times in ns."""

    def __init__(self) -> None:
        self.restarts = 0
        self._start: Point | None = None
        """d_0 and h_0."""
        self._segment = (0, 0.0, 0.0)
        """x, r and rate of the line in force."""
        self._lowest: deque[Point] = deque(maxlen=WINDOWS)
        self._window = 0
        self._window_lowest: Point | None = None
        self._suspects: list[Point] = []
        self._latest = (0, 0)
        """Largest device time and its stamp."""
        self._changed: list[MapSegment] = []

    def stamps(self, times: Sequence[int], arrival: int) -> list[int]:
        """Host times of samples of these device times, which arrived together at `arrival`.

        All are used for the map before any is stamped, so that of bytes that had waited the latest
        sets the delay.
        """
        if self._start is None and len(times) > 0:
            self._begin(times[0], arrival)
        wild: set[int] = set()
        known: dict[int, int] = {}
        for time in times:
            if time not in known:
                known[time] = 0
                if not self._observe(time, arrival):
                    wild.add(time)
        for time in sorted(known):
            known[time] = arrival if time in wild else self._stamp(time)
        return [known[time] for time in times]

    def changes(self) -> list[MapSegment]:
        """The segments that came into force since this was asked last."""
        changed, self._changed = self._changed, []
        return changed

    def _begin(self, device: int, host: int) -> None:
        self._start = (device, host)
        self._segment = (0, 0.0, 0.0)
        self._lowest.clear()
        self._window, self._window_lowest = 0, None
        self._suspects = []
        self._latest = (device - 1, max(self._latest[1], 0))
        self._note()

    def _observe(self, device: int, host: int) -> bool:
        """Use one sample for the map; False where its time cannot be believed (yet)."""
        start = self._start
        if start is None:
            return False
        x, r = device - start[0], (host - start[1]) - (device - start[0])
        if device < self._latest[0] - RESTART_S * NS or r < self._line(x) - RESTART_S * NS:
            return self._suspect(device, host)
        self._suspects = []
        window = x // (WINDOW_S * NS)
        if window > self._window:
            if self._is_behind():
                self.restarts += 1
                self._begin(device, host)
                return self._observe(device, host)
            self._turn(x, window)
        lowest = self._window_lowest
        if lowest is None or r < lowest[1]:
            self._window_lowest = (x, r)
        if r < self._line(x):
            self._segment = (x, float(r), self._segment[2])
            self._note()
        return True

    def _suspect(self, device: int, host: int) -> bool:
        """A time that does not fit; begin again once enough in a row agree."""
        near = RESTART_S * NS
        if len(self._suspects) > 0:
            last = self._suspects[-1]
            if abs((device - last[0]) - (host - last[1])) > near or device < last[0]:
                self._suspects = []
        self._suspects.append((device, host))
        if len(self._suspects) < CONFIRMATIONS:
            return False
        self.restarts += 1
        self._begin(device, host)
        self._window_lowest = (0, 0)
        return True

    def _turn(self, x: int, window: int) -> None:
        """A window ended: aim at the newest line, to be met at the end of the next one."""
        if self._window_lowest is not None:
            self._lowest.append(self._window_lowest)
        self._window, self._window_lowest = window, None
        here = self._line(x)
        if len(self._lowest) >= RATE_WINDOWS:
            a, b = lower_line(self._lowest)
        else:
            a, b = float(min(r for _, r in self._lowest)) if len(self._lowest) > 0 else here, 0.0
        aim = a + b * (x + WINDOW_S * NS)
        rate = (aim - here) / (WINDOW_S * NS)
        self._segment = (x, here, min(max(rate, -MAX_RATE), MAX_RATE))
        self._note()

    def _is_behind(self) -> bool:
        """Whether all of a window arrived later than the map says by more than RESTART_S."""
        lowest = self._window_lowest
        return lowest is not None and lowest[1] > self._line(lowest[0]) + RESTART_S * NS

    def _line(self, x: int) -> float:
        at, r, rate = self._segment
        return r + rate * (x - at)

    def _stamp(self, device: int) -> int:
        """Increasing with the device's time, even where the map just fell."""
        start = self._start
        if start is None:
            return 0
        latest, latest_stamp = self._latest
        if device == latest:
            return latest_stamp
        x = device - start[0]
        stamp = start[1] + x + int(self._line(x) // 1)
        if device < latest:
            return min(stamp, latest_stamp)
        stamp = max(stamp, latest_stamp + 1)
        self._latest = (device, stamp)
        return stamp

    def _note(self) -> None:
        start = self._start
        if start is not None:
            x, r, rate = self._segment
            host = start[1] + x + int(r // 1)
            self._changed.append(MapSegment(start[0] + x, host, rate, self.restarts))
