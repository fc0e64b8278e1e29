"""The operator starts, pauses and aborts the mission and calls the robot home; invalid orders are refused."""

from typing import Any

import numpy as np
import pytest

from robbie_robots.workers.rescue.mission_orders import OperatorOrder, OperatorOrders
from robbie_robots.workers.rescue.mission_states import MissionState
from robbie_robots.workers.rescue.victim_map import VictimState
from tests._support.present import present
from tests.workers._support.mission_world import HALL, START, Rescue

S = MissionState


def under_way() -> Rescue:
    rescue = Rescue(HALL)
    rescue.begin()
    assert rescue.state() is S.SEARCH
    return rescue


def restarted(rescue: Rescue, **settings: Any) -> Rescue:
    """The same robot, after the mission's process has been killed."""
    again = Rescue(HALL, **settings)
    again.now_s, again.pose, again.memory = rescue.now_s, rescue.pose, rescue.memory
    again.mission.remember(rescue.mission.memory())
    return again


def test_mission_waits_for_its_start_and_its_time_does_not_run() -> None:
    rescue = Rescue(HALL, starts_by_itself=False, time_limit_s=100.0)
    rescue.begin()
    assert rescue.step(1000.0).goal is None
    assert rescue.state() is S.WAIT
    assert "the operator's start" in rescue.mission.status
    rescue.pose = np.add(rescue.pose, (0.5, 0.0, 0.0))  # somebody carries it to where it begins
    rescue.step()
    assert rescue.mission.order(OperatorOrder.START) is None
    assert rescue.step().goal is not None
    assert rescue.mission.home == pytest.approx(rescue.pose)
    assert rescue.mission.limits.used_s <= 2.0


def test_paused_robot_waits_and_continues_its_task_when_resumed() -> None:
    rescue = under_way()
    goal = rescue.step().goal
    assert rescue.mission.order(OperatorOrder.PAUSE) is None
    assert rescue.step().goal is None
    assert rescue.state() is S.PAUSE
    assert rescue.step(500.0).goal is None
    rescue.mission.arrived()  # at where it stands
    assert rescue.state() is S.PAUSE
    assert rescue.mission.order(OperatorOrder.START) is None
    assert rescue.step().goal == pytest.approx(goal)


def test_time_continues_during_a_pause() -> None:
    rescue = Rescue(HALL, time_limit_s=100.0)
    rescue.begin()
    rescue.mission.order(OperatorOrder.PAUSE)
    rescue.step(99.0)
    assert (rescue.state(), rescue.mission.machine.reason) == (S.FAILED, "the time is over")


def test_time_may_stand_during_a_pause_also_if_the_mission_is_restarted() -> None:
    rescue = Rescue(HALL, time_limit_s=100.0, pause_stops_time=True)
    rescue.begin()
    rescue.mission.order(OperatorOrder.PAUSE)
    rescue.step()
    used_s = rescue.mission.limits.used_s
    rescue.step(500.0)
    assert (rescue.state(), rescue.mission.limits.used_s) == (S.PAUSE, used_s)
    again = restarted(rescue, time_limit_s=100.0, pause_stops_time=True)
    again.begin()
    again.step(500.0)
    assert again.mission.limits.used_s == pytest.approx(used_s, abs=5.0)
    again.mission.order(OperatorOrder.START)
    again.step()
    assert again.state() is S.SEARCH
    again.step(again.mission.settings.time_limit_s)
    assert (again.state(), again.mission.machine.reason) == (S.FAILED, "the time is over")


def test_battery_is_judged_by_all_the_time_with_pauses() -> None:
    rescue = under_way()
    limits = rescue.mission.limits
    limits.see_battery(0.9)
    rescue.mission.order(OperatorOrder.PAUSE)
    rescue.step(1000.0)
    limits.see_battery(0.8)
    assert limits.battery_lasts_s() == pytest.approx(6500.0, rel=0.02)
    assert restarted(rescue).mission.limits.battery_lasts_s() == pytest.approx(6500.0, rel=0.02)


def test_resumed_robot_that_cannot_drive_reports_it() -> None:
    rescue = under_way()
    rescue.mission.order(OperatorOrder.PAUSE)
    rescue.step()
    rescue.mission.see_stopped("STOPPED_NO_LASER: the laser is silent")
    rescue.step()
    assert rescue.state() is S.PAUSE
    rescue.mission.order(OperatorOrder.START)
    rescue.step()
    assert rescue.state() is S.HALT


def test_robot_paused_while_returning_continues_home() -> None:
    rescue = under_way()
    rescue.mission.order(OperatorOrder.RETURN)
    rescue.step()
    rescue.mission.order(OperatorOrder.PAUSE)
    assert rescue.step().goal is None
    rescue.mission.order(OperatorOrder.START)
    assert rescue.step().goal == pytest.approx(START)


@pytest.mark.parametrize("paused", [False, True])
def test_robot_called_home_drives_there_at_once(paused: bool) -> None:
    rescue = under_way()
    rescue.pose = present(rescue.step().goal)
    if paused:
        rescue.mission.order(OperatorOrder.PAUSE)
        rescue.step()
    assert rescue.mission.order(OperatorOrder.RETURN) is None
    assert rescue.step(0.0).goal == pytest.approx(START)
    assert rescue.drive()[-2:] == [S.RETURN, S.DONE]
    assert rescue.pose == pytest.approx(START)


def test_robot_called_home_while_it_cannot_drive_returns_when_it_can() -> None:
    rescue = under_way()
    rescue.mission.see_stopped("EMERGENCY_STOP: pressed")
    rescue.step()
    assert rescue.mission.order(OperatorOrder.RETURN) is None
    assert rescue.step().goal is None
    rescue.mission.see_stopped(None)
    assert rescue.step().goal == pytest.approx(START)


def test_aborted_mission_ends_where_the_robot_is() -> None:
    rescue = under_way()
    assert rescue.mission.order(OperatorOrder.ABORT) is None
    assert (rescue.state(), rescue.mission.machine.reason) == (S.ABORTED, "aborted by the operator")
    assert rescue.step().goal is None


@pytest.mark.parametrize(
    ("order", "state"),
    [
        (OperatorOrder.PAUSE, S.PAUSE),
        (OperatorOrder.RETURN, S.RETURN),
        (OperatorOrder.ABORT, S.ABORTED),
        (OperatorOrder.START, S.SEARCH),
    ],
)
def test_orders_outlive_a_restart_of_the_mission(order: OperatorOrder, state: S) -> None:
    rescue = under_way()
    if order is OperatorOrder.START:
        rescue.mission.order(OperatorOrder.PAUSE)
        rescue.step()
    rescue.mission.order(order)
    again = restarted(rescue)
    again.begin()
    assert again.state() is state


def test_mission_restarted_before_its_start_still_waits_for_it() -> None:
    rescue = Rescue(HALL, starts_by_itself=False)
    rescue.begin()
    again = restarted(rescue)
    again.begin()
    assert again.state() is S.WAIT
    assert again.step().goal is None


@pytest.mark.parametrize(
    ("held", "begun", "state", "fitting"),
    [
        (True, False, S.WAIT, [OperatorOrder.START, OperatorOrder.ABORT]),
        (False, False, S.WAIT, [OperatorOrder.PAUSE, OperatorOrder.ABORT]),
        (False, True, S.SEARCH, [OperatorOrder.PAUSE, OperatorOrder.ABORT, OperatorOrder.RETURN]),
        (False, True, S.HALT, [OperatorOrder.PAUSE, OperatorOrder.ABORT, OperatorOrder.RETURN]),
        (True, True, S.PAUSE, [OperatorOrder.START, OperatorOrder.ABORT, OperatorOrder.RETURN]),
        (False, True, S.RETURN, [OperatorOrder.PAUSE, OperatorOrder.ABORT]),
        (False, True, S.DONE, [OperatorOrder.START, OperatorOrder.RETURN]),
        (False, False, S.FAILED, [OperatorOrder.START]),
    ],
)
def test_only_orders_that_fit_the_state_are_obeyed(
    held: bool, begun: bool, state: S, fitting: list[OperatorOrder]
) -> None:
    orders = OperatorOrders(starts_by_itself=not held)
    orders.has_begun = begun
    assert orders.fitting(state) == fitting
    for order in OperatorOrder:
        refusal = orders.refusal(order, state)
        assert (refusal is None) == (order in fitting)
        assert refusal is None or refusal.startswith(order.name)


def test_refused_order_changes_nothing_and_has_a_reason() -> None:
    rescue = under_way()
    assert rescue.mission.order(OperatorOrder.START) == "START: the mission is under way"
    assert present(rescue.mission.order(9)).startswith("there is no order 9; orders are 0 (START)")
    assert rescue.state() is S.SEARCH
    rescue.mission.order(OperatorOrder.ABORT)
    assert rescue.mission.order(OperatorOrder.PAUSE) == "PAUSE: the mission has ended"
    assert rescue.state() is S.ABORTED


def test_operator_calls_the_robot_home_after_a_mission_that_has_failed() -> None:
    rescue = Rescue(HALL, time_limit_s=100.0)
    rescue.begin()
    rescue.pose = np.add(rescue.pose, (2.0, 0.0, 0.0))
    rescue.step(200.0)
    assert rescue.state() is S.FAILED
    assert rescue.mission.order(OperatorOrder.RETURN) is None
    again = restarted(rescue, time_limit_s=100.0)
    again.begin()
    assert again.step().goal == pytest.approx(rescue.mission.home)
    assert again.drive()[-1] is S.DONE


def test_following_mission_begins_where_the_robot_stands_and_knows_the_victims() -> None:
    rescue = under_way()
    rescue.tell(VictimState.CONFIRMED)
    rescue.mission.order(OperatorOrder.ABORT)
    rescue.pose = np.add(rescue.pose, (1.0, 0.0, 0.0))
    rescue.step()
    first, rescue.mission = rescue.mission, rescue.mission.following()
    rescue.begin()
    assert (rescue.state(), rescue.mission.number) == (S.SEARCH, 2)
    assert rescue.mission.home == pytest.approx(rescue.pose)
    assert rescue.mission.victims.reports == first.victims.reports
    assert rescue.mission.limits.used_s < 10.0
    assert restarted(rescue).mission.number == 2
