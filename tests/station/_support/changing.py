"""Copied into the workspace of tests: a robot whose picture and place change when a setting does."""

import numpy as np

from robbie_mp import Module, setting
from robbie_mp.messages import EmergencyStop, Header, Image, Point, Pose, PoseStamped, replace


class Changing(Module):
    """Sends pictures of one grey, and says that it is at x = grey / 100."""

    grey: int = setting(40, "of the picture", changeable=True)
    period_s = 0.1

    def setup(self) -> None:
        self.engaged = False
        self.subscribe(EmergencyStop, self.on_stop, topic="emergency_stop")

    def on_stop(self, request: EmergencyStop) -> None:
        self.engaged = request.engaged

    def tick(self) -> None:
        data = np.full(32 * 32, self.grey, np.uint8)
        image = Image(height=32, width=32, encoding="mono8", step=32, data=data)
        self.publish(replace(image, header=Header(stamp=self.now())), topic="eye")
        pose = Pose(position=Point(x=self.grey / 100, y=2.0))
        at = Header(stamp=self.now(), frame_id="map")
        self.publish(PoseStamped(header=at, pose=pose), topic="map_pose")
        self.publish(EmergencyStop(engaged=self.engaged), topic="emergency_stop_state")
