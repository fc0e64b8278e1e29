"""Hears a running rescue robot, whose devices are emulated, and pulls their plugs."""

import math
import random
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from robbie_mp.attached.tool.tool import Tool
from robbie_mp.messages import DeviceState, Imu, LaserScan, Message, Odometry, SettingChange
from tools.robot import RobotTrouble

MEASUREMENT: dict[str, tuple[type[Message], str]] = {
    "base": (Odometry, "odom"),
    "laser": (LaserScan, ""),
    "imu": (Imu, "imu"),
}
"""What each driver publishes."""
MOVES_M_PER_S, MOVES_RAD_PER_S = 0.05, 0.1
STANDS = 0.005
LIMIT_S = 30.0


@dataclass
class Replugs:
    """The times of one device, s.

    Attributes:
        told_s: from the pulling to the driver's DeviceState.
        back_s: from the plugging in to the next measurement.
        stands_s: from the pulling until the robot stood; only of the base, and if the robot moved.
        ways_m: how far it drove meanwhile.
        drives_s: from the plugging in until the robot moved again; only if it moved before.
        stale: measurements that were published after the loss was told and before the plug was in again.
    """

    told_s: list[float] = field(default_factory=list)
    back_s: list[float] = field(default_factory=list)
    stands_s: list[float] = field(default_factory=list)
    ways_m: list[float] = field(default_factory=list)
    drives_s: list[float] = field(default_factory=list)
    stale: int = 0


class Witness:
    """Hears what the robot's modules publish, and pulls plugs.

    Attributes:
        moves: whether the robot moves now.
        place: where it is.
        stood_ns: since when it stands, machine's monotonic clock.
    """

    def __init__(self, tool: Tool) -> None:
        self._tool = tool
        self.moves = False
        self.place = (0.0, 0.0)
        self.moved_ns = self.stood_ns = 0
        self.measured_ns = dict.fromkeys(MEASUREMENT, 0)
        self.measurements = dict.fromkeys(MEASUREMENT, 0)
        self.state_ns = dict.fromkeys(MEASUREMENT, 0)
        self.states = dict.fromkeys(MEASUREMENT, "")
        self._truth = tool.subscribe(Odometry.type_name, Odometry.version, "ground_truth")
        self._measured = {
            tool.subscribe(kind.type_name, kind.version, topic): name
            for name, (kind, topic) in MEASUREMENT.items()
        }
        for name in MEASUREMENT:
            tool.subscribe(DeviceState.type_name, DeviceState.version, name)
        tool.ready()

    def set_plug(self, device: str, is_in: bool) -> int:
        """Pull a plug, or plug it in; return when, ns."""
        change = SettingChange(request=1, setting="virtual_plug", value=str(is_in).lower())
        now_ns = time.monotonic_ns()
        if not self._tool.publish(change, f"{device}_emulator"):
            raise RobotTrouble("the wish to change a plug was refused")
        return now_ns

    def wait_for(self, condition: Callable[[], bool], what: str, limit_s: float = LIMIT_S) -> None:
        """Wait for a condition.

        Raises:
            RobotTrouble: it does not hold in time.
        """
        until_s = time.monotonic() + limit_s
        while not condition():
            if time.monotonic() > until_s:
                raise RobotTrouble(f"{what} within {limit_s:g} s: that did not happen")
            self._tool.wait(0.01)
            self._hear()

    def hear_for(self, seconds: float) -> None:
        """Listen for some time."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self._tool.wait(min(left_s, 0.01))
            self._hear()

    def _hear(self) -> None:
        while (received := self._tool.take()) is not None:
            if received.subscription == self._truth:
                self._see_truth(Odometry.decode(received.data), received.published_ns)
            elif received.subscription in self._measured:
                name = self._measured[received.subscription]
                self.measured_ns[name] = received.published_ns
                self.measurements[name] += 1
            else:
                state = DeviceState.decode(received.data).state
                if state != self.states[received.topic]:
                    self.states[received.topic] = state
                    self.state_ns[received.topic] = received.published_ns

    def _see_truth(self, truth: Odometry, published_ns: int) -> None:
        position = truth.pose.pose.position
        self.place = (position.x, position.y)
        linear, angular = abs(truth.twist.twist.linear.x), abs(truth.twist.twist.angular.z)
        if linear < STANDS and angular < STANDS:
            if self.moves:
                self.stood_ns = published_ns
            self.moves = False
        elif linear > MOVES_M_PER_S or angular > MOVES_RAD_PER_S:
            if not self.moves:
                self.moved_ns = published_ns
            self.moves = True


def replug(witness: Witness, device: str, chance: random.Random, replugs: Replugs) -> None:
    """Pull one plug at a random moment of motion, and plug it in again a while later."""
    witness.hear_for(chance.uniform(0.3, 0.8))
    if device == "base":
        witness.wait_for(lambda: witness.moves, "the robot moves", 120.0)
    moved, place = witness.moves, witness.place
    pulled_ns = witness.set_plug(device, is_in=False)
    witness.wait_for(
        lambda: witness.states[device] == "DISCONNECTED" and witness.state_ns[device] > pulled_ns,
        f"the robot is told of the loss of {device}",
    )
    replugs.told_s.append((witness.state_ns[device] - pulled_ns) / 1e9)
    if device == "base" and moved:
        witness.wait_for(lambda: not witness.moves, "the robot stands")
        replugs.stands_s.append(max(0, witness.stood_ns - pulled_ns) / 1e9)
        replugs.ways_m.append(math.dist(place, witness.place))
    count = witness.measurements[device]
    witness.hear_for(chance.uniform(0.0, 1.0))
    replugs.stale += witness.measurements[device] - count
    plugged_ns = witness.set_plug(device, is_in=True)
    witness.wait_for(lambda: witness.measured_ns[device] > plugged_ns, f"{device} is back")
    replugs.back_s.append((witness.measured_ns[device] - plugged_ns) / 1e9)
    if device != "imu" and moved:
        witness.wait_for(lambda: witness.moves, "the robot drives on", 120.0)
        replugs.drives_s.append(max(0, witness.moved_ns - plugged_ns) / 1e9)
