"""Which messages cross a bridge, under which names, and with which quality of service.

A bridge has two settings. `send` says what leaves the robot: a type, or a type and a topic (shell patterns),
and the name that it has on the other side. `accept` says what comes in: a name on the other side, its type,
and the topic on which the robot publishes it. Words for the quality of service may follow.

    send:
      LaserScan laser/front: /scan best_effort depth=5
      OccupancyGrid map: /map latched
      Image *: /camera/{topic}
    accept:
      /goal_pose: PoseStamped goal
      /cmd_vel: Twist as DriveCommand teleop
      /move_base_simple/goal: PoseStamped as NavigateTo
      /initialpose: PoseWithCovarianceStamped as PoseStamped initial_pose

A name that does not begin with a slash follows the bridge's namespace. `{topic}` is the robot's topic, or
stands for the type if the message has no topic. `Twist as DriveCommand` makes velocities drive
the robot, for a limited time. `as NavigateTo` makes poses goals of the module that navigates.
`as PoseStamped` leaves a covariance out. See `robbie_mp.connect.bridge.arrivals`. A bridge may also know
forms for what it sends, such as `PointsOfInterest: /places as MarkerArray`. A bridge to a system that
describes its types may take messages of types that the robot does not know: `accept` then has a pattern
instead of a type, as in `/gas: nose_msgs/* gas`.
"""

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Final, NamedTuple

from typing_extensions import Self

from robbie_mp.base.errors import RobbieError
from robbie_mp.logs.capture.selection import WILDCARDS, TypeAndTopic, type_pattern
from robbie_mp.logs.recording.topic_names import plain_topic
from robbie_mp.messages import (
    DriveCommand,
    Message,
    MessageError,
    NavigateTo,
    PoseStamped,
    PoseWithCovarianceStamped,
    Twist,
    TwistStamped,
)
from robbie_mp.messages.descriptions import KnownTypes

MAX_PATTERNS = 32
"""Most patterns in `send`: the core matches them for the bridge, and takes no more."""
MAX_ACCEPTED = 256
"""Most names in `accept`."""
MAX_NAMES = 1024
"""Most names that a bridge remembers of messages that it has sent."""
MAX_DEPTH = 1000
DEFAULT_DEPTH = 10
TOPIC = "{topic}"
NAME = re.compile(r"(/?[A-Za-z_][A-Za-z0-9_]*)(/[A-Za-z_][A-Za-z0-9_]*)*")
BECOMES: Final[Mapping[type[Message], tuple[type[Message], ...]]] = {
    DriveCommand: (Twist, TwistStamped),
    NavigateTo: (PoseStamped,),
    PoseStamped: (PoseWithCovarianceStamped,),
}
"""The types that incoming messages can be turned into."""


class MappingError(RobbieError, ValueError):
    """A bridge's setting cannot be understood; the text has a line for each problem."""


@dataclass(frozen=True)
class Quality:
    """How messages of a channel are passed on, in the words of ROS 2.

    Attributes:
        is_reliable: lost messages are sent again; otherwise they are only missed.
        is_latched: those who come later get the newest messages (ROS 2: transient local; ROS 1: latched).
        depth: number of messages that may wait.
    """

    is_reliable: bool = True
    is_latched: bool = False
    depth: int = DEFAULT_DEPTH

    @classmethod
    def of(cls, words: list[str]) -> Self:
        """Read words as `best_effort latched depth=5`.

        Raises:
            MappingError: a word is not understood.
        """
        found: dict[str, bool | int] = {}
        for word in words:
            name, _, number = word.partition("=")
            if name == "depth" and number.isdecimal() and 1 <= int(number) <= MAX_DEPTH:
                found["depth"] = int(number)
            elif word in _WORDS:
                found.update(_WORDS[word])
            else:
                raise MappingError(
                    f"{word!r} is not a quality of service: expected {', '.join(_WORDS)} or depth=1 to "
                    f"depth={MAX_DEPTH}"
                )
        return cls(**found)  # type: ignore[arg-type]


_WORDS: dict[str, dict[str, bool]] = {
    "reliable": {"is_reliable": True},
    "best_effort": {"is_reliable": False},
    "latched": {"is_latched": True},
    "transient_local": {"is_latched": True},
    "volatile": {"is_latched": False},
}


class Outgoing(NamedTuple):
    """Messages that leave the robot.

    Attributes:
        pair: patterns for their type and topic.
        name: their name on the other side, which may contain `{topic}`.
        quality: how they are passed on.
        becomes: name of the type that they become; "": they stay what they are.
    """

    pair: TypeAndTopic
    name: str
    quality: Quality
    becomes: str = ""


class Incoming(NamedTuple):
    """Messages that come in.

    Attributes:
        name: their name on the other side.
        type_name: full name of their type on the other side, or a pattern for types that the robot does not
            know.
        topic: the topic on which the robot publishes them.
        becomes: the class of what the robot gets instead, such as `DriveCommand`; None: the message itself.
        quality: how they are asked for.
    """

    name: str
    type_name: str
    topic: str
    becomes: type[Message] | None
    quality: Quality

    @property
    def drives(self) -> bool:
        """Whether they are velocities that become drive commands."""
        return self.becomes is DriveCommand

    @property
    def lets_move(self) -> bool:
        """Whether they become orders that let the robot move."""
        return self.becomes in (DriveCommand, NavigateTo)

    @property
    def is_foreign(self) -> bool:
        """Whether they are of types that the robot does not know."""
        return not WILDCARDS.isdisjoint(self.type_name)

    def matches(self, type_name: str) -> bool:
        """Whether messages of a type come in, by its full name."""
        return fnmatchcase(type_name, self.type_name)


class SentAs(NamedTuple):
    """Under which name, and how, messages of one type and topic leave the robot, and what they become."""

    name: str
    quality: Quality
    becomes: str = ""


class BridgeMap:
    """The messages that cross a bridge.

    Args:
        send: the setting of that name; see above.
        accept: the setting of that name.
        namespace: comes before the names on the other side that do not begin with a slash.
        types: types that may come in; by default the stock types.
        outgoing_forms: names of the types that messages may become when they leave the robot.
        takes_foreign: whether messages of types that the robot does not know may come in.
        name_of: what `{topic}` stands for, by type and topic.

    Raises:
        MappingError: a line is wrong.

    Attributes:
        outgoing: what leaves the robot; the first that matches a message counts.
        incoming: what comes in.
        clashes: number of messages that were not sent because their name belongs to another type.
    """

    def __init__(
        self,
        send: Mapping[str, str],
        accept: Mapping[str, str],
        namespace: str = "",
        types: KnownTypes | None = None,
        outgoing_forms: Collection[str] = (),
        *,
        takes_foreign: bool = False,
        name_of: Callable[[str, str], str] = plain_topic,
    ):
        self._takes_foreign = takes_foreign
        self._name_of = name_of
        self._outgoing_forms = outgoing_forms
        self._namespace = namespace.strip("/")
        self._types = types or KnownTypes()
        self._names: dict[tuple[str, str], SentAs | None] = {}
        self._owners: dict[str, str] = {}
        self.clashes = 0
        problems: list[str] = []
        if namespace and not NAME.fullmatch(namespace):
            problems.append(f"the namespace {namespace!r} is not a name such as 'robots/red'")
        sent = [self._outgoing(key, text, problems) for key, text in send.items()]
        accepted = [self._incoming(key, text, problems) for key, text in accept.items()]
        self.outgoing = [one for one in sent if one]
        self.incoming = [one for one in accepted if one]
        if len(send) > MAX_PATTERNS:
            problems.append(f"`send` has more than {MAX_PATTERNS} patterns; use wider ones")
        if len(accept) > MAX_ACCEPTED:
            problems.append(f"`accept` has more than {MAX_ACCEPTED} names")
        if problems:
            raise MappingError("\n".join(problems))

    def sent_as(self, type_name: str, topic: str) -> SentAs | None:
        """Return under which name messages leave the robot; None if they do not.

        A name belongs to the type that was sent first under it: two types under one name confuse readers.

        Args:
            type_name: full name of the type.
            topic: the robot's topic.
        """
        key = (type_name, topic)
        if key not in self._names:
            if len(self._names) >= MAX_NAMES:
                return None
            self._names[key] = self._find(type_name, topic)
        found = self._names[key]
        if found is not None and self._owners.setdefault(found.name, type_name) != type_name:
            self.clashes += 1
            return None
        return found

    def owner(self, name: str) -> str:
        """Return the type that a name belongs to; "" if nothing has been sent under it."""
        return self._owners.get(name, "")

    def _find(self, type_name: str, topic: str) -> SentAs | None:
        for one in self.outgoing:
            if one.pair.matches(type_name, topic):
                name = one.name.replace(TOPIC, self._name_of(type_name, topic))
                return SentAs(name, one.quality, one.becomes)
        return None

    def absolute(self, name: str) -> str:
        """Return a name on the other side with the namespace, unless it begins with a slash."""
        return name if name.startswith("/") else f"/{self._namespace}/{name}".replace("//", "/")

    def _outgoing(self, key: str, text: str, problems: list[str]) -> Outgoing | None:
        patterns, words = key.split(), text.split()
        if len(patterns) not in (1, 2):
            problems.append(
                f"{key!r}: expected a type, or a type and a topic with a space between, such as "
                "'LaserScan laser/front'"
            )
            return None
        name = words[0] if words else TOPIC
        if not NAME.fullmatch(name.replace(TOPIC, "topic")):
            problems.append(f"{key!r}: {name!r} is not a name such as '/scan' or 'camera/{TOPIC}'")
            return None
        words, becomes = words[1:], ""
        if words[:1] == ["as"]:
            becomes, words = " ".join(words[1:2]), words[2:]
            if becomes not in self._outgoing_forms:
                known = f"only {', '.join(self._outgoing_forms)}" if self._outgoing_forms else "nothing else"
                problems.append(f"{key!r}: what this bridge sends can become {known}")
                return None
        try:
            quality = Quality.of(words)
        except MappingError as error:
            problems.append(f"{key!r}: {error}")
            return None
        pair = TypeAndTopic(type_pattern(patterns[0]), patterns[1] if len(patterns) == 2 else "*")
        return Outgoing(pair, self.absolute(name), quality, becomes)

    def _incoming(self, key: str, text: str, problems: list[str]) -> Incoming | None:
        words = text.split()
        try:
            if not NAME.fullmatch(key):
                raise MappingError("this is not a name such as '/goal_pose'")
            if not words:
                raise MappingError("expected a type, or a type and a topic, such as 'PoseStamped goal'")
            type_name, words = self._incoming_type(words[0]), words[1:]
            becomes = None
            if words[:1] == ["as"]:
                becomes, words = _becomes(type_name, words[1:]), words[2:]
            topic = "" if becomes is NavigateTo else key.strip("/")
            if words and not _is_quality(words[0]):
                topic = words.pop(0)
            found = Incoming(self.absolute(key), type_name, topic, becomes, Quality.of(words))
            if found.lets_move and found.quality.is_latched:
                raise MappingError("an order to move cannot be latched: each restart would give it again")
            return found
        except (MappingError, MessageError) as error:
            problems.append(f"{key!r}: {error}")
            return None

    def _incoming_type(self, name: str) -> str:
        if WILDCARDS.isdisjoint(name):
            return self._types.find(name)
        if not self._takes_foreign:
            raise MappingError(f"{name!r} is a pattern; this bridge accepts only types that the robot knows")
        return type_pattern(name)


def _becomes(type_name: str, words: list[str]) -> type[Message]:
    """Return the class of which the name comes first, if messages of the type can become such messages."""
    names = {one.__name__: one for one in BECOMES}
    if not words or words[0] not in names:
        raise MappingError(f"a message can become {', '.join(names)}, which must follow 'as'")
    sources = [one.type_name for one in BECOMES[names[words[0]]]]
    if type_name not in sources:
        raise MappingError(f"only {' and '.join(sources)} can become a {words[0]}")
    return names[words[0]]


def _is_quality(word: str) -> bool:
    return word in _WORDS or word.startswith("depth=")
