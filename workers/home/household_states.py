"""The states of a robot that carries out orders in a household, and its settings."""

from dataclasses import dataclass

from strenum import StrEnum

from robbie_mp.base.state_machine import TimeOut


class HouseholdState(StrEnum):
    """What the robot does."""

    IDLE = "waits for an order"
    FETCH = "drives to a table on which the object may be"
    PICK = "picks it up"
    CARRY = "drives to where it should be"
    PUT = "puts it down"
    MEET = "comes near to a person"
    HAND = "hands it over"
    GO = "drives to a place"
    DOOR = "waits before a door for somebody to open it"
    LEARN = "learns the name of a place"
    FOLLOW = "follows a person"
    WHO = "finds out who is where"


_S = HouseholdState
TRANSITIONS = {
    _S.IDLE: {_S.FETCH, _S.CARRY, _S.GO, _S.LEARN, _S.FOLLOW, _S.WHO},
    _S.FETCH: {_S.PICK, _S.DOOR, _S.IDLE},
    _S.PICK: {_S.CARRY, _S.FETCH, _S.IDLE},
    _S.CARRY: {_S.PUT, _S.MEET, _S.DOOR, _S.IDLE},
    _S.PUT: {_S.CARRY, _S.FETCH, _S.IDLE},
    _S.MEET: {_S.HAND, _S.IDLE},
    _S.HAND: {_S.MEET, _S.FETCH, _S.IDLE},
    _S.GO: {_S.DOOR, _S.IDLE},
    _S.DOOR: {_S.FETCH, _S.CARRY, _S.GO, _S.IDLE},
    _S.LEARN: {_S.IDLE},
    _S.FOLLOW: {_S.IDLE},
    _S.WHO: {_S.IDLE},
}
DRIVES = frozenset({_S.FETCH, _S.CARRY, _S.GO})
ARM_WORKS = frozenset({_S.PICK, _S.PUT, _S.HAND})


@dataclass(frozen=True)
class HouseholdSettings:
    """How the robot carries out orders.

    Attributes:
        travel_s: Time for a drive.
        arm_s: Time for the arm to pick up or put down something.
        meet_s: Time to find a person who takes what the robot brings.
        learn_s: Time until a place must have its name.
        at_table_m: The robot stands in front of a table if it is this near to the place there ...
        at_table_rad: ... and its heading is this near to that of the place.
        door_s: Time for somebody to open a door, before the robot asks again.
        max_requests: How often it asks for one door.
        open_m: A door in front of the robot is open if the robot sees this far ahead.
        max_tries: How often the robot tries the same again: a drive, a grasp.
        rounds: How often it looks on all tables for an object.
        person_m: A person this near to the robot may have given the order, or take what the robot brings.
        two_legs: Persons show two legs at least this often, 0 to 1; others rather are furniture.
        front_rad: Those in front of the robot, at most this far beside its heading, rather give orders.
        same_m: A person this near to where the one who gave the order stood is taken for the same person ...
        thing_m: ... and this near, whatever looks like legs is that person, even if it is on the map.
        refused_m: Nobody this near to where nobody has taken the object is asked again.
        wait_s: For this time, nobody else may take what the robot brings; then it calls.
        near_m: The robot hands over to a person this near ...
        far_m: ... or this near, if it cannot come nearer ...
        ahead_rad: ... and at most this far beside its heading.
        before_m: It comes to the place this far before the person.
        fresh_s: A person counts as present if seen within this time.
        moved_m: It drives to another place if the person has moved by this.
    """

    travel_s: float = 240.0
    arm_s: float = 150.0
    meet_s: float = 60.0
    learn_s: float = 10.0
    at_table_m: float = 0.2
    at_table_rad: float = 0.25
    door_s: float = 12.0
    max_requests: int = 5
    open_m: float = 1.5
    max_tries: int = 3
    rounds: int = 2
    person_m: float = 3.0
    two_legs: float = 0.3
    front_rad: float = 0.6
    same_m: float = 1.0
    thing_m: float = 0.4
    refused_m: float = 0.5
    wait_s: float = 8.0
    near_m: float = 1.1
    far_m: float = 1.6
    ahead_rad: float = 0.4
    before_m: float = 0.9
    fresh_s: float = 0.5
    moved_m: float = 0.3

    def time_outs(self) -> dict[HouseholdState, TimeOut[HouseholdState]]:
        """Return the states that end after a time."""
        driving = dict.fromkeys((_S.FETCH, _S.CARRY, _S.GO, _S.DOOR), self.travel_s)
        arm = dict.fromkeys((_S.PICK, _S.PUT, _S.HAND), self.arm_s)
        others = {_S.MEET: self.meet_s, _S.LEARN: self.learn_s}
        return {state: TimeOut(limit_s, _S.IDLE) for state, limit_s in (driving | arm | others).items()}
