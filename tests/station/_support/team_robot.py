"""Copied into the workspace of tests: a robot of a team, whose base may be deaf."""

import numpy as np

from robbie_mp import Module, setting
from robbie_mp.messages import BatteryState, ControlSet, ControlState, EmergencyStop, Image, SetControl


class TeamRobot(Module):
    """Follows stops and orders to hold, except while the setting `is_deaf` says that it does not."""

    is_deaf: bool = setting(False, "whether it hears no stop", changeable=True)
    charge: float = setting(0.8, "of the battery, 0 to 1", changeable=True)
    period_s = 0.05

    def setup(self) -> None:
        self.engaged = False
        self.stops = 0
        self.mode = ControlState.AUTO
        self.subscribe(EmergencyStop, self.on_stop, topic="emergency_stop")
        self.serve(SetControl, self.on_control)

    def on_stop(self, request: EmergencyStop) -> None:
        self.stops += request.engaged
        if not self.is_deaf:
            self.engaged = request.engaged

    def on_control(self, request: SetControl) -> ControlSet:
        self.mode = request.mode
        return ControlSet(mode=request.mode)

    def tick(self) -> None:
        self.publish(EmergencyStop(engaged=self.engaged, reason="a test"), topic="emergency_stop_state")
        self.publish(ControlState(mode=self.mode), topic="control")
        self.publish(BatteryState(percentage=self.charge, voltage=24.0))
        data = np.full(64 * 64, 90, np.uint8)
        self.publish(Image(height=64, width=64, encoding="mono8", step=64, data=data), topic="eye")
        text = "STOPPED" if self.engaged else "ready"
        self.status = f"{text}, {'HOLD' if self.mode == ControlState.HOLD else 'AUTO'}, {self.stops} stops"
