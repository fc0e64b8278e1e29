"""The robot's pan-tilt unit."""

import math
from collections.abc import Mapping

import numpy as np

from robbie_mp import Header, Module, setting
from robbie_mp.messages import JointCommand, JointLimits, JointState, PanTiltCommand
from robbie_robots.hw.pan_tilt import PanTiltError, PanTiltLimits, PanTiltUnit
from robbie_robots.hw.simulation.pan_tilt import SimulatedPanTilt
from robbie_robots.modules.devices.command_age import LOOK_AGE_S, StaleCommand, left_s
from robbie_robots.modules.devices.joint_control import JointControl, JointSource
from robbie_robots.modules.devices.joint_orders import JointOrders

TOPIC = "pan_tilt"
JOINTS = ["pan", "tilt"]


class PanTiltByHand:
    """Decides whom a module's pan-tilt unit follows, and lets operators move it as they move other joints.

    The module follows `PanTiltCommand`, and `JointCommand` on the topic `pan_tilt`. When a `JointCommand`
    expires, the unit stops where it is.

    While the emergency stop is engaged, the unit stands. While the robot holds or an operator drives, no
    module turns it; the newest `PanTiltCommand` is kept until it expires. The same holds while an operator
    turns it. See `JointControl` for the rest.

    Args:
        module: the module.
        unit: the unit.
        max_age_s: greatest age of what a command rests on.
    """

    def __init__(self, module: Module, unit: PanTiltUnit, max_age_s: float):
        self._module = module
        self._max_age_s = max_age_s
        self._unit = unit
        self._offered: PanTiltLimits | None = None
        self._until_s = math.inf
        self._control = JointControl(self._module.monotonic_s)
        self.orders = JointOrders(module, self._control, self._keep)
        module.subscribe(PanTiltCommand, self._on_direction, optional=True)
        module.subscribe(JointCommand, self._on_joints, topic=TOPIC, optional=True)

    def offer(self, limits: PanTiltLimits) -> None:
        """Publish the limits of the joints, if they have changed."""
        if limits != self._offered:
            self._offered = limits
            self._module.publish(
                JointLimits(
                    name=JOINTS,
                    lower=np.array([-limits.pan_rad, -limits.tilt_up_rad]),
                    upper=np.array([limits.pan_rad, limits.tilt_down_rad]),
                ),
                topic=TOPIC,
                latched=True,
            )

    def tick(self) -> None:
        """Stop the unit if the last `JointCommand` has expired; turn it where modules want, if they may."""
        now = self._unit.read()
        self._control.see(
            {"pan": (now.pan_rad, now.pan_rad_per_s), "tilt": (now.tilt_rad, now.tilt_rad_per_s)}
        )
        if self._module.monotonic_s() >= self._until_s:
            self._look({}, math.inf)
        self._look_where_modules_want()

    def _keep(self) -> None:
        self._look(self._control.kept, math.inf)

    def _on_direction(self, command: PanTiltCommand) -> None:
        try:
            until_s = self._module.monotonic_s() + left_s(self._module, command, self._max_age_s)
        except StaleCommand as error:
            self._log_invalid(error)
            return
        self._control.direct({"pan": command.pan_rad, "tilt": command.tilt_rad}, until_s)
        self._look_where_modules_want()

    def _look_where_modules_want(self) -> None:
        if goals := self._control.due_direction():
            self._look(goals, math.inf)

    def _on_joints(self, command: JointCommand) -> None:
        goals = dict(zip(command.name, command.position.tolist(), strict=False))
        sender = self._module.envelope.sender
        if len(goals) != len(command.position) or not set(goals) <= set(JOINTS):
            self._module.log.error("ignored a command from %s: its joints are not pan and tilt", sender)
            return
        try:
            until_s = self._module.monotonic_s() + left_s(self._module, command, self._max_age_s)
            sent_s = self._module.envelope.published_ns / 1e9
            source = JointSource(sender, command.by_hand)
            followed = self._control.followed(source, goals, sent_s, until_s)
            if followed is not None:
                self._look(followed, until_s)
        except (PanTiltError, StaleCommand) as error:
            self._log_invalid(error)

    def _look(self, goals: Mapping[str, float], until_s: float) -> None:
        """Turn the joints that have a goal, and stop the other."""
        now = self._unit.read()
        self._unit.look(goals.get("pan", now.pan_rad), goals.get("tilt", now.tilt_rad))
        self._until_s = until_s

    def _log_invalid(self, error: ValueError) -> None:
        self._module.log.error("ignored an invalid command from %s: %s", self._module.envelope.sender, error)


class SimulatedPanTiltModule(Module):
    """A simulated pan-tilt unit: follows `PanTiltCommand`, publishes `JointState` on topic `pan_tilt`.

    The joints are `pan` and `tilt`, and can also be moved by hand: see `PanTiltByHand`. A restarted unit
    keeps the direction of the last tick.
    """

    rate_rad_per_s: float = setting(2.0, "speed of each joint", minimum=0.01)
    period_s: float = setting(0.05, "time between messages", minimum=0.01)
    max_age_s: float = LOOK_AGE_S

    def setup(self) -> None:
        """Create the unit, looking straight ahead or where it looked before the restart."""
        limits = PanTiltLimits(rate_rad_per_s=self.rate_rad_per_s)
        pan_rad, tilt_rad = (0.0, 0.0) if self.restored is None else self.restored["direction"]
        self.unit = SimulatedPanTilt(self.monotonic_s, limits, (pan_rad, tilt_rad))
        self.by_hand = PanTiltByHand(self, self.unit, self.max_age_s)
        self.by_hand.offer(limits)

    def tick(self) -> None:
        """Publish and checkpoint the unit's direction."""
        self.by_hand.tick()
        state = self.unit.read()
        self.publish(
            JointState(
                header=Header(stamp=self.now()),
                name=JOINTS,
                position=np.array([state.pan_rad, state.tilt_rad]),
                velocity=np.array([state.pan_rad_per_s, state.tilt_rad_per_s]),
            ),
            topic=TOPIC,
        )
        direction = state.pan_rad, state.tilt_rad
        self.checkpoint({"direction": direction, "orders": self.by_hand.orders.memory})
        self.status = f"pan {state.pan_rad:.2f} rad, tilt {state.tilt_rad:.2f} rad"
