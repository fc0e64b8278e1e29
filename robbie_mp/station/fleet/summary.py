"""What this robot tells the pages of others: how it is, and a small picture."""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from robbie_mp.messages import BatteryState, CompressedImage, ControlState, RobotAlarm, RobotSummary, uint8
from robbie_mp.station.context import header_of_now
from robbie_mp.station.fleet.topics import PREVIEW, SUMMARY
from robbie_mp.station.page.control_bar import MODES
from robbie_mp.station.page.control_bar import TOPIC as CONTROL_TOPIC
from robbie_mp.station.page.state_strip import MISSION
from robbie_mp.station.watch.pictures import Grade

if TYPE_CHECKING:
    from collections.abc import Callable

    from robbie_mp.station.context import StationContext
    from robbie_mp.station.fleet.robots import OtherRobots
    from robbie_mp.station.module import Publish
    from robbie_mp.station.page.identity import Identity
    from robbie_mp.station.page.state_strip import StateStrip
    from robbie_mp.station.watch.pictures import NewestPicture

PERIOD_S = 0.5
PREVIEW_S = 1.0
PREVIEW_GRADE = Grade(320, 45, 7.0)
MAX_ALARMS = 5
OLD_S = 10.0
"""A battery that has been silent for this time is not known."""


class SummaryTeller:
    """Publishes them; called in the module's thread.

    Args:
        station: source of messages.
        team: shows the same on this robot's pages.
        strip: knows state and alarms.
        identity: the robot's name and colour.
        page: returns the address of this robot's page.
        publish: publishes a message, in any thread.
    """

    def __init__(
        self,
        station: StationContext,
        team: OtherRobots,
        strip: StateStrip,
        identity: Identity,
        page: Callable[[], str],
        publish: Publish,
    ):
        self._clock, self._cameras = station.clock, station.robot.cameras
        self._strip, self._identity, self._page, self._publish = strip, identity, page, publish
        self._battery = station.messages.newest(BatteryState)
        self._control = station.messages.newest(ControlState, CONTROL_TOPIC)
        self._team = team
        self._next_s = self._next_preview_s = 0.0
        self._shown: tuple[str, int] = ("", 0)
        self._encoder = ThreadPoolExecutor(1, "encodes previews")

    @property
    def summary(self) -> RobotSummary:
        """How the robot is now."""
        battery, control = self._battery.message, self._control.message
        is_known = battery is not None and (self._battery.age_s or 0.0) < OLD_S
        mission = next((one.text for one in self._strip.items if one.name == MISSION), "")
        return RobotSummary(
            header=header_of_now(self._clock),
            robot=self._identity.name,
            colour=self._identity.colour,
            page=self._page(),
            mode="" if control is None else MODES.get(control.mode, ""),
            state=mission,
            battery=battery.percentage if battery is not None and is_known else math.nan,
            alarms=[
                RobotAlarm(level=uint8(one.cause.level), text=one.cause.sentence)
                for one in self._strip.alarms.all
                if one.is_active
            ][:MAX_ALARMS],
        )

    @property
    def camera(self) -> str:
        """The camera whose pictures the others see; '' before the first picture."""
        return next(iter(sorted(self._cameras.found)), "")

    def tick(self) -> None:
        """Tell what is due."""
        now_s = time.monotonic()
        if now_s >= self._next_s:
            self._next_s = now_s + PERIOD_S
            self._team.own, self._team.own_camera = self.summary, self.camera
            self._publish(self._team.own, topic=SUMMARY)
        found = self._cameras.found.get(self.camera)
        if found is None or now_s < self._next_preview_s:
            return
        newest = (self.camera, found.picture.count)
        if newest != self._shown:
            self._next_preview_s, self._shown = now_s + PREVIEW_S, newest
            self._encoder.submit(self._tell_picture, found.picture)

    def _tell_picture(self, picture: NewestPicture) -> None:
        """Encode and publish a picture; runs in a thread of its own."""
        data = picture.encoded(PREVIEW_GRADE).data
        if data:
            pixels = np.frombuffer(data, np.uint8)
            message = CompressedImage(header=header_of_now(self._clock), format="jpeg", data=pixels)
            self._publish(message, topic=PREVIEW)

    def close(self) -> None:
        """Encode no more."""
        self._encoder.shutdown(cancel_futures=True)
