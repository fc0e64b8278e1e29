"""The states of an arm that picks up and puts down, and its settings."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class HandTask(StrEnum):
    """What an arm can be told to do."""

    PICK_UP = "pick up"
    PUT_DOWN = "put down"
    HAND_OVER = "hand over"
    STOW = "stow"


class HandState(StrEnum):
    """What an arm does."""

    REST = "stands without an order"
    RECOVER = "finds out what it holds, after a pause"
    FREE = "moves the hand away from where it is"
    ASIDE = "moves the arm out of the camera's view"
    LOOK = "looks at the table"
    APPROACH = "moves the hand near to its goal"
    REACH = "moves the hand straight to its goal"
    CLOSE = "closes the gripper"
    LIFT = "lifts what it holds"
    OPEN = "opens the gripper"
    WITHDRAW = "draws the hand back"
    STOW = "moves the arm above the robot"
    OFFER = "holds out what it holds to a person"


_S = HandState
_ALWAYS = {_S.REST, _S.RECOVER}
TRANSITIONS = {
    _S.REST: {_S.RECOVER},
    _S.RECOVER: _ALWAYS | {_S.FREE, _S.LIFT, _S.OFFER},
    _S.FREE: _ALWAYS | {_S.ASIDE, _S.STOW},
    _S.ASIDE: _ALWAYS | {_S.LOOK},
    _S.LOOK: _ALWAYS | {_S.APPROACH},
    _S.APPROACH: _ALWAYS | {_S.REACH},
    _S.REACH: _ALWAYS | {_S.CLOSE, _S.OPEN},
    _S.CLOSE: _ALWAYS | {_S.LIFT, _S.OPEN},
    _S.LIFT: _ALWAYS | {_S.STOW, _S.ASIDE},
    _S.OPEN: _ALWAYS | {_S.WITHDRAW},
    _S.WITHDRAW: _ALWAYS | {_S.STOW, _S.ASIDE},
    _S.STOW: _ALWAYS,
    _S.OFFER: _ALWAYS | {_S.OPEN},
}
TIME_OUTS = {
    _S.LOOK: TimeOut(6.0, _S.RECOVER),
    _S.CLOSE: TimeOut(5.0, _S.OPEN),
    _S.RECOVER: TimeOut(6.0, _S.FREE),
}


@dataclass(frozen=True)
class HandSettings:
    """How an arm works.

    Attributes:
        stow: joints with the hand above the robot, to drive; rad.
        aside: joints with the arm out of the camera's view; rad.
        offer: joints with the hand held out to a person; the wrist then keeps upright what it holds; rad.
        offer_s: time after which the arm gives up that somebody takes what it holds out.
        pull_nm: somebody pulls if the torque of a joint changes by this.
        back_m: how far before the object the hand begins to move straight.
        lift_m: how far an object is lifted straight up.
        line_speed: share of the joints' greatest speeds on straight lines.
        speed: share of them on other ways.
        acceleration_rad_per_s2: of all joints.
        empty_m: the gripper holds nothing if half of its opening is at most this when it stands.
        still_s: the gripper stands if it has not moved for this time.
        settle_s: the camera's images count from this time after the arm stands.
        stale_s: the arm pauses if its joints have not been heard for this time.
        lag_rad: the arm gives up if a joint is this far from where it should be.
        max_tries: how often it tries to grasp.
    """

    stow: tuple[float, ...] = (0.0, -0.8, -0.3, 0.0, 1.1, 0.0)
    aside: tuple[float, ...] = (1.9, 0.3, 0.9, 0.0, -1.2, 0.0)
    offer: tuple[float, ...] = (0.0, 0.3, -0.3, 0.0, 0.0, 0.0)
    offer_s: float = 15.0
    pull_nm: float = 0.8
    back_m: float = 0.09
    lift_m: float = 0.07
    line_speed: float = 0.35
    speed: float = 0.8
    acceleration_rad_per_s2: float = 3.0
    empty_m: float = 0.006
    still_s: float = 0.3
    settle_s: float = 0.2
    stale_s: float = 0.5
    lag_rad: float = 0.5
    max_tries: int = 4
