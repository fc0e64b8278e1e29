"""Stops joints, and lets them go on, as the base tells. A restarted module knows what the base told last."""

from collections.abc import Callable

from robbie_mp import MessageHandling, Module
from robbie_mp.messages import ControlState, EmergencyStop
from robbie_robots.modules.devices.joint_control import JointControl


class JointOrders:
    """Binds the joints of a module to the emergency stop, and to who controls the robot.

    A module that was restarted resumes the `orders` of its checkpoint.

    Args:
        module: the module of the joints.
        control: decides whose commands they follow.
        keep: keeps the joints where they are.

    Attributes:
        mode: the last control mode that the base published (`ControlState`); None before the first.
    """

    def __init__(self, module: Module, control: JointControl, keep: Callable[[], None]):
        self._module, self._control, self._keep = module, control, keep
        self.mode: int | None = None
        newest = MessageHandling.KEEP_ONLY_NEWEST
        module.subscribe(
            EmergencyStop, self._on_emergency_stop, newest, topic="emergency_stop_state", optional=True
        )
        module.subscribe(ControlState, self._on_control, newest, topic="control", optional=True)
        # The base may have died as well, and be back later than this module.
        if isinstance(module.restored, dict):
            self._resume(**module.restored["orders"])

    @property
    def memory(self) -> dict[str, object]:
        """The last orders of the base. The module stores them as `orders` in its checkpoint."""
        return {"is_stopped": self._control.is_stopped, "mode": self.mode}

    def _resume(self, *, is_stopped: bool, mode: int | None) -> None:
        self.mode = mode
        if is_stopped:
            self._control.stop()
        if mode not in (None, ControlState.AUTO):
            self._control.hold(hands_too=mode == ControlState.HOLD)

    def _on_emergency_stop(self, state: EmergencyStop) -> None:
        """Stop the joints at once, and keep them there, or let them follow new commands."""
        if not state.engaged:
            self._control.release()
        elif not self._control.is_stopped:
            self._control.stop()
            self._keep()

    def _on_control(self, state: ControlState) -> None:
        """Keep the joints where they are while an operator drives or the robot holds, unless by hand."""
        self.mode = state.mode
        if state.mode == ControlState.AUTO:
            self._control.go_on()
            return
        hands_too = state.mode == ControlState.HOLD and state.who != self._module.name
        if self._control.hold(hands_too=hands_too):
            self._keep()
