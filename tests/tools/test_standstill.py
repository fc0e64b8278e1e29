"""The judgement of `tools.standstill` on made-up motions, and one cell of it on a real robot."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from tests._support.robot import wait_until
from tools.robot import Robot
from tools.standstill.__main__ import measure_way
from tools.standstill.failures import failures_of
from tools.standstill.judgement import TrueMotion, judge
from tools.standstill.scene import CoreSeen
from tools.standstill.table import Cell, summary, table
from tools.standstill.ways import WAYS

LIMIT_S, PERIOD_S, SPEED_M_PER_S = 0.4, 0.05, 0.2
FAILED_S = 10.0


def motion(moving: Sequence[tuple[float, float]], end_s: float = 2.0) -> NDArray[np.float64]:
    """A robot that drives straight before the failure and at these times (from, to) after it."""
    at_s = np.arange(-0.5, end_s, PERIOD_S)
    drives = (at_s <= 0.0) | np.any([(at_s >= begin) & (at_s < end) for begin, end in moving], axis=0)
    speed = np.where(drives, SPEED_M_PER_S, 0.0)
    x_m = np.cumsum(speed) * PERIOD_S
    return np.stack([at_s + FAILED_S, speed, np.zeros_like(x_m), x_m, np.zeros_like(x_m)], axis=1)


def judged(rows: NDArray[np.float64], fresh_s: float = math.inf, until_s: float = 2.0) -> TrueMotion:
    return judge(rows, FAILED_S, FAILED_S + fresh_s, FAILED_S + until_s, LIMIT_S)


def test_robot_that_stops_in_time_keeps_the_limit() -> None:
    found = judged(motion([(0.0, 0.3)]))
    assert found.stands_s == pytest.approx(0.3, abs=1.1 * PERIOD_S)
    assert found.driven_m == found.blind_m == pytest.approx(0.06, abs=0.011)
    assert found.keeps(LIMIT_S)


def test_robot_that_stops_late_does_not() -> None:
    found = judged(motion([(0.0, 0.6)]))
    assert found.stands_s == pytest.approx(0.6, abs=1.1 * PERIOD_S)
    assert not found.keeps(LIMIT_S)


def test_robot_that_never_stops_drives_blind() -> None:
    found = judged(motion([(0.0, 2.0)]))
    assert math.isinf(found.stands_s)
    assert found.blind_m == pytest.approx(0.4, abs=0.02)
    assert not found.keeps(LIMIT_S)


def test_pause_that_does_not_last_is_no_stand() -> None:
    found = judged(motion([(0.0, 0.2), (0.3, 0.8)]))
    assert found.stands_s == pytest.approx(0.8, abs=1.1 * PERIOD_S)


def test_robot_that_stands_and_moves_again_within_the_limit_counts_from_when_it_stands_at_last() -> None:
    rows = motion([(0.1, 0.3)])
    rows[rows[:, 0] < FAILED_S + 0.1, 1] = 0.0
    assert judged(rows).stands_s == pytest.approx(0.3, abs=1.1 * PERIOD_S)
    assert judged(rows).keeps(LIMIT_S)


def test_first_stand_counts_although_the_robot_goes_on() -> None:
    found = judged(motion([(0.0, 0.2), (0.7, 2.0)]), fresh_s=0.65)
    assert found.stands_s == pytest.approx(0.2, abs=1.1 * PERIOD_S)
    assert found.resumed_s == pytest.approx(0.7, abs=1.1 * PERIOD_S)
    assert found.driven_m == pytest.approx(0.04, abs=0.011)
    assert found.keeps(LIMIT_S)


def test_robot_that_goes_on_before_it_has_fresh_data_drives_blind() -> None:
    assert not judged(motion([(0.0, 0.2), (0.7, 2.0)]), fresh_s=1.5).keeps(LIMIT_S)
    assert not judged(motion([(0.0, 0.2), (0.7, 2.0)])).keeps(LIMIT_S)


def test_robot_may_drive_on_when_fresh_data_is_back_in_time() -> None:
    found = judged(motion([(0.0, 2.0)]), fresh_s=0.2)
    assert found.blind_m == pytest.approx(0.04, abs=0.011)
    assert found.keeps(LIMIT_S)
    assert not judged(motion([(0.0, 2.0)]), fresh_s=0.6).keeps(LIMIT_S)


def test_robot_that_stood_already_stands_at_once() -> None:
    rows = motion([])
    rows[:, 1] = 0.0
    assert judged(rows).stands_s == 0.0


def test_turning_on_the_spot_is_no_stand() -> None:
    rows = motion([])
    rows[rows[:, 0] < FAILED_S + 1.0, 2] = 0.5
    assert judged(rows).stands_s == pytest.approx(1.0, abs=1.1 * PERIOD_S)


def test_robot_that_nobody_saw_keeps_no_limit() -> None:
    rows = motion([(0.0, 0.3)])
    for seen in (
        rows[:0],
        rows[rows[:, 0] < FAILED_S + 0.1],
        rows[np.abs(rows[:, 0] - FAILED_S - 0.5) > 0.3],
    ):
        found = judged(seen)
        assert math.isnan(found.stands_s)
        assert not found.keeps(LIMIT_S)


def test_table_shows_the_worst_round_and_what_was_not_tried() -> None:
    good, bad = judged(motion([(0.0, 0.3)])), judged(motion([(0.0, 0.6)]))
    cells = [
        Cell("race", "laser stopped", one, "", load, LIMIT_S) for one, load in ((good, 1.0), (bad, 2.0))
    ] + [Cell("race", "core killed", None, "the robot does not drive", 3.0, LIMIT_S)]
    assert table(cells).splitlines()[2:] == [
        f"| laser stopped | **{bad.stands_s:.2f} s, 0.12 m** |",
        "| core killed | not tried |",
    ]
    assert summary(cells).splitlines() == [
        "1 of 2 cells tried, 2 measurements, 1 cells late; load 1 to 3",
        f"late: race: laser stopped: **{bad.stands_s:.2f} s, 0.12 m**",
        "not tried: race: core killed: the robot does not drive",
    ]


def test_every_process_that_a_way_needs_is_killed_stopped_and_spins() -> None:
    for name, way in WAYS.items():
        found = failures_of(name, way)
        assert way.dead_man in way.needed
        for role in way.needed:
            assert {f"{role} killed", f"{role} stopped"} <= set(found)
        assert ("network cut" in found) == way.is_far


@pytest.mark.every_turn
@pytest.mark.alone
def test_robot_driven_by_hand_is_measured() -> None:
    (stopped,) = measure_way(
        "by hand", {"hand stopped": failures_of("by hand", WAYS["by hand"])["hand stopped"]}, 1.0
    )
    assert stopped.motion, stopped.trouble
    assert stopped.motion.speed_m_per_s > 0.15
    assert 0.0 < stopped.motion.driven_m < 0.2
    assert stopped.keeps


@dataclass
class LookedAt:
    """A run whose figures are those of a script, a look after the other; each look takes a while."""

    looks: list[tuple[int, int, int]]
    """Incarnation of the core, whether it has begun its work, and what the base has handled."""
    started_ns: int = 0

    def figures(self) -> dict[str, SimpleNamespace]:
        time.sleep(0.03)
        self.now = self.looks.pop(0) if len(self.looks) > 1 else self.looks[0]
        incarnation, _, handled = self.now
        core = SimpleNamespace(incarnation=incarnation, started_ns=self.started_ns + incarnation)
        return {"core": core, "base": SimpleNamespace(handled=handled)}

    @property
    def observer(self) -> SimpleNamespace:
        return SimpleNamespace(
            core=lambda: SimpleNamespace(heartbeat_ns=self.started_ns + 1 + self.now[1] * 9)
        )


def test_new_core_gives_something_from_the_last_look_at_which_it_had_given_nothing() -> None:
    """On a busy machine the robot seemed to move before the new core delivered."""
    begun_s = time.monotonic()
    robot = LookedAt([(1, 1, 5), (1, 1, 7), (2, 0, 8), (2, 1, 8), (2, 1, 9)], time.monotonic_ns())
    seen = CoreSeen(cast(Robot, robot))
    wait_until(lambda: math.isfinite(seen.first_after(0.0)))
    seen.close()
    # The fourth look began after three had ended, and the base had handled something by the fifth.
    assert begun_s + 0.09 <= seen.first_after(0.0) <= time.monotonic() - 0.06
