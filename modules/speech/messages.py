"""Messages of a robot that hears and speaks."""

from robbie_mp import DEFAULT, Header, Message, float64
from robbie_mp.messages.flaws import MAX_MAGNITUDE, Flaw, beyond


class SpokenSlot(Message, name="speech_msgs/msg/SpokenSlot", version=1):
    """What was said at one place of a sentence."""

    name: str = DEFAULT  # such as "object"
    words: str = DEFAULT  # such as "orange juice"


class SpokenOrder(Message, name="speech_msgs/msg/SpokenOrder", version=1):
    """An order that somebody has spoken and, if it had to be, has confirmed."""

    header: Header = DEFAULT  # stamp: when the utterance had ended
    order: str = DEFAULT  # its name in the grammar, such as "bring"
    text: str = DEFAULT  # the words
    slots: list[SpokenSlot] = DEFAULT
    distance: float64 = DEFAULT  # 0 to 1: between how the grammar's recogniser and the free one heard it
    was_confirmed: bool = DEFAULT  # the person was asked, and said yes

    def flaw(self) -> Flaw | None:
        """Return a distance that is not finite."""
        return beyond(self, MAX_MAGNITUDE, "distance")


class Say(Message, name="speech_msgs/msg/Say", version=1):
    """A text that the robot is to speak."""

    text: str = DEFAULT
