"""The guard of a robot that is driven by hand: the same that checks navigation's commands."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Header, MessageHandling, Module
from robbie_mp.messages import LaserScan, TFMessage
from robbie_robots.modules.devices.command_age import age_of
from robbie_robots.modules.planar_messages import planar_mounts, sweep_of
from robbie_robots.workers.laser.laser_sweep import LaserSweep, MountedSweep
from robbie_robots.workers.navigation.collision_guard import CollisionGuard, GuardSettings


class HandGuard:
    """Slows and stops commands by hand as the newest scans of its lasers require.

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
        self._seen: dict[str, tuple[Header, LaserSweep] | None] = dict.fromkeys(topics)
        self._mounts: dict[str, NDArray[np.float64]] = {}
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
        topic, sweep = self._module.envelope.topic, sweep_of(scan)
        if not sweep.problem:  # an unusable one counts as none: the guard becomes blind
            self._seen[topic if topic in self._seen else ""] = scan.header, sweep

    def _see_mounts(self, message: TFMessage) -> None:
        self._mounts |= planar_mounts(message)

    @property
    def sees_for_s(self) -> float:
        """How long the oldest scan may still be driven by, s; 0 or less: the guard is blind."""
        ages_s = [
            math.inf if seen is None else age_of(self._module, seen[0].stamp) for seen in self._seen.values()
        ]
        return self._max_age_s - max(ages_s, default=-math.inf)

    def checked(self, linear_m_per_s: float, angular_rad_per_s: float) -> tuple[float, float]:
        """Return the speeds, reduced as the scans require; a robot without lasers drives unguarded."""
        points = self._guard.near_points(
            MountedSweep(sweep, self._mounts.get(header.frame_id, np.zeros(3)))
            for header, sweep in filter(None, self._seen.values())
        )
        return self._guard.checked(points, (linear_m_per_s, angular_rad_per_s))
