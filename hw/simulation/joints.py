"""Simulated joints."""

from collections.abc import Callable, Mapping, Sequence

from robbie_robots.hw.joints import Joint, JointReading, Joints, capped_validity_s, checked


class SimulatedJoints(Joints):
    """Joints that move at constant speed, according to a clock. A joint that is let go stays where it is.

    Args:
        joints: the joints; they begin at 0, or at the nearest limit.
        clock: returns the time in s; it must not go back.
        positions: where joints begin instead, by name.
    """

    def __init__(
        self,
        joints: Sequence[Joint],
        clock: Callable[[], float],
        positions: Mapping[str, float] | None = None,
    ) -> None:
        self._joints, self._clock = tuple(joints), clock
        begin = positions or {}
        self._positions = [
            max(joint.least_rad, min(joint.most_rad, begin.get(joint.name, 0.0))) for joint in self._joints
        ]
        self._blocked: dict[str, float] = {}
        self._goals = list(self._positions)
        self._time_s = clock()
        self._until_s: float | None = None
        self.expired_commands = 0
        """How many commands have ended because no newer one came in time."""

    @property
    def joints(self) -> Sequence[Joint]:
        """Return the joints."""
        return self._joints

    def command(self, positions_rad: Mapping[str, float], valid_for_s: float) -> None:
        """Move joints to positions."""
        goals = checked(self._joints, positions_rad, valid_for_s)
        self._advance()
        for place, goal in goals.items():
            self._goals[place] = goal
        self._until_s = self._time_s + capped_validity_s(valid_for_s)

    def block(self, name: str, least: float | None) -> None:
        """Let something stand in the way of a joint: it does not go below `least`. None: the way is free."""
        self._advance()
        if least is None:
            self._blocked.pop(name, None)
            return
        self._blocked[name] = least
        place = [joint.name for joint in self._joints].index(name)
        self._positions[place] = max(self._positions[place], least)

    def is_pushing(self, name: str) -> bool:
        """Return whether a joint pushes against what blocks it."""
        place = [joint.name for joint in self._joints].index(name)
        return name in self._blocked and self._goals[place] < self._blocked[name] >= self._positions[place]

    def release(self) -> None:
        """Let all joints go."""
        self._advance()
        self._goals, self._until_s = list(self._positions), None

    def read(self) -> JointReading:
        """Return where the joints are."""
        self._advance()
        speeds = tuple(
            0.0
            if goal == position or self.is_pushing(joint.name)
            else joint.speed_rad_per_s * (1 if goal > position else -1)
            for joint, goal, position in zip(self._joints, self._goals, self._positions, strict=True)
        )
        return JointReading(self._time_s, tuple(self._positions), speeds)

    def _advance(self) -> None:
        now_s = self._clock()
        if self._until_s is not None and now_s >= self._until_s:
            self._move(self._until_s)
            self._goals, self._until_s = list(self._positions), None
            self.expired_commands += 1
        self._move(now_s)

    def _move(self, to_s: float) -> None:
        passed_s, self._time_s = to_s - self._time_s, to_s
        for place, joint in enumerate(self._joints):
            most = joint.speed_rad_per_s * passed_s
            missing = self._goals[place] - self._positions[place]
            self._positions[place] += max(-most, min(most, missing))
            least = self._blocked.get(joint.name)
            if least is not None:
                self._positions[place] = max(self._positions[place], least)
