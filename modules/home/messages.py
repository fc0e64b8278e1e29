"""Messages that only the household robot knows."""

from robbie_mp import DEFAULT, Feedback, Goal, Header, Message, Reply, Request, Result, float64, uint32
from robbie_mp.messages import Point
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond


class FollowOrderTaken(Reply, name="home_msgs/srv/FollowOrder_Response", version=1):
    """What the robot does after the order."""

    changed: bool = DEFAULT  # False: the order changes nothing at present
    state: str = DEFAULT  # name of a state of workers/home/follow_states.py


class FollowOrder(Request[FollowOrderTaken], name="home_msgs/srv/FollowOrder_Request", version=1):
    """An order as by voice: `follow` the person in front of you, `stop`, or `here`: I am here."""

    order: str = DEFAULT


class Following(Message, name="home_msgs/msg/Following", version=1):
    """What the robot that follows a person does, and whom it follows. Published at intervals."""

    header: Header = DEFAULT  # frame_id: map
    state: str = DEFAULT  # name of a state of workers/home/follow_states.py
    reason: str = DEFAULT  # in plain words
    person: str = DEFAULT  # as in People; '': nobody
    position: Point = DEFAULT  # where the person is believed to be, or was seen last, m
    unseen_s: float64 = DEFAULT  # time since then
    losses: uint32 = DEFAULT  # how often the robot has lost the person
    questions: uint32 = DEFAULT  # how often it has asked whether the person is there

    def flaw(self) -> Flaw | None:
        """Return a time that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "unseen_s")


class MetPerson(Message, name="home_msgs/msg/MetPerson", version=1):
    """A person whose face the robot has looked at."""

    name: str = DEFAULT  # '': the robot does not know this person
    position: Point = DEFAULT  # m, map frame
    place: str = DEFAULT  # name of the nearest place of MapAnnotations; '': there is none
    faces: uint32 = DEFAULT  # pictures of the face that were compared


class WhoIsWhoFeedback(Feedback, name="home_msgs/action/WhoIsWho_Feedback", version=1):
    """What the robot does; sent on each change."""

    state: str = DEFAULT  # name of a state of workers/home/person_tour.py
    reason: str = DEFAULT  # in plain words
    met: uint32 = DEFAULT  # persons so far


class WhoIsWhoResult(Result, name="home_msgs/action/WhoIsWho_Result", version=1):
    """Who is where."""

    persons: list[MetPerson] = DEFAULT
    duration_s: float64 = DEFAULT


class WhoIsWho(Goal[WhoIsWhoFeedback, WhoIsWhoResult], name="home_msgs/action/WhoIsWho_Goal", version=1):
    """Look for persons, and say who is where. A newer goal takes over the round of an older one."""

    persons: uint32 = DEFAULT  # ends when it has met that many; 0: when it has looked everywhere


class LearnPersonFeedback(Feedback, name="home_msgs/action/LearnPerson_Feedback", version=1):
    """What the robot does; sent on each change."""

    state: str = DEFAULT  # as in WhoIsWhoFeedback
    reason: str = DEFAULT  # in plain words


class LearnPersonResult(Result, name="home_msgs/action/LearnPerson_Result", version=1):
    """The person is known, also after a restart."""

    examples: uint32 = DEFAULT  # pictures of this person


class LearnPerson(
    Goal[LearnPersonFeedback, LearnPersonResult], name="home_msgs/action/LearnPerson_Goal", version=1
):
    """Learn the face of the person in front of you."""

    name: str = DEFAULT


class HouseholdTask(Message, name="home_msgs/msg/HouseholdTask", version=1):
    """One task of an order."""

    task: str = DEFAULT  # bring, put, go, learn, follow or who: see workers/home/orders.py
    object: str = DEFAULT  # what to bring or put; '' with put: what is in the hand
    place: str = DEFAULT  # where to put something or to go; how to call the place where the robot stands


class CarryOutFeedback(Feedback, name="home_msgs/action/CarryOut_Feedback", version=1):
    """What the robot does; sent on each change."""

    at: uint32 = DEFAULT  # place of the present task among all, from 0
    state: str = DEFAULT  # name of a state of workers/home/household_states.py
    reason: str = DEFAULT  # why it is in that state, in plain words


class CarryOutResult(Result, name="home_msgs/action/CarryOut_Result", version=1):
    """All tasks are done."""

    duration_s: float64 = DEFAULT


class CarryOut(Goal[CarryOutFeedback, CarryOutResult], name="home_msgs/action/CarryOut_Goal", version=1):
    """Carry out tasks one after another. A newer order, also a spoken one, replaces the older one."""

    text: str = DEFAULT  # in words of the profile's grammar, such as "go to the kitchen and follow me"
    tasks: list[HouseholdTask] = DEFAULT  # the same as data, if `text` is empty


class OrderCancelled(Reply, name="home_msgs/srv/CancelOrder_Response", version=1):
    """The robot has no order any more."""

    had_order: bool = DEFAULT


class CancelOrder(Request[OrderCancelled], name="home_msgs/srv/CancelOrder_Request", version=1):
    """End the order, no matter who has given it; the robot stands, and holds what it holds."""

    reason: str = DEFAULT  # in plain words


class HouseholdStatus(Message, name="home_msgs/msg/HouseholdStatus", version=1):
    """What the household robot does and knows. Latched, and published on each change."""

    header: Header = DEFAULT
    state: str = DEFAULT  # name of a state of workers/home/household_states.py
    reason: str = DEFAULT  # why it is in that state, in plain words
    tasks: list[HouseholdTask] = DEFAULT  # of the present order; empty if there is none
    at: uint32 = DEFAULT  # place of the present task among them, from 0
    holds: str = DEFAULT  # what is in the hand; '': nothing
    has_arm: bool = DEFAULT  # False: it cannot bring or put anything
    objects: list[str] = DEFAULT  # objects that orders can name
    places: list[str] = DEFAULT  # places that the robot knows
    names: list[str] = DEFAULT  # names that a place can be given
