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

A device that begins again (its time steps back by more than RESTART_S, or runs ahead of the host
by more than that) gets a new map once CONFIRMATIONS samples in a row agree on it; a single wild
time is stamped with its arrival. So does one whose clock stood still: all of a window comes later
than the map says by more than RESTART_S.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Self

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
        self._resumed = False
        """Nothing came since the log went on in a new file."""
        self._changed: list[MapSegment] = []

    @classmethod
    def resumed(cls, device: int, host: int, rate: float, stamp: int) -> Self:
        """The map as `state` gave it."""
        found = cls()
        found._begin(int(device), int(host))
        found._segment = (0, 0.0, min(max(float(rate), -MAX_RATE), MAX_RATE))
        found._latest = (int(device), int(stamp))
        found._resumed = True
        return found

    def state(self) -> tuple[int, int, float, int]:
        """Latest device time, the host's by the line in force, its rate, the latest stamp."""
        start = self._start or (0, 0)
        device, stamp = self._latest
        x = device - start[0]
        return device, start[1] + x + int(self._line(x) // 1), self._segment[2], stamp

    def stamps(self, times: Sequence[int], arrival: int) -> list[int]:
        """Host times of samples of these device times, which arrived together at `arrival`.

        All are used for the map before any is stamped, so that of bytes that had waited the latest
        sets the delay.
        """
        if self._start is None and len(times) > 0:
            self._begin(times[0], arrival)
        stamps = [arrival] * len(times)
        seen: dict[int, bool] = {}
        """Of this map: times and whether they are believed."""
        mapped: list[int] = []
        """Places of those that wait for their stamps."""
        for place, time in enumerate(times):
            if time not in seen:
                believed = self._observe(time, arrival)
                if believed is None:  # Those before belong to the map that ends here.
                    self._stamp_all(times, mapped, stamps)
                    seen, mapped = {}, []
                    self._restart(time, arrival)
                seen[time] = believed is not False
            if seen[time]:
                mapped.append(place)
        self._stamp_all(times, mapped, stamps)
        return stamps

    def _stamp_all(self, times: Sequence[int], places: Sequence[int], stamps: list[int]) -> None:
        for place in sorted(places, key=lambda one: times[one]):
            stamps[place] = self._stamp(times[place])

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

    def _restart(self, device: int, host: int) -> None:
        """The device began again at about this time."""
        self.restarts += 1
        self._begin(device, host)
        self._window_lowest = (0, 0)

    def _observe(self, device: int, host: int) -> bool | None:
        """Use one sample for the map; False where its time cannot be believed (yet).

        None: the device began again, and wants a new map.
        """
        start = self._start
        if start is None:
            return False
        x, r = device - start[0], (host - start[1]) - (device - start[0])
        if device < self._latest[0] - RESTART_S * NS or r < self._line(x) - RESTART_S * NS:
            if not self._resumed:
                return self._suspect(device, host)
            self._resumed = False  # Its decoder began to count its turns again.
            self._begin(device, host)
            return self._observe(device, host)
        self._suspects, self._resumed = [], False
        window = x // (WINDOW_S * NS)
        if window > self._window:
            if self._is_behind():
                return None
            self._turn(x, window)
        lowest = self._window_lowest
        if lowest is None or r < lowest[1]:
            self._window_lowest = (x, r)
        if r < self._line(x):
            self._segment = (x, float(r), self._segment[2])
            self._note()
        return True

    def _suspect(self, device: int, host: int) -> bool | None:
        """A time that does not fit: False; None once enough in a row agree."""
        near = RESTART_S * NS
        if len(self._suspects) > 0:
            last = self._suspects[-1]
            if abs((device - last[0]) - (host - last[1])) > near or device < last[0]:
                self._suspects = []
        self._suspects.append((device, host))
        return False if len(self._suspects) < CONFIRMATIONS else None

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
