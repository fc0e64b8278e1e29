"""When a device measured, by the host's clock: better than the time of arrival.

Source: S. B. Moon, P. Skelly, D. Towsley, Estimation and removal of clock skew from network delay
measurements, IEEE INFOCOM 1999. A message is never early, and some messages are hardly late. So the true
relation of the two clocks lies just below all pairs of stamp and delay. The line below them that is nearest
to them is an edge of their lower convex hull: the one over the mean of the stamps.

With jitter up to 2 ms and 3 % of the frames late besides, stamps are within 1 ms. A device that rounds its
stamps adds as much as it rounds.
"""

import math

# Drift is estimated from the arrivals of this time, one of each bucket: the least late.
WINDOW_S = 60.0
BUCKET_S = 0.5
# Before the hull spans this time, its slope would be mostly noise: the clocks count as equally fast.
MIN_SPAN_S = 8.0
# Later, too, a line loses by its slope, as if the mean of the stamps were earlier by this number of frames if
# it rises, or later if it falls: few frames tell little of a slope.
STEADY_FRAMES = 4
# Crystals and ceramic resonators differ by less than this.
MAX_DRIFT = 2e-3


class DeviceClock:
    """Converts the stamps of a device's clock to the host's clock.

    Delays may jitter and some frames may come very late: what counts is that some are hardly late. A constant
    delay (the time of transmission, mainly) cannot be seen; tell it.

    Args:
        wraps_at_s: the device's stamps begin again at 0 when they reach this; None: they never do.
        resolution_s: step of the device's stamps, which it rounds down.
        latency_s: the shortest time between a stamp and the arrival of its frame.
        max_late_s: stamps that leap farther than this mean that the device was restarted.
        max_drift: how much the clocks may differ in rate.

    Example:
        clock = DeviceClock(wraps_at_s=16_777.216, resolution_s=0.001)
        stamp_s = clock.stamp_s(device_s=12.345, arrived_s=time.monotonic())
    """

    def __init__(
        self,
        wraps_at_s: float | None = None,
        resolution_s: float = 0.0,
        latency_s: float = 0.0,
        max_late_s: float = 1.0,
        max_drift: float = MAX_DRIFT,
    ) -> None:
        self.restarts = 0
        """How often the device's clock was found to have leapt."""
        self._wraps_at_s, self._max_late_s, self._max_drift = wraps_at_s, max_late_s, max_drift
        self._correction_s = resolution_s / 2 - latency_s
        self._last_s = -math.inf
        self.forget()

    @property
    def drift(self) -> float:
        """Return how much slower than the host's the device's clock is: 1e-4 for 0.1 ms each second."""
        return self._slope

    def forget(self) -> None:
        """Start again, for example because the device was connected again."""
        self._wrapped_s = 0.0
        self._device_s: float | None = None
        self._buckets: list[tuple[float, float]] = []
        self._frames = 0
        self._intercept_s = self._slope = self._origin_s = 0.0
        self._arrived_s = -math.inf

    def stamp_s(self, device_s: float, arrived_s: float) -> float:
        """Return when, by the host's clock, the device's clock showed `device_s`.

        Args:
            device_s: the device's stamp, as it was sent.
            arrived_s: when its frame arrived, by the host's clock.

        Returns:
            Never later than `arrived_s`; never earlier than the stamp before, unless the host's clock was
            set back.
        """
        unwrapped_s = self._unwrapped(device_s)
        if self._has_leapt(unwrapped_s, arrived_s):
            self.restarts += 1
            self.forget()
            unwrapped_s = self._unwrapped(device_s)
        self._add(unwrapped_s, arrived_s - unwrapped_s)
        estimate_s = unwrapped_s + self._offset_s(unwrapped_s) + self._correction_s
        if arrived_s < self._arrived_s:
            self._last_s = -math.inf
        self._device_s, self._arrived_s = unwrapped_s, arrived_s
        self._last_s = min(arrived_s, max(self._last_s, estimate_s))
        return self._last_s

    def earliest_s(self, device_s: float) -> float:
        """Return the earliest time at which a frame with a stamp can arrive, as far as it is known.

        Args:
            device_s: the stamp, on a clock without wraps.
        """
        return device_s + self._offset_s(device_s)

    def _unwrapped(self, device_s: float) -> float:
        """Return the stamp with the wraps so far added."""
        unwrapped_s = device_s + self._wrapped_s
        if self._wraps_at_s is None or self._device_s is None:
            return unwrapped_s
        if unwrapped_s < self._device_s - self._wraps_at_s / 2:
            self._wrapped_s += self._wraps_at_s
            return unwrapped_s + self._wraps_at_s
        return unwrapped_s

    def _has_leapt(self, device_s: float, arrived_s: float) -> bool:
        """Return whether time passed differently on the two clocks, far beyond any delay."""
        if self._device_s is None:
            return False
        passed_s, arrived_passed_s = device_s - self._device_s, arrived_s - self._arrived_s
        return (
            passed_s < 0 or abs(arrived_passed_s - passed_s) > self._max_late_s + self._max_drift * passed_s
        )

    def _offset_s(self, device_s: float) -> float:
        return self._intercept_s + self._slope * (device_s - self._origin_s)

    def _add(self, device_s: float, delay_s: float) -> None:
        """Take a pair of stamp and delay into account, if it can change the line."""
        buckets = self._buckets
        self._frames += 1
        if not buckets:
            self._origin_s = device_s
        bucket = math.floor((device_s - self._origin_s) / BUCKET_S)
        if buckets and math.floor((buckets[-1][0] - self._origin_s) / BUCKET_S) == bucket:
            if delay_s >= buckets[-1][1]:
                return
            buckets[-1] = device_s, delay_s
        else:
            buckets.append((device_s, delay_s))
        while buckets[-1][0] - buckets[0][0] > WINDOW_S:
            del buckets[0]
        self._fit()

    def _fit(self) -> None:
        """Put the line below all pairs, as near to them as possible."""
        pairs = self._buckets
        self._slope = 0.0
        if pairs[-1][0] - pairs[0][0] >= MIN_SPAN_S:
            hull = lower_hull(pairs)
            mean_s = sum(stamp for stamp, _ in pairs) / len(pairs)
            steady_s = STEADY_FRAMES * (pairs[-1][0] - self._origin_s) / self._frames
            # The slopes of a hull's edges grow from left to right.
            rises = max(0.0, slope_over(hull, mean_s - steady_s))
            falls = min(0.0, slope_over(hull, mean_s + steady_s))
            self._slope = min(max(rises + falls, -self._max_drift), self._max_drift)
        self._intercept_s = min(delay - self._slope * (stamp - self._origin_s) for stamp, delay in pairs)


def slope_over(hull: list[tuple[float, float]], x: float) -> float:
    """Return the slope of a hull's edge over x; 0 outside the hull."""
    if not hull[0][0] < x <= hull[-1][0]:
        return 0.0
    right = next(index for index in range(1, len(hull)) if hull[index][0] >= x)
    (x0, y0), (x1, y1) = hull[right - 1], hull[right]
    return (y1 - y0) / (x1 - x0)


def lower_hull(pairs: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the lower convex hull of points with rising x, left to right (Andrew's monotone chain)."""
    hull: list[tuple[float, float]] = []
    for x, y in pairs:
        while len(hull) > 1:
            (x0, y0), (x1, y1) = hull[-2:]
            if (x1 - x0) * (y - y0) > (y1 - y0) * (x - x0):
                break
            hull.pop()
        hull.append((x, y))
    return hull


class RegularClock:
    """Stamps for a device that measures at a fixed period and does not tell the time.

    Counts the periods in place of a clock. A frame is never early: one that comes before its time shows that
    too many periods were counted, at once. One that comes late may only be late; not before all frames have
    been late for a while, or if bytes were found damaged, frames count as lost.

    Args:
        period_s: time between measurements.
        latency_s: the shortest time between a measurement and the arrival of its frame.
        periods_per_frame: periods from frame to frame, if the line is too slow for each to have one. Rather
            too many than too few.
        max_drift: how wrong the period may be, as a share of it.
    """

    # If all frames of LATE_S, and at least LATE_FRAMES, are late, the estimate is wrong: it is not chance.
    LATE_S = 1.0
    LATE_FRAMES = 8
    # Even if the period is shorter: that much earlier than ever is not too early.
    TOLERANCE_S = 0.0005

    def __init__(
        self,
        period_s: float,
        latency_s: float = 0.0,
        periods_per_frame: int = 1,
        max_drift: float = MAX_DRIFT,
    ) -> None:
        self._period_s, self._periods_per_frame = period_s, periods_per_frame
        self._clock = DeviceClock(latency_s=latency_s, max_drift=max_drift)
        self.forget()

    def set_period(self, period_s: float) -> None:
        """Start again with another period, because the device has reported it."""
        self._period_s = period_s
        self.forget()

    def forget(self) -> None:
        """Start again, for example because the device was connected again."""
        self._clock.forget()
        self._count: int | None = None
        self._late: list[int] = []
        self._late_since_s = 0.0

    def stamp_s(self, arrived_s: float, frames: int = 1, has_gap: bool = False) -> float:
        """Return when the newest frame was measured, by the host's clock.

        Args:
            arrived_s: when it arrived.
            frames: how many have arrived since the last call, with it.
            has_gap: others may have been lost before it.
        """
        if self._count is None:
            self._count = 0
        else:
            expected = self._count + frames * self._periods_per_frame
            late_s = arrived_s - self._clock.earliest_s(expected * self._period_s)
            self._count = max(self._count + 1, expected + self._lost(late_s, arrived_s, has_gap))
        return self._clock.stamp_s(self._count * self._period_s, arrived_s)

    def _lost(self, late_s: float, arrived_s: float, has_gap: bool) -> int:
        """Return how many periods to add to the count; negative if it was too high."""
        late = round(late_s / self._period_s)
        if late <= 0 or has_gap:
            self._late.clear()
            return late if has_gap or late_s < -self.TOLERANCE_S else 0
        if not self._late:
            self._late_since_s = arrived_s
        self._late.append(late)
        if len(self._late) < self.LATE_FRAMES or arrived_s < self._late_since_s + self.LATE_S:
            return 0
        lost = min(self._late)
        self._late.clear()
        return lost
