"""Messages about people around the robot."""

from robbie_mp import DEFAULT, Array, Header, Message, float32, float64
from robbie_mp.messages import Point
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond, elements_beyond, unlike_lengths


class Person(Message, name="people_msgs/msg/Person", version=1):
    """A person (ROS people_msgs, https://github.com/wg-perception/people)."""

    name: str = DEFAULT  # the same as long as the person is tracked
    position: Point = DEFAULT  # m
    velocity: Point = DEFAULT  # m/s
    reliability: float64 = DEFAULT  # 0 … 1
    tagnames: list[str] = DEFAULT  # "unseen_s": since a leg was seen; "has_moved": 1 or 0; "two_legs": 0 … 1
    tags: list[str] = DEFAULT  # a value for each of them

    def flaw(self) -> Flaw | None:
        """Return a reliability that is not finite, or a tag without a value."""
        return beyond(self, MAX_MAGNITUDE, "reliability") or unlike_lengths(self, "tagnames", "tags")


class People(Message, name="people_msgs/msg/People", version=1):
    """All persons around the robot."""

    header: Header = DEFAULT  # stamp: of the scan; frame_id: map
    people: list[Person] = DEFAULT


class PeopleClothes(Message, name="home_msgs/msg/PeopleClothes", version=1):
    """How persons are dressed in one picture; those who are not seen well are left out."""

    header: Header = DEFAULT  # stamp: of the picture
    names: list[str] = DEFAULT  # as in People
    clothes: Array[float32] = DEFAULT  # (names * bins,), see workers/people/clothes.py

    def flaw(self) -> Flaw | None:
        """Return whether the numbers are not the same number of bins for each name, or not finite."""
        if len(self.clothes) % max(1, len(self.names)) or (len(self.clothes) and not self.names):
            return Flaw("clothes", len(self.clothes), f"as many elements for each of {len(self.names)} names")
        return elements_beyond(self, MAX_MAGNITUDE, "clothes")
