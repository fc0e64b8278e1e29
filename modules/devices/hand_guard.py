"""The guard of a robot that is driven by hand: the same that checks navigation's commands."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_mp import MessageHandling, Module, Time
from robbie_mp.messages import LaserScan, TFMessage
from robbie_robots.modules.devices.command_age import AHEAD_S, age_of, waiting_s
from robbie_robots.modules.maps.planar_messages import LASER, planar_mounts, sweep_of
from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep
from robbie_robots.workers.navigation.collision_guard import CollisionGuard, GuardSettings

ON_THE_ROBOT = {frame: np.zeros(3) for frame in (LASER, "base_link", "")}
"""Frames that need no mounting pose."""
MAX_LASERS = 8
"""Where the topic is '': further ones are not looked at."""


class _Seen(NamedTuple):
    """The newest usable scan of a laser."""

    sweep: LaserSweep
    frame: str
    stamp: Time
    published_s: float


class HandGuard:
    """Slows and stops commands by hand as the newest scans of its lasers require.

    It is blind unless the scans of all lasers are fresh and it knows where these are mounted. Where the topic
    is '', that is asked of every laser that has sent.

    Args:
        module: the module that follows the commands; the guard subscribes for it.
        topics: the topics of the lasers.
        radius_m: radius of the robot's body.
        max_age_s: age at which a scan is too old to drive by.
    """

    def __init__(self, module: Module, topics: Sequence[str], radius_m: float, max_age_s: float) -> None:
        self._module = module
        self._guard = CollisionGuard(GuardSettings(body_radius_m=radius_m))
        self._max_age_s = max_age_s
        self._seen: dict[str, _Seen | None] = dict.fromkeys(topics)
        self._mounts: dict[str, NDArray[np.float64]] = dict(ON_THE_ROBOT)
        for topic in topics:
            module.subscribe(
                LaserScan,
                self._see_scan,
                MessageHandling.KEEP_ONLY_NEWEST,
                topic=topic,
                deadline_s=max_age_s,
            )
        if topics:
            module.subscribe(TFMessage, self._see_mounts, topic="tf_static", optional=True)

    def _see_scan(self, scan: LaserScan) -> None:
        sweep = sweep_of(scan)
        if sweep.problem:  # an unusable one counts as none: the guard becomes blind
            return
        topic = self._module.envelope.topic
        if topic not in self._seen and self._seen.get("", scan) is None:
            del self._seen[""]  # it stood for those whose topics are known from now on
        published_s = self._module.monotonic_s() - waiting_s(self._module)
        if topic in self._seen or len(self._seen) < MAX_LASERS:
            self._seen[topic] = _Seen(sweep, scan.header.frame_id, scan.header.stamp, published_s)

    def _see_mounts(self, message: TFMessage) -> None:
        self._mounts |= planar_mounts(message)

    @property
    def sees_for_s(self) -> float:
        """How long the oldest scan may still be driven by, s; 0 or less: the guard is blind."""
        ages_s = [math.inf if seen is None else self._age_s(seen) for seen in self._seen.values()]
        return self._max_age_s - max(ages_s, default=-math.inf)

    def _age_s(self, seen: _Seen) -> float:
        """Return the age of a scan; infinite if it cannot be driven by."""
        # A stamp alone does not tell: the clock may be set, and a laser's clock may be ahead.
        age_s = age_of(self._module, seen.stamp)
        if age_s < -AHEAD_S or seen.frame not in self._mounts:
            return math.inf
        return max(age_s, self._module.monotonic_s() - seen.published_s)

    def checked(self, linear_m_per_s: float, angular_rad_per_s: float) -> tuple[float, float]:
        """Return the speeds, reduced as the scans require; a robot without lasers drives unguarded."""
        points = self._guard.near_points(self._mounted())
        return self._guard.checked(points, (linear_m_per_s, angular_rad_per_s))

    def _mounted(self) -> Iterator[MountedSweep]:
        for seen in filter(None, self._seen.values()):
            if seen.frame in self._mounts:
                yield MountedSweep(seen.sweep, self._mounts[seen.frame])
