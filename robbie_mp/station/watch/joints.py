"""The joints that modules offer to move, where they are, and the commands that move them."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robbie_mp.messages import Header, JointCommand, JointLimits, JointState
from robbie_mp.station.driving.held_control import VALID_FOR
from robbie_mp.station.watch.births import time_before

if TYPE_CHECKING:
    from robbie_mp.station.watch.latest import MessageSource

MAX_JOINTS = 64
"""Maximum number of joints that pages show."""
SILENT_S = 1.0
"""A position that is older than this is not known any more."""


class JointId(NamedTuple):
    """One joint of the robot."""

    topic: str
    """The topic of its commands and states, which is the name of the module that moves it."""
    name: str

    @property
    def key(self) -> str:
        """A text that names the joint to the page's script."""
        return f"{self.topic}/{self.name}"


class JointsWatch:
    """Knows the joints of all modules that offer them with `JointLimits`.

    Args:
        messages: source of the messages.

    Attributes:
        limits: least and greatest position of each joint, rad. The dictionary is replaced and never changed.
    """

    def __init__(self, messages: MessageSource):
        self._messages = messages
        self.limits: dict[JointId, tuple[float, float]] = {}
        self._at: dict[JointId, tuple[float, float]] = {}
        """Position (rad) of each joint, and when it was told."""
        messages.hear(JointLimits, self._on_limits)
        messages.hear(JointState, self._on_state)

    def position_rad(self, joint: JointId) -> float | None:
        """Return where a joint is; None while it is not known."""
        position, told_s = self._at.get(joint, (0.0, -math.inf))
        return position if time.monotonic() - told_s <= SILENT_S else None

    def _on_limits(self, limits: JointLimits) -> None:
        topic = self._messages.envelope.topic
        found = {joint: ends for joint, ends in self.limits.items() if joint.topic != topic}
        ends = zip(limits.name, limits.lower.tolist(), limits.upper.tolist(), strict=False)
        for name, lower, upper in ends:
            if len(found) < MAX_JOINTS and math.isfinite(lower) and math.isfinite(upper) and lower < upper:
                found[JointId(topic, name)] = (lower, upper)
        self.limits = found  # a new dictionary, because the pages read the old one meanwhile

    def _on_state(self, state: JointState) -> None:
        topic, now_s = self._messages.envelope.topic, time.monotonic()
        told = {
            joint: (position, now_s)
            for name, position in zip(state.name, state.position.tolist(), strict=False)
            if (joint := JointId(topic, name)) in self.limits and math.isfinite(position)
        }
        if told:
            self._at = {**self._at, **told}

    def commands(self, positions: dict[str, float], age_s: float, header: Header) -> dict[str, JointCommand]:
        """Return the commands for goals, by topic; goals beyond a joint's limits end at the limit.

        Args:
            positions: by the keys of the joints, rad. Joints that do not exist are ignored.
            age_s: greatest age of the operator's input.
            header: from when that age counts.
        """
        wanted: dict[str, dict[str, float]] = {}
        for joint, (lower, upper) in self.limits.items():
            if joint.key in positions:
                goal = max(lower, min(upper, positions[joint.key]))
                wanted.setdefault(joint.topic, {})[joint.name] = goal
        return {
            topic: JointCommand(
                header=header,
                name=[*goals],
                position=np.array([*goals.values()]),
                valid_for=VALID_FOR,
                based_on=time_before(header.stamp, age_s),
                by_hand=True,
            )
            for topic, goals in wanted.items()
        }
