"""The mission's knowledge about victims."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robbie_robots.workers.rescue.victim_map import VictimState

SAME_M = 0.5


@dataclass(frozen=True)
class VictimReport:
    """A victim as listed in the report.

    Attributes:
        id: its number.
        name: shown to people.
        x_m: where it is, map frame.
        y_m: where it is, map frame.
        z_m: where it is, map frame.
        facing_rad: the direction it faces.
        found_s: when it was first seen, s since the epoch of the robot's clock.
        confidence: 0 to 1.
        state: its state, as in `VictimState`.
    """

    id: int
    name: str
    x_m: float
    y_m: float
    z_m: float
    facing_rad: float
    found_s: float
    confidence: float
    state: VictimState


class MissionVictims:
    """Keeps the newest report of each victim."""

    def __init__(self) -> None:
        self.reports: dict[int, VictimReport] = {}
        self._waited_for: set[int] = set()
        self._settled: set[int] = set()

    def see(self, report: VictimReport) -> None:
        """Store a report of a victim, but keep the time when the victim was first found."""
        if report.id in self._settled:
            return
        self._keep(report)

    def settle(self, report: VictimReport) -> None:
        """Store another robot's report of a victim that needs no more views: this robot need not see it."""
        self._settled.add(report.id)
        before = self.reports.get(report.id)
        if before is None or before.state is not VictimState.CONFIRMED:
            self._keep(report)

    def _keep(self, report: VictimReport) -> None:
        before = self.reports.get(report.id)
        found_s = report.found_s if before is None else before.found_s
        self.reports[report.id] = VictimReport(**{**vars(report), "found_s": found_s})
        if report.state is not VictimState.ASKED:
            self._waited_for.discard(report.id)

    @property
    def suspected(self) -> list[tuple[NDArray[np.float64], float]]:
        """Return x, y (m) and facing (rad) of the victims that need a better view, map frame."""
        return [
            (np.array([report.x_m, report.y_m]), report.facing_rad)
            for report in self.reports.values()
            if report.state is VictimState.SUSPECTED
        ]

    @property
    def suspected_ids(self) -> set[int]:
        """Return the numbers of the victims that need a better view."""
        return {report.id for report in self.reports.values() if report.state is VictimState.SUSPECTED}

    def is_suspected_at(self, xy_m: ArrayLike) -> bool:
        """Return whether a victim near a place, m, map frame, needs a better view."""
        x, y = np.asarray(xy_m, float).tolist()
        return any(math.dist(place, (x, y)) <= SAME_M for place, _ in self.suspected)

    @property
    def _asked(self) -> list[VictimReport]:
        return [report for report in self.reports.values() if report.state is VictimState.ASKED]

    @property
    def is_asked(self) -> bool:
        """Return whether a question to the operator is unanswered."""
        return bool(self._asked)

    @property
    def asked_name(self) -> str:
        """Return the victim that the operator has been asked about; '' if none."""
        return ", ".join(report.name for report in self._asked)

    @property
    def is_waited_for(self) -> bool:
        """Return whether the robot has already waited for every pending answer."""
        return all(report.id in self._waited_for for report in self._asked)

    def wait_for_answer(self) -> None:
        """Note that the robot waits for the answers. It waits once for each question."""
        self._waited_for.update(report.id for report in self._asked)

    @property
    def summary(self) -> str:
        """Return the number of victims, in a few words."""
        confirmed = sum(report.state is VictimState.CONFIRMED for report in self.reports.values())
        return f"{len(self.reports)} victims, {confirmed} confirmed"

    def memory(self) -> list[dict[str, Any]]:
        """Return all reports as plain data."""
        return [{**asdict(report), "state": int(report.state)} for report in self.reports.values()]

    def remember(self, memory: list[Mapping[str, Any]]) -> None:
        """Restore the data that `memory` returned."""
        for entry in memory:
            report = VictimReport(**{**entry, "state": VictimState(entry["state"])})
            self.reports[report.id] = report
