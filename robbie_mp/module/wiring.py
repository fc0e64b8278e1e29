"""The names that a profile gives to the topics of a module, whose code uses names of its own.

A name is looked up once, when the module subscribes or first publishes. It costs nothing per message.
"""

import re
from collections.abc import Mapping

from robbie_mp.base.errors import RobbieError

ABSOLUTE = "/"
REQUESTS = ("_Request", "_Goal")
"""Ends of the types that go to the topic of a service, `call` or `call/NAME`, with a name of the module's."""
ANSWERS = ("_Response", "_Feedback", "_Result")
"""Ends of the types that go to the topic of the module that has called."""
SERVICE_TOPIC = "call"
RUN_WIDE_TYPES = frozenset(
    f"robbie_msgs/msg/{name}"
    for name in (
        "CallRefusal", "CallsAnswer", "CallsQuestion", "GoalCancel", "GoalEnd", "ModuleState",
        "PlaybackControl", "PlaybackState", "SettingChange", "SettingChanged", "SystemProfile",
        "Tick", "TimeJump",
    )
)  # fmt: skip
"""Messages about the run, which is one even with several robots in it: their topics keep their names."""


_CARRIED = re.compile(r"/?[\w.~-]+(/[\w.~-]+)*", re.ASCII)
"""Names that ROS, Zenoh, MQTT, logs and command lines carry as they are."""


class InvalidTopic(RobbieError, ValueError):
    """A topic has a name that other programs cannot carry, or none.

    Example scenarios:
      - it has a space or another special character
      - it ends with a slash, or has an empty part, as in "front//left"
      - it is None or a number
    """


class TopicsMeet(RobbieError, ValueError):
    """The profile gives two topics of a module the same name, and the module subscribes to both."""

    def __init__(self, type_name: str, own: str, other: str, actual: str):
        super().__init__(
            f"the profile calls both '{other}' and '{own}' of this module '{actual}', and it subscribes to "
            f"{type_name} on both; give them different names under `topics:`"
        )


def check_topic(topic: object) -> None:
    """Check the name of a topic that a module publishes on or subscribes to.

    Raises:
        InvalidTopic: not everything could carry it.
    """
    if topic != "" and not (isinstance(topic, str) and _CARRIED.fullmatch(topic)):
        raise InvalidTopic(
            f"{topic!r:.60} is no name of a topic: use letters, digits, _ - . ~ and single slashes, as in "
            f"{_suggestion(topic)!r}; leave it out for messages without a topic"
        )


def _suggestion(topic: object) -> str:
    parts = re.sub(r"[^\w.~/-]+", "_", str(topic), flags=re.ASCII).split("/")
    return "/".join(part.strip("_") for part in parts if part.strip("_")) or "front"


class Wiring:
    """Translates between a module's own names of topics and the names in the run.

    Own names in `topics` get the name given there; all others stay. Then the namespace comes before the
    name, unless the name begins with a slash. The own topic '' becomes 'red/' in the namespace red: a
    subscription to it gets all topics below 'red/', as '' gets all topics.

        >>> wiring = Wiring({"camera": "front/camera", "map": "/map"}, "red")
        >>> [wiring.actual("sensor_msgs/msg/Image", topic) for topic in ("camera", "map", "odom", "")]
        ['red/front/camera', 'map', 'red/odom', 'red/']

    Args:
        topics: new names by own names. A slash at the beginning of a new name is removed.
        namespace: comes before all names without a slash at their beginning; '' for none.
    """

    def __init__(self, topics: Mapping[str, str] | None = None, namespace: str = ""):
        self._topics = dict(topics or {})
        self._prefix = f"{namespace}/" if namespace else ""
        self._subscribed: dict[tuple[str, str], str] = {}
        """Own names of subscribed topics, by type and actual name."""

    def actual(self, type_name: str, own: str) -> str:
        """Return the name that an own topic has in the run.

        Args:
            type_name: type of its messages, or a pattern for types.
            own: the topic as the module's code names it, or a pattern.
        """
        if type_name in RUN_WIDE_TYPES or type_name.endswith(ANSWERS):
            return own
        kind, _, service = own.partition("/")
        if kind == SERVICE_TOPIC and type_name.endswith(REQUESTS):
            return f"{SERVICE_TOPIC}/{self._actual(service)}".rstrip("/")
        return self._actual(own)

    def _actual(self, own: str) -> str:
        name = self._topics.get(own)
        if name is None:
            return own if own.startswith(ABSOLUTE) else self._prefix + own
        return self._target(name)

    def subscribed(self, type_name: str, own: str) -> str:
        """Return the same, and remember it for `own`: other topics may have the same name in the run."""
        name = self.actual(type_name, own)
        self._subscribed[type_name, name] = own
        return name

    def own(self, type_name: str, actual: str) -> str:
        """Return a module's own name of a topic in the run: what its `envelope` shows."""
        known = self._subscribed.get((type_name, actual))
        if known is not None:
            return known
        for own, name in self._topics.items():
            if actual == self._target(name):
                return own
        return actual.removeprefix(self._prefix)

    def _target(self, name: str) -> str:
        return name[1:] if name.startswith(ABSOLUTE) else self._prefix + name


UNCHANGED = Wiring()
