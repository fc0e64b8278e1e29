"""The states of a robot that follows a person, and its settings."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class FollowState(StrEnum):
    """What the robot does."""

    IDLE = "waits for an order"
    CHOOSE = "looks for the person in front of it"
    FOLLOW = "drives behind the person"
    STAND = "stands near the person"
    LOST = "drives to where it saw the person last"
    LOOK = "stands and looks around for the person"
    SEARCH = "drives where it has not looked for the person"
    ASK = "asks whether the person is still there"
    HALT = "stands, until it can drive"


_S = FollowState
FOLLOWS = frozenset({_S.FOLLOW, _S.STAND})
SEARCHES = frozenset({_S.LOST, _S.LOOK, _S.SEARCH, _S.ASK})
_ALWAYS = {_S.IDLE, _S.HALT}
TRANSITIONS = {
    _S.IDLE: {_S.CHOOSE},
    _S.CHOOSE: {_S.IDLE, _S.STAND},
    _S.FOLLOW: {_S.STAND, _S.LOST, *_ALWAYS},
    _S.STAND: {_S.FOLLOW, _S.LOST, *_ALWAYS},
    _S.LOST: {_S.STAND, _S.LOOK, *_ALWAYS},
    _S.LOOK: {_S.STAND, _S.SEARCH, *_ALWAYS},
    _S.SEARCH: {_S.STAND, _S.ASK, *_ALWAYS},
    _S.ASK: {_S.STAND, *_ALWAYS},
    _S.HALT: {_S.LOST, _S.IDLE},
}


@dataclass(frozen=True)
class FollowSettings:
    """How the robot follows.

    Attributes:
        start_m: The person who is to be followed stands between these distances ...
        start_rad: ... and at most this far beside the robot's heading.
        behind_m: The robot drives to the place that is this far behind the person, on the person's way.
        near_m: The robot stands if the person is nearer than this ...
        away_m: ... until the person is farther away than this.
        fresh_s: A person counts as seen if a leg was seen within this time.
        lost_s: The person counts as lost after this time.
        choose_s: Time to find the person in front of the robot.
        lost_drive_s: Time to drive to where the person was seen last.
        look_s: Time to look around where the person was seen last.
        search_s: Time to drive where it has not looked.
        glance_s: Time to look at one of several persons.
        ask_s: Time to wait for an answer.
        ask_again_s: Time after which it asks again.
        sure: Clothes at least this alike are the same.
        wrong: Clothes less alike are others.
        margin: Clothes are recognised only if all other persons' are less alike by this.
        looks: Number of pictures that must agree.
        speed_m_per_s: No person is faster.
        same_place_m: Without clothes, a person is taken again only if nobody else is this near.
        goal_step_m: A new goal is sent if it is this far from the last one ...
        goal_period_s: ... and this time has passed.
    """

    start_m: tuple[float, float] = (0.5, 2.5)
    start_rad: float = 0.6
    behind_m: float = 1.0
    near_m: float = 1.2
    away_m: float = 1.4
    fresh_s: float = 0.4
    lost_s: float = 0.8
    choose_s: float = 8.0
    lost_drive_s: float = 12.0
    look_s: float = 5.0
    search_s: float = 90.0
    glance_s: float = 1.5
    ask_s: float = 24.0
    ask_again_s: float = 8.0
    sure: float = 0.8
    wrong: float = 0.6
    margin: float = 0.1
    looks: int = 3
    speed_m_per_s: float = 1.6
    same_place_m: float = 1.2
    goal_step_m: float = 0.2
    goal_period_s: float = 0.4

    def time_outs(self) -> dict[FollowState, TimeOut[FollowState]]:
        """Return the states that end after a time."""
        return {
            _S.CHOOSE: TimeOut(self.choose_s, _S.IDLE),
            _S.LOST: TimeOut(self.lost_drive_s, _S.LOOK),
            _S.LOOK: TimeOut(self.look_s, _S.SEARCH),
            _S.SEARCH: TimeOut(self.search_s, _S.ASK),
            _S.ASK: TimeOut(self.ask_s, _S.IDLE),
        }
