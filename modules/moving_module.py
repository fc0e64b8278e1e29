"""The base of modules by whose decisions the robot moves: it holds first if their state was lost."""

from functools import cached_property

from robbie_mp import Module
from robbie_mp.messages import ControlSet, ControlState, SetControl
from robbie_robots.modules.errand import Errand

LOST = "{} may order what was done before: its newest checkpoint was damaged or is gone"
REPEAT_S = 0.5
"""Time after which the order to hold is given again, as long as no base has followed it."""


class MovingModule(Module):
    """A module by whose decisions the robot moves. A subclass defines `act` in place of `tick`.

    Where the module's newest checkpoint was damaged or is gone, it may want what was done or cancelled long
    ago. Then it first orders the robot to hold, until somebody orders the robot to go on.
    """

    def tick(self) -> None:
        """Act, unless the robot must hold first."""
        if not self.checkpoint_lost:
            self.act()
            return
        order = SetControl(mode=ControlState.HOLD, reason=LOST.format(self.name))
        # Repeated for a base that is missing, too: it may be back soon, and let the robot move.
        self._hold_first.want("hold", order, self._on_held)
        self.status = "waits until the robot holds, because the module's newest checkpoint was lost"

    def act(self) -> None:
        """Do the module's periodic work, as `tick` of other modules."""

    def checkpoint(self, state: object) -> bool:
        """Store a state, but not before the robot holds: a process that follows must know of the loss."""
        return not self.checkpoint_lost and super().checkpoint(state)

    @cached_property
    def _hold_first(self) -> Errand:
        return Errand(self, REPEAT_S)

    def _on_held(self, _reply: ControlSet) -> None:
        self.checkpoint_lost = False
