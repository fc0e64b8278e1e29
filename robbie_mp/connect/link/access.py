"""Access to a link: a list in the profile says which robot may send what. Without it, none may.

    settings:
      accept:
        laptop: [Twist cmd_vel, robbie/msg/EmergencyStop]
        "*": [LaserScan, PoseStamped pose]

Here, the robot `laptop` may send velocities on one topic and emergency stops on any; every robot may send
laser scans on any topic, and poses on one.
"""

import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.visible_text import one_line
from robbie_mp.logs.capture.selection import TypeAndTopic, type_pattern
from robbie_mp.run.trace.log_limit import LogLimit

MAX_RULES = 1000
MAX_COUNTED = 256
"""Most channels of which refusals are counted one by one; those of others are counted together."""
MAX_DECISIONS = 4096
"""Most decisions that are remembered, so that not every message is compared with every rule."""
OTHERS = "others"


class AccessError(RobbieError, ValueError):
    """A rule about who may send what cannot be understood; the text says which and how it should be."""


class LinkAccess:
    """Decides whether a message from another robot may come in.

    Args:
        accept: for each robot, the messages that it may send: shell patterns of the type, or of type and
            topic with a space between. `LaserScan` is that type in any package. The robot's name may be a
            pattern, too; what one matching name allows is allowed.
        log: where refusals are traced, at a limited rate.

    Raises:
        AccessError: a rule is wrong.

    Attributes:
        refused: number of refused messages by robot, type and topic, in one text.
    """

    def __init__(self, accept: Mapping[str, Sequence[str]], log: logging.Logger):
        self._rules = read_rules(accept)
        self._log, self._limit = log, LogLimit()
        self._decisions: dict[tuple[str, str, str], bool] = {}
        self.refused: Counter[str] = Counter()

    @property
    def refused_total(self) -> int:
        """Number of all refused messages."""
        return self.refused.total()

    def allows(self, robot: str, type_name: str, topic: str) -> bool:
        """Return whether a message may come in; a refusal is counted and traced.

        Args:
            robot: the sender.
            type_name: full name of its type.
            topic: its topic, as the profile of this robot would name it.
        """
        key = (robot, type_name, topic)
        allowed = self._decisions.get(key)
        if allowed is None:
            allowed = any(
                fnmatchcase(robot, name) and any(pair.matches(type_name, topic) for pair in pairs)
                for name, pairs in self._rules
            )
            if len(self._decisions) >= MAX_DECISIONS:
                self._decisions.clear()
            self._decisions[key] = allowed
        if not allowed:
            self._refuse(key)
        return allowed

    def may_send(self, robot: str | None, type_name: str) -> bool:
        """Return whether a robot may send messages of a type on any topic at all.

        Args:
            robot: the sender; None: any robot.
            type_name: full name of the type.
        """
        return any(
            (robot is None or fnmatchcase(robot, name))
            and any(fnmatchcase(type_name, pair.type) for pair in pairs)
            for name, pairs in self._rules
        )

    def _refuse(self, key: tuple[str, str, str]) -> None:
        robot, type_name, topic = (one_line(text) for text in key)
        what = f"{type_name} on {topic!r} from {robot}" if topic else f"{type_name} from {robot}"
        if what not in self.refused and len(self.refused) >= MAX_COUNTED:
            what = OTHERS
        self.refused[what] += 1
        text = "refused %s; the setting `accept` does not allow it"
        record = self._log.makeRecord(self._log.name, logging.WARNING, __file__, 0, text, (what,), None)
        if self._limit.filter(record):
            self._log.handle(record)


def read_rules(accept: Mapping[str, Sequence[str]]) -> list[tuple[str, list[TypeAndTopic]]]:
    """Return robots' names and the pairs of type and topic that they may send.

    Raises:
        AccessError: a rule is wrong; the text has a line for each.
    """
    problems: list[str] = []
    rules: list[tuple[str, list[TypeAndTopic]]] = []
    for robot, patterns in accept.items():
        if not robot or any(character.isspace() for character in robot):
            problems.append(f"expected the name of a robot, or a pattern such as '*'; got {robot!r}")
        pairs = []
        for index, pattern in enumerate(patterns):
            words = pattern.split()
            if len(words) in (1, 2):
                pairs.append(TypeAndTopic(type_pattern(words[0]), words[1] if len(words) == 2 else "*"))
            else:
                problems.append(
                    f"key {robot!r}: element {index}: expected a type, or a type and a topic with a space "
                    f"between, such as 'Twist cmd_vel'; got {pattern!r}"
                )
        rules.append((robot, pairs))
    if sum(len(pairs) for _, pairs in rules) > MAX_RULES:
        problems.append(f"there are more than {MAX_RULES} rules; use patterns")
    if problems:
        raise AccessError("\n".join(problems))
    return rules
