"""The limits that time and battery set to a mission."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from robbie_robots.workers.rescue.mission_states import MissionSettings

JUDGED_AFTER_S = 20.0
"""Minimum time of measurement before the mission trusts the rate at which the battery drains."""


class MissionLimits:
    """Decides when the robot must go home.

    Args:
        clock: Returns the time in s.
        settings: Limits, and the speed on the way home.
    """

    def __init__(self, clock: Callable[[], float], settings: MissionSettings) -> None:
        self._clock = clock
        self._settings = settings
        self._began_s = clock()
        self._held_since_s: float | None = None
        self._battery: list[tuple[float, float]] = []

    @property
    def used_s(self) -> float:
        """Return how long the mission has taken so far, without the time that it was held."""
        now_s = self._clock() if self._held_since_s is None else self._held_since_s
        return now_s - self._began_s

    @property
    def battery(self) -> float | None:
        """Return the battery's charge as a ratio. None before the first report."""
        return self._battery[-1][1] if self._battery else None

    @property
    def summary(self) -> str:
        """Return the remaining time and charge, in a few words."""
        battery = "" if self.battery is None else f", battery {self.battery:.0%}"
        return f"{self.used_s:.0f} s{battery}"

    @property
    def is_over(self) -> bool:
        """Return whether the time limit has passed."""
        return self.used_s >= self._settings.time_limit_s

    def begin(self) -> None:
        """Start counting the time now."""
        self._began_s = self._clock()

    def hold(self, *, is_held: bool) -> None:
        """Let the time stand, or run on."""
        if is_held and self._held_since_s is None:
            self._held_since_s = self._clock()
        elif not is_held and self._held_since_s is not None:
            self._began_s += self._clock() - self._held_since_s
            self._held_since_s = None

    def see_battery(self, ratio: float) -> None:
        """Record the battery's charge, as a ratio."""
        if math.isfinite(ratio):
            self._battery[1:] = [(self._clock(), ratio)]

    def battery_lasts_s(self) -> float:
        """Return how long the battery lasts down to its reserve if it keeps draining at the same rate."""
        if len(self._battery) < 2:
            return math.inf
        (first_s, first), (last_s, last) = self._battery
        if last <= self._settings.reserve:
            return 0.0
        if last_s - first_s < JUDGED_AFTER_S or last >= first:
            return math.inf
        return (last - self._settings.reserve) * (last_s - first_s) / (first - last)

    def must_return(self, way_home_m: float) -> str | None:
        """Return why the robot must go home now. None: it need not yet.

        Args:
            way_home_m: Cost of the way home. +inf: no way is known, which alone is no reason to go home.
        """
        way_s = way_home_m / self._settings.home_m_per_s if math.isfinite(way_home_m) else 0.0
        needed_s = way_s + self._settings.spare_s
        if self._settings.time_limit_s - self.used_s <= needed_s:
            return "the time is almost over"
        if self.battery_lasts_s() <= needed_s:
            return "the battery is almost empty"
        return None

    def memory(self) -> dict[str, Any]:
        """Return what a restarted mission needs to go on, as plain data."""
        now_s = self._clock()
        return {"used_s": self.used_s, "battery": [[now_s - at_s, ratio] for at_s, ratio in self._battery]}

    def remember(self, memory: Mapping[str, Any]) -> None:
        """Continue from the data that `memory` returned."""
        self._began_s = self._clock() - memory["used_s"]
        self._battery = [(self._clock() - age_s, ratio) for age_s, ratio in memory["battery"]]
