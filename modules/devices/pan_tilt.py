"""The robot's pan-tilt unit."""

import math

import numpy as np

from robbie_mp import Header, Module, setting
from robbie_mp.messages import JointCommand, JointLimits, JointState, PanTiltCommand
from robbie_robots.hw.pan_tilt import PanTiltError, PanTiltLimits, PanTiltUnit
from robbie_robots.hw.simulation.pan_tilt import SimulatedPanTilt
from robbie_robots.modules.devices.command_age import LOOK_AGE_S, StaleCommand, left_s

TOPIC = "pan_tilt"
JOINTS = ["pan", "tilt"]


class PanTiltByHand:
    """Lets operators move a module's pan-tilt unit as they move other joints.

    The module follows `JointCommand` on the topic `pan_tilt`, besides `PanTiltCommand`; the newest counts.
    When a `JointCommand` expires, the unit stops where it is.

    Args:
        module: the module.
        unit: the unit.
        max_age_s: greatest age of what a command rests on.
    """

    def __init__(self, module: Module, unit: PanTiltUnit, max_age_s: float):
        self._module = module
        self._max_age_s = max_age_s
        self._unit = unit
        self._until_ns: float = math.inf
        self._offered: PanTiltLimits | None = None
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
        """Stop the unit if the last `JointCommand` has expired."""
        if self._module.clock.monotonic_ns() >= self._until_ns:
            self._until_ns = math.inf
            now = self._unit.read()
            self._unit.look(now.pan_rad, now.tilt_rad)

    def _on_direction(self, command: PanTiltCommand) -> None:
        if self._look(command, command.pan_rad, command.tilt_rad) is not None:
            self._until_ns = math.inf

    def _on_joints(self, command: JointCommand) -> None:
        goals = dict(zip(command.name, command.position.tolist(), strict=False))
        if len(goals) != len(command.position) or not set(goals) <= set(JOINTS):
            self._module.log.error(
                "ignored a command from %s: its joints are not pan and tilt", self._module.envelope.sender
            )
            return
        now = self._unit.read()
        left = self._look(command, goals.get("pan", now.pan_rad), goals.get("tilt", now.tilt_rad))
        if left is not None:
            self._until_ns = self._module.clock.monotonic_ns() + round(left * 1e9)

    def _look(self, command: JointCommand | PanTiltCommand, pan_rad: float, tilt_rad: float) -> float | None:
        """Turn the unit; return how long the command lasts, s, or None if it is not followed."""
        try:
            fresh_s = left_s(self._module, command, self._max_age_s)
            self._unit.look(pan_rad, tilt_rad)
        except (PanTiltError, StaleCommand) as error:
            self._module.log.error(
                "ignored an invalid command from %s: %s", self._module.envelope.sender, error
            )
            return None
        return fresh_s


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
        self.checkpoint({"direction": (state.pan_rad, state.tilt_rad)})
        self.status = f"pan {state.pan_rad:.2f} rad, tilt {state.tilt_rad:.2f} rad"
