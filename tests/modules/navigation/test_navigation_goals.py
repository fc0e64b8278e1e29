"""The client's side of navigation."""

import numpy as np

from robbie_mp import ModuleHarness
from robbie_mp.messages import NavigateTo
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.navigation_goals import NavigationGoals

AT = np.array([1.0, 2.0, 0.0])


class Traveller(MovingModule):
    """Wants to drive to one goal."""

    period_s = 0.1

    def setup(self) -> None:
        self.goals = NavigationGoals(self, lambda: None, lambda _reason: None, lambda _reason: None)

    def act(self) -> None:
        self.goals.drive_to(AT, (0.0, 0.0, 0.0))


def test_goal_is_sent_at_once() -> None:
    with ModuleHarness(Traveller) as traveller:
        traveller.advance(0.1)
        assert len(traveller.take(NavigateTo)) == 1
