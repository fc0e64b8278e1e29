"""A module that has lost its state lets the robot hold before anything moves."""

import math

import numpy as np
import pytest

from robbie_mp import Header, Module, ModuleHarness, Time
from robbie_mp.messages import (
    ControlSet,
    ControlState,
    DriveCommand,
    LaserScan,
    NavigateTo,
    Odometry,
    SetControl,
    replace,
)
from robbie_robots.modules.home.follow import FollowMe
from robbie_robots.modules.home.household import Household
from robbie_robots.modules.home.who_is_who import WhoIsWhoTask
from robbie_robots.modules.manipulation.manipulation import Manipulation
from robbie_robots.modules.moving_module import MovingModule
from robbie_robots.modules.navigation.exploration import Exploration
from robbie_robots.modules.numbers.mission import Numbers
from robbie_robots.modules.parcours import Parcours
from robbie_robots.modules.rescue.mission import RescueMission

BEAMS = 90
SCAN = LaserScan(
    angle_min=-math.pi, angle_increment=2 * math.pi / BEAMS, range_min=0.05, range_max=10.0,
    ranges=np.full(BEAMS, 3.0, np.float32),
)  # fmt: skip
Race = ModuleHarness[Parcours]


def see(race: Race) -> None:
    """Let the race driver see a free way."""
    stamp = Time.from_nanoseconds(race.clock.now_ns())
    race.send(Odometry(header=Header(stamp=stamp)), topic="odom")
    race.send(replace(SCAN, header=Header(stamp=stamp)))
    race.advance(0.1)


def test_robot_whose_driver_has_lost_its_state_holds_first() -> None:
    """It drove on by the state of before, or as at the start of the run."""
    with ModuleHarness(Parcours, name="race", checkpoint_lost=True) as race:
        for _ in range(12):
            see(race)
        first, *more = race.take(SetControl)
        assert (first.mode, "race may order" in first.reason) == (ControlState.HOLD, True)
        assert not more  # nobody has answered yet
        assert not race.take(DriveCommand)
        race.reply(first, ControlSet(mode=ControlState.HOLD))
        see(race)
        assert race.take(DriveCommand)[-1].linear_m_per_s > 0.0


def test_order_to_hold_is_repeated_until_a_base_that_was_missing_has_followed_it() -> None:
    """A base that is being restarted is missing; it comes back and lets the robot move."""
    with ModuleHarness(Parcours, checkpoint_lost=True) as race:
        race.remove_server()
        race.advance(2.0)
        see(race)
        assert not race.take(DriveCommand)
        race.bus.peers.has_server = True
        race.advance(1.0)
        assert race.take(SetControl)


def test_loss_is_not_forgotten_before_the_robot_holds() -> None:
    """A second death made the older state the newest one."""
    with ModuleHarness(Parcours, restored=None, checkpoint_lost=True) as race:
        see(race)
        assert race.checkpoint is None
        (order,) = race.take(SetControl)
        race.reply(order, ControlSet(mode=ControlState.HOLD))
        see(race)
        assert race.checkpoint is not None


@pytest.mark.parametrize(
    "module",
    [Exploration, FollowMe, Household, Manipulation, Numbers, Parcours, RescueMission, WhoIsWhoTask],
    ids=lambda module: module.__name__,
)
def test_every_module_that_decides_where_the_robot_goes_is_one_that_holds_first(module: type[Module]) -> None:
    assert issubclass(module, MovingModule)
    assert module.tick is MovingModule.tick


def test_module_without_a_loss_acts_at_once() -> None:
    with ModuleHarness(Parcours) as race:
        see(race)
        assert race.take(DriveCommand) and not race.take(SetControl) and not race.take(NavigateTo)
