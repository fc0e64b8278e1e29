"""The guard of a robot that is driven by hand: the same that checks navigation's commands."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from modules.devices.command_age import age_of
from modules.planar_messages import angles_rad, planar_mounts
from robbie_mp import MessageHandling, Module
from robbie_mp.messages import LaserScan, TFMessage
from workers.navigation.collision_guard import CollisionGuard, GuardSettings


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
        self._settings = GuardSettings(body_radius_m=radius_m)
        self._max_age_s = max_age_s
        self._scans: dict[str, LaserScan | None] = dict.fromkeys(topics)
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
        topic = self._module.envelope.topic
        self._scans[topic if topic in self._scans else ""] = scan

    def _see_mounts(self, message: TFMessage) -> None:
        self._mounts |= planar_mounts(message)

    @property
    def is_blind(self) -> bool:
        """Whether a laser of the guard has sent no scan lately."""
        return any(
            scan is None or age_of(self._module, scan.header.stamp) >= self._max_age_s
            for scan in self._scans.values()
        )

    def checked(self, linear_m_per_s: float, angular_rad_per_s: float) -> tuple[float, float]:
        """Return the speeds, reduced as the scans require; a robot without lasers drives unguarded."""
        scans = [scan for scan in self._scans.values() if scan is not None]
        if not scans:
            return linear_m_per_s, angular_rad_per_s
        guards = [
            CollisionGuard(
                angles_rad(scan), self._mounts.get(scan.header.frame_id, np.zeros(3)), self._settings
            )
            for scan in scans
        ]
        joined = guards[0]
        for further in guards[1:]:
            joined = joined.joined(further)
        ranges = np.concatenate([scan.ranges for scan in scans])
        return joined.checked(ranges, (linear_m_per_s, angular_rad_per_s))
