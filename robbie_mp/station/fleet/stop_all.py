"""One press that stops all robots: each base confirms it, and who has not is named."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from robbie_mp.station.fleet.robots import OtherRobots
    from robbie_mp.station.stop.requests import StopRequests

OWN = ""
"""The name under which this robot stands among the others: no robot at a link has it."""
UNKNOWN = "not known"


class StopAll:
    """Passes a press on to all robots. Any thread may call it.

    Args:
        own: the stops of this robot.
        own_state: returns the state of its emergency stop, in words.
        team: the other robots.
    """

    def __init__(
        self,
        own: StopRequests,
        own_state: Callable[[], str],
        team: OtherRobots,
    ):
        self._own, self._own_state, self._team = own, own_state, team

    def press(self, name: str, settled: Collection[str]) -> None:
        """Stop all robots but those that have confirmed this press before.

        Args:
            name: of the press.
            settled: the robots that have, as the page knows; this station may have been restarted since.
        """
        if OWN not in settled:
            self._own.press(name)
        for robot in self._team.all.values():
            if robot.name not in settled:
                robot.requests.press(name)

    def states(self, press: str) -> list[dict[str, str]]:
        """Return each robot with the state of its stop, and what has become of a press there.

        A press has no fate at robots that this station cannot stop, so a page keeps it meanwhile.
        """
        own = {"robot": OWN, "state": self._own_state(), "fate": self._own.fate(press) or ""}
        unknown = self._team.unknown
        return [
            own,
            *(
                {"robot": one.name, "state": one.stop_state, "fate": one.requests.fate(press) or ""}
                for one in self._team.all.values()
            ),
            *([{"robot": unknown, "state": UNKNOWN, "fate": ""}] if unknown else []),
        ]
