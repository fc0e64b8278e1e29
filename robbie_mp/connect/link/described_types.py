"""The message types that linked robots describe to one another, so that tools can read the messages."""

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.messages import LinkType, LinkTypes, MessageError, UnknownType
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.encoded import check_type
from robbie_mp.run.learnt_types import learn_type

TYPES_TOPIC = "link_types"
MAX_TYPES = 64
"""Most types that a robot describes: a tool generates code for each of them."""
MAX_BYTES = 512 << 10
"""Of the schemas of one robot's types, all together."""
MAX_DESCRIBED = 1024
"""Types that a robot describes as long as this link lives: with each restart it does so again."""


class TypeRefused(RobbieError, ValueError):
    """A link does not learn a type that another robot describes.

    Example scenarios:
      - its schema cannot be read
      - this robot, or another one that it has met, has a different type of this name
    """


class LinkedTypes:
    """The types that a robot knows, and those that it learns from others.

    Args:
        own: its own types, except the stock types.
        folder: the run's folder; None in a test.
        log: where a type that is not learnt is named.
    """

    def __init__(self, own: Iterable[TypeDescription], folder: Path | None, log: logging.Logger):
        self._own = {one.name: one for one in own}
        self._folder = folder
        self._log = log
        self._described: Counter[str] = Counter()
        self.known = KnownTypes(self._own.values())

    def describe(self, robot: str, patterns: Iterable[str]) -> LinkTypes:
        """Describe the types that a robot sends. What goes beyond the limits is left out.

        Args:
            robot: its name.
            patterns: of the types that it sends.
        """
        wanted = tuple(patterns)
        sent = [one for one in self._own.values() if any(fnmatchcase(one.name, each) for each in wanted)]
        types = [LinkType(name=one.name, version_number=one.version, schema=one.schema) for one in sent]
        return LinkTypes(robot=robot, types=list(_within_limits(types)))

    def learn(self, robot: str, data: bytes, may_send: Callable[[str], bool]) -> bool:
        """Make the types of another robot known in the run, so that tools and recorders can read them.

        Args:
            robot: the robot.
            data: its `LinkTypes`.
            may_send: whether it may send messages of a type.

        Returns:
            False if they are refused as a whole.
        """
        try:
            described = list(_within_limits(LinkTypes.decode(data).types))
        except MessageError:
            return False
        # To check a schema takes a while, and commands wait meanwhile.
        self._described[robot] += len(described)
        if self._described[robot] > MAX_DESCRIBED:
            return False
        for one in described:
            if may_send(one.name):
                self._learn_or_say_why_not(robot, one)
        self.known = KnownTypes(self._own.values())
        return True

    def _learn_or_say_why_not(self, robot: str, described: LinkType) -> None:
        found = TypeDescription(described.name, int(described.version_number), described.schema)
        try:
            if not self._is_known(found):
                self._learn(found)
        except TypeRefused as error:
            self._log.warning("%s of %s is not learnt: %s", one_line(found.name), robot, error)

    def _is_known(self, found: TypeDescription) -> bool:
        try:
            own = self.known.describe(found.name)
        except UnknownType:
            return False
        if own[:3] != found[:3]:
            raise TypeRefused("this robot knows another definition of it")
        return True

    def _learn(self, found: TypeDescription) -> None:
        try:
            check_type(found.name, found.version)
            KnownTypes([found]).get(found.name)
            is_learnt = self._folder is None or learn_type(self._folder, found)
        except (MessageError, OSError) as error:
            raise TypeRefused(str(error)) from error
        if not is_learnt:
            raise TypeRefused("this run has had another definition of it; start it again")
        self._own[found.name] = found


def _within_limits(types: Iterable[LinkType]) -> Iterator[LinkType]:
    left = MAX_BYTES
    for one in list(types)[:MAX_TYPES]:
        left -= len(one.schema)
        if left >= 0:
            yield one
