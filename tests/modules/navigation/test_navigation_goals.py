"""The client's side of navigation."""

import numpy as np

from robbie_mp import Module, ModuleHarness
from robbie_mp.messages import ControlSet, ControlState, NavigateTo, SetControl
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals

AT = np.array([1.0, 2.0, 0.0])


class Traveller(Module):
    """Wants to drive to one goal."""

    period_s = 0.1

    def setup(self) -> None:
        self.goals = NavigationGoals(self, lambda: None, lambda _reason: None, lambda _reason: None)

    def tick(self) -> None:
        self.goals.drive_to(AT, (0.0, 0.0, 0.0))


def test_goal_is_sent_at_once() -> None:
    with ModuleHarness(Traveller) as traveller:
        traveller.advance(0.1)
        assert len(traveller.take(NavigateTo)) == 1
        assert not traveller.take(SetControl)


def test_module_whose_newest_checkpoint_is_lost_lets_the_robot_hold_before_it_sends_a_goal() -> None:
    """It sent the robot on to a goal that had been cancelled."""
    with ModuleHarness(Traveller, checkpoint_lost=True) as traveller:
        traveller.advance(1.0)
        (order,) = traveller.take(SetControl)
        assert (order.mode, "checkpoint" in order.reason) == (ControlState.HOLD, True)
        assert not traveller.take(NavigateTo)
        traveller.reply(order, ControlSet(mode=ControlState.HOLD))
        traveller.advance(0.2)
        assert len(traveller.take(NavigateTo)) == 1
