"""Measures how much a stopped and a hoarding subscriber slow down a healthy one of the same camera."""

import signal
import time
from dataclasses import dataclass
from statistics import median
from typing import Any

from tools.kill_campaign.modules import HOARD_FILE
from tools.kill_campaign.profile import CAMERA, HOARDER, STOPPED_VIEWER, VIEWER
from tools.robot import Robot

WINDOW_S = 3.0
"""Time for which a rate is measured. With the time before it, too short for a stopped module to be hung."""
FILL_S = 3.0
"""Twice the time that the camera needs to fill all its memory."""
ALLOWED_RATIO = 0.9


@dataclass(frozen=True)
class Rates:
    """Rates per second."""

    viewed_hz: float
    taken_hz: float
    """Images that the camera made, including those for which no memory was free."""


def measure_neighbours(robot: Robot, rounds: int) -> dict[str, Any]:
    """Compare the viewer's rate while one viewer is stopped and another hoards with its own rate just before.

    The viewer's rate is divided by the camera's, which varies on a busy machine. The result is the median of
    several rounds. Afterwards the hoarder keeps hoarding.
    """
    ratios, before, during = [], [], []
    hoard = robot.output / HOARD_FILE
    for _ in range(rounds):
        robot.wait_for(
            lambda: not robot.figures()[HOARDER].pinned, "the hoarder does not release its messages"
        )
        calm = _rates(robot)
        hoard.touch()
        pid = robot.figures()[STOPPED_VIEWER].pid
        robot.send(pid, signal.SIGSTOP)
        try:
            time.sleep(FILL_S)
            troubled = _rates(robot)
        finally:
            robot.send(pid, signal.SIGCONT)
            hoard.unlink()
        before.append(calm)
        during.append(troubled)
        ratios.append(ratio_of(calm, troubled))
    hoard.touch()
    figures = robot.figures()
    return {
        "viewed_hz_before": [round(rates.viewed_hz, 1) for rates in before],
        "viewed_hz_during": [round(rates.viewed_hz, 1) for rates in during],
        "taken_hz_before": [round(rates.taken_hz, 1) for rates in before],
        "taken_hz_during": [round(rates.taken_hz, 1) for rates in during],
        "ratios": [round(ratio, 3) for ratio in ratios],
        "camera_refused": figures[CAMERA].refused,
        "stopped_viewer_dropped": figures[STOPPED_VIEWER].total("dropped"),
        "hoarder_copied": figures[HOARDER].copied,
    }


def ratio_of(before: Rates, during: Rates) -> float:
    """Return the share of its rate that the viewer kept, or 0 if it or the camera did nothing."""
    if not before.viewed_hz or not before.taken_hz or not during.taken_hz:
        return 0.0
    return (during.viewed_hz / during.taken_hz) / (before.viewed_hz / before.taken_hz)


def violations(report: dict[str, Any]) -> list[str]:
    """Return the violations in the measurements."""
    ratio = median(report["ratios"])
    if ratio >= ALLOWED_RATIO:
        return []
    return [f"beside a stopped viewer and a hoarder, the healthy viewer keeps {ratio:.2f} of its rate"]


def _rates(robot: Robot) -> Rates:
    def counts() -> tuple[int, int, int]:
        figures = robot.figures()
        camera = figures[CAMERA]
        return time.monotonic_ns(), figures[VIEWER].handled, camera.published + camera.refused

    first = counts()
    time.sleep(WINDOW_S)
    time_ns, viewed, taken = (later - earlier for later, earlier in zip(counts(), first, strict=True))
    return Rates(viewed * 1e9 / time_ns, taken * 1e9 / time_ns)
