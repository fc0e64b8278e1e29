"""What the household robot does with an order: its drives, the arm's tasks, persons, and failures."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from robbie_mp.base.state_machine import mermaid
from robbie_mp.bus.checkpoint.image import decode, encode
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.household import COME, OPEN_DOOR, TAKE_IT, HouseholdWork
from robbie_robots.workers.home.household_states import (
    ARM_WORKS,
    TRANSITIONS,
    HouseholdSettings,
    HouseholdState,
)
from robbie_robots.workers.home.orders import Task, TaskOrder, WrongOrder
from tests._support.places import DOCS

PLACES = {"desk": (2.0, 0.0, 0.0), "counter": (4.0, 0.0, 0.0), "kitchen": (4.0, 2.0, 1.0)}
BRING, PUT = TaskOrder(Task.BRING, "soup"), TaskOrder(Task.PUT, "soup", "desk")
GO, FOLLOW = TaskOrder(Task.GO, place="kitchen"), TaskOrder(Task.FOLLOW)
HERE = (0.0, 0.0, 0.0)


class Robot:
    """A robot that is at once where it should be; the soup is on the counter."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.doors: dict[str, tuple[float, float, float]] = {}
        self.states: list[str] = []
        self.said: list[str] = []
        self.pose: Sequence[float] = HERE
        self.work = self.new_work()
        self.work.see_pose(HERE)

    def new_work(self) -> HouseholdWork:
        work = HouseholdWork(
            lambda: self.now_s, ["desk", "counter"], on_change=lambda state: self.states.append(state.name)
        )
        work.places = PLACES
        work.doors = self.doors
        work.see_hand("")
        return work

    def drive(self) -> None:
        goal = self.work.goal
        assert goal is not None
        self.pose = goal.tolist()
        self.work.see_pose(goal)
        self.work.arrived()

    def look(self) -> None:
        """Pick up the soup if it is here."""
        assert self.work.state is HouseholdState.PICK
        assert self.work.goal is None
        if tuple(self.pose) == PLACES["counter"]:
            self.work.see_objects(["soup"])
            self.work.ended(True)
        else:
            self.work.ended(False, "sees no soup on a table")

    def fetch(self) -> None:
        while not self.work.holds:
            self.drive()
            self.look()

    def person(self, x_m: float, y_m: float = 0.0) -> None:
        self.see([(x_m, y_m)])

    def see(self, persons: Sequence[tuple[float, float]], things: Sequence[tuple[float, float]] = ()) -> None:
        self.now_s += 0.2
        self.work.see_persons([PersonReport(str(number), xy_m) for number, xy_m in enumerate(persons)])
        self.work.see_things([PersonReport(str(number), xy_m) for number, xy_m in enumerate(things)])
        self.work.step()

    def bring_to(self, giver: tuple[float, float]) -> None:
        """Come back with the soup to where somebody has ordered it."""
        self.work.begin([BRING])
        self.see([giver])
        self.fetch()
        self.drive()
        assert self.work.state is HouseholdState.MEET


@pytest.fixture
def robot() -> Robot:
    return Robot()


def test_object_is_found_on_the_second_table_and_handed_to_the_person_who_wants_it(robot: Robot) -> None:
    robot.work.begin([BRING])
    robot.fetch()
    assert robot.work.holds == "soup"
    np.testing.assert_array_equal(robot.work.goal, HERE)
    robot.drive()
    robot.person(2.0, 1.0)
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.0, 1.0)) == pytest.approx(HouseholdSettings().before_m)
    robot.work.see_pose(goal)
    robot.person(2.0, 1.0)
    assert robot.work.state is HouseholdState.HAND
    assert robot.work.sayings() == ["I bring you the soup.", TAKE_IT.format("soup")]
    robot.work.ended(True)
    assert (robot.work.order, robot.work.holds) == (None, "")
    assert [(end.order, end.is_done) for end in robot.work.ends] == [(BRING, True)]
    assert robot.states == [
        "FETCH", "PICK", "FETCH", "PICK", "CARRY", "MEET", "HAND", "IDLE",
    ]  # fmt: skip


def test_robot_looks_first_where_it_has_seen_the_object(robot: Robot) -> None:
    robot.work.seen["soup"] = "counter"
    robot.work.begin([BRING])
    np.testing.assert_array_equal(robot.work.goal, PLACES["counter"])


def test_object_that_is_nowhere_is_given_up_after_all_tables_twice(robot: Robot) -> None:
    robot.work.begin([TaskOrder(Task.BRING, "mustard")])
    for _ in range(4):
        robot.drive()
        robot.work.ended(False, "sees no mustard on a table")
    assert robot.work.order is None
    assert "I could not bring you the mustard" in robot.work.sayings()[-1]


def test_grasp_that_fails_where_the_object_is_seen_is_tried_again_there(robot: Robot) -> None:
    robot.work.seen["soup"] = "counter"
    robot.work.begin([BRING])
    for turn in range(3):
        np.testing.assert_array_equal(robot.work.goal, PLACES["counter"])
        robot.drive()
        robot.work.see_objects(["soup"])
        robot.work.ended(False, f"no grasp {turn}")
    np.testing.assert_array_equal(robot.work.goal, PLACES["desk"])


def test_robot_that_navigation_stops_beside_the_table_does_not_use_its_arm(robot: Robot) -> None:
    robot.work.begin([BRING])
    robot.work.see_pose((1.6, 0.0, 0.0))
    robot.work.arrived()
    assert robot.work.state not in ARM_WORKS
    robot.work.see_pose((2.0, 0.05, 0.5))
    robot.work.arrived()
    assert robot.work.state not in ARM_WORKS
    robot.drive()
    assert robot.work.state is HouseholdState.PICK


def test_object_is_put_on_a_table_and_the_robot_knows_it_there(robot: Robot) -> None:
    robot.work.begin([PUT])
    robot.fetch()
    robot.drive()
    assert robot.work.state is HouseholdState.PUT
    robot.work.ended(True)
    assert robot.work.ends[-1].is_done
    robot.work.begin([BRING])
    np.testing.assert_array_equal(robot.work.goal, PLACES["desk"])


def test_object_that_the_hand_has_lost_is_fetched_again(robot: Robot) -> None:
    robot.work.begin([PUT])
    robot.fetch()
    robot.drive()
    robot.work.ended(False, "there is nothing in the hand", is_refused=True)
    assert (robot.work.state, robot.work.holds) == (HouseholdState.FETCH, "")


def test_tasks_follow_one_another_and_a_failed_one_ends_the_order(robot: Robot) -> None:
    robot.work.begin([GO, PUT, FOLLOW])
    robot.drive()
    robot.fetch()
    robot.drive()
    robot.work.ended(True)
    assert robot.work.state is HouseholdState.FOLLOW
    robot.work.ended(True, "was told to stop")
    assert [end.is_done for end in robot.work.ends] == [True, True, True]
    robot.work.begin([GO, FOLLOW])
    for _ in range(3):
        robot.work.unreachable("no path leads to the goal")
    assert (robot.work.order, robot.work.ends[-1].is_done) == (None, False)
    assert robot.work.sayings()[-1] == "I could not go to the kitchen: no path leads to the goal."


def test_bringing_ends_where_the_order_was_given_even_after_another_task(robot: Robot) -> None:
    robot.work.begin([GO, BRING])
    robot.drive()
    robot.fetch()
    np.testing.assert_array_equal(robot.work.goal, HERE)


def test_nobody_who_takes_the_object_ends_the_order_and_the_robot_keeps_it(robot: Robot) -> None:
    robot.work.begin([BRING])
    robot.fetch()
    robot.work.see_hand("soup")
    robot.drive()
    robot.now_s += HouseholdSettings().meet_s + 1.0
    robot.work.step()
    assert (robot.work.order, robot.work.holds) == (None, "soup")
    robot.work.begin([TaskOrder(Task.PUT, place="desk")])
    assert robot.work.state is HouseholdState.CARRY


def test_person_who_stands_where_the_order_was_given_is_met_even_if_the_map_shows_the_legs(
    robot: Robot,
) -> None:
    robot.bring_to((2.0, 1.0))
    robot.see([], things=[(2.05, 1.0), (0.5, -0.5)])
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.05, 1.0)) == pytest.approx(HouseholdSettings().before_m)
    robot.work.see_pose(goal)
    robot.see([], things=[(2.05, 1.0), (0.5, -0.5)])
    assert robot.work.state is HouseholdState.HAND


def test_person_in_front_of_the_robot_has_given_the_order_even_if_others_are_noticed_before(
    robot: Robot,
) -> None:
    robot.work.begin([BRING])
    robot.see([(0.0, -1.0)])
    robot.see([(0.0, -1.0), (2.0, 0.3)])
    robot.see([(0.0, -1.0)])
    robot.fetch()
    robot.drive()
    robot.see([(0.0, -1.0), (2.0, 0.3)])
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.0, 0.3)) == pytest.approx(HouseholdSettings().before_m)


def test_thing_with_one_leg_has_not_given_the_order_if_a_person_with_two_is_there(robot: Robot) -> None:
    corner, person = PersonReport("1", (1.0, 0.0), two_legs=0.1), PersonReport("2", (2.0, 1.5), two_legs=0.9)
    robot.work.begin([BRING])
    robot.work.see_persons([corner, person])
    robot.fetch()
    robot.drive()
    robot.work.see_persons([corner, person])
    robot.work.step()
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.0, 1.5)) == pytest.approx(HouseholdSettings().before_m)


def test_thing_that_took_nothing_is_not_asked_again_but_the_next_who_may_have_given_the_order(
    robot: Robot,
) -> None:
    robot.work.begin([BRING])
    robot.see([(0.9, 0.0), (2.0, 1.0)])
    robot.fetch()
    robot.drive()
    robot.see([(0.9, 0.0)], things=[(2.0, 1.0)])
    assert robot.work.state is HouseholdState.HAND
    robot.work.ended(False, "nobody has taken soup")
    robot.see([(0.9, 0.0)], things=[(2.0, 1.0)])
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.0, 1.0)) == pytest.approx(HouseholdSettings().before_m)


def test_furniture_that_looks_like_legs_gets_nothing(robot: Robot) -> None:
    robot.bring_to((2.0, 1.0))
    for _ in range(60):
        robot.see([], things=[(0.9, 0.0)])
        assert robot.work.state not in ARM_WORKS
    assert robot.work.sayings()[-1] == COME.format("soup")


def test_object_goes_to_the_person_who_ordered_it_and_only_later_to_somebody_else(robot: Robot) -> None:
    robot.bring_to((2.0, 1.0))
    robot.see([(1.0, 0.0)])
    assert robot.work.state not in ARM_WORKS
    goal = robot.work.goal
    assert goal is not None
    assert math.dist(goal[:2], (2.0, 1.0)) == pytest.approx(HouseholdSettings().before_m)
    robot.now_s += HouseholdSettings().wait_s
    robot.see([(1.0, 0.0)])
    assert robot.work.state is HouseholdState.HAND


def test_robot_that_stands_near_a_person_but_looks_elsewhere_turns(robot: Robot) -> None:
    robot.bring_to((2.0, 0.0))
    robot.see([(2.0, 0.0)])
    robot.work.see_pose((0.6, 0.0, 1.5))
    robot.work.arrived()
    robot.see([(2.0, 0.0)])
    assert robot.work.state not in ARM_WORKS
    goal = robot.work.goal
    assert goal is not None
    np.testing.assert_allclose(goal, (0.6, 0.0, 0.0), atol=1e-9)
    robot.drive()
    robot.see([(2.0, 0.0)])
    assert robot.work.state is HouseholdState.HAND


def test_robot_asks_for_a_closed_door_and_drives_on_when_somebody_has_opened_it(robot: Robot) -> None:
    robot.doors["kitchen"] = (4.0, 1.0, 1.5)
    robot.work.begin([GO])
    robot.work.unreachable("no path leads to the goal")
    np.testing.assert_array_equal(robot.work.goal, (4.0, 1.0, 1.5))
    robot.work.see_ahead(3.0)  # it is not at the door yet
    robot.drive()
    robot.work.arrived()  # navigation says it again while the robot stands there
    assert robot.work.sayings()[1:] == [OPEN_DOOR.format("kitchen")]
    robot.work.see_ahead(0.7)
    robot.work.step()
    np.testing.assert_array_equal(robot.work.goal, (4.0, 1.0, 1.5))
    robot.work.see_ahead(3.0)
    robot.work.arrived()  # still at the door, not at the goal behind it
    assert not robot.work.ends
    robot.work.step()
    np.testing.assert_array_equal(robot.work.goal, PLACES["kitchen"])
    robot.drive()
    assert robot.work.ends[-1].is_done
    assert robot.states == ["GO", "DOOR", "GO", "IDLE"]


def test_robot_asks_several_times_and_gives_up_a_place_whose_door_nobody_opens(robot: Robot) -> None:
    robot.doors["kitchen"] = (4.0, 1.0, 1.5)
    robot.work.begin([GO])
    for _ in range(100):
        if robot.states[-1] == "DOOR":
            robot.drive()
            robot.work.see_ahead(0.7)
            robot.now_s += 1.0
            robot.work.step()
        elif robot.work.order is not None:
            robot.work.unreachable("no path leads to the goal")
    assert robot.work.order is None
    said = robot.work.sayings()
    assert said.count(OPEN_DOOR.format("kitchen")) == HouseholdSettings().max_requests
    assert said[-1] == "I could not go to the kitchen: no path leads to the goal."
    assert robot.states == ["GO", "DOOR", "GO", "IDLE"]


def test_cancelled_order_asks_for_no_door_any_more(robot: Robot) -> None:
    robot.doors["kitchen"] = (4.0, 1.0, 1.5)
    robot.work.begin([GO])
    robot.work.unreachable("no path leads to the goal")
    robot.drive()
    robot.work.sayings()
    robot.work.cancel("enough")
    robot.now_s += 10 * HouseholdSettings().door_s
    robot.work.step()
    assert (robot.work.sayings(), robot.states[-1]) == ([], "IDLE")


def test_door_that_the_robot_cannot_come_to_is_not_asked_for(robot: Robot) -> None:
    robot.doors["kitchen"] = (4.0, 1.0, 1.5)
    robot.work.begin([GO])
    for _ in range(1 + 1 + HouseholdSettings().max_tries):
        robot.work.unreachable("no path leads to the goal")
    assert robot.work.order is None
    assert robot.states == ["GO", "DOOR", "GO", "IDLE"]


def test_restarted_robot_waits_again_before_the_door_to_the_table(robot: Robot) -> None:
    robot.doors["desk"] = (1.0, 0.0, 0.0)
    robot.work.begin([BRING])
    robot.work.unreachable("no path leads to the goal")
    kept = robot.work.memory()
    again = robot.new_work()
    again.remember(kept)
    assert robot.states[-1] == "DOOR"
    np.testing.assert_array_equal(again.goal, (1.0, 0.0, 0.0))
    again.arrived()
    again.see_ahead(3.0)
    again.step()
    assert robot.states[-1] == "FETCH"
    np.testing.assert_array_equal(again.goal, PLACES["desk"])


def test_place_gets_its_name_where_the_robot_stands(robot: Robot) -> None:
    robot.work.begin([TaskOrder(Task.LEARN, place="sofa")])
    assert robot.work.state is HouseholdState.LEARN
    robot.work.ended(True)
    assert robot.work.sayings() == ["This is the sofa."]


def test_robot_without_an_arm_says_so_and_still_drives(robot: Robot) -> None:
    robot.work.has_arm = False
    with pytest.raises(WrongOrder, match="no arm"):
        robot.work.begin([GO, BRING])
    robot.work.begin([GO])
    robot.drive()
    assert robot.work.ends[-1].is_done


def test_newer_order_replaces_the_older_one_but_a_wrong_one_does_not(robot: Robot) -> None:
    robot.work.begin([GO])
    with pytest.raises(WrongOrder):
        robot.work.begin([TaskOrder(Task.GO, place="moon")])
    assert robot.work.order == GO
    robot.work.begin([BRING])
    assert (robot.work.order, robot.work.ends[-1].reason) == (BRING, "another order has come")


@pytest.mark.parametrize("state", [state for state in HouseholdState if state is not HouseholdState.IDLE])
def test_restarted_task_goes_on_with_the_same_step(state: HouseholdState, robot: Robot) -> None:
    orders = {
        HouseholdState.GO: GO, HouseholdState.PUT: PUT, HouseholdState.FOLLOW: FOLLOW,
        HouseholdState.LEARN: TaskOrder(Task.LEARN, place="sofa"), HouseholdState.WHO: TaskOrder(Task.WHO),
    }  # fmt: skip
    if state is HouseholdState.DOOR:
        robot.doors["counter"] = robot.doors["desk"] = (1.0, 1.0, 0.0)
    robot.work.begin([orders.get(state, BRING), GO])
    robot.person(2.0, 1.0)
    while robot.work.state is not state:
        if state is HouseholdState.DOOR:
            robot.work.unreachable("no path leads to the goal")
        elif robot.work.state is HouseholdState.PICK:
            robot.look()
        elif robot.work.state is HouseholdState.MEET:
            robot.person(1.0)
        else:
            robot.drive()
    before, robot.work = robot.work, robot.new_work()
    robot.work.remember(before.memory())
    robot.work.see_pose(HERE)
    assert (robot.work.state, robot.work.order, robot.work.holds) == (state, before.order, before.holds)
    assert robot.work.memory()["takers"] == before.memory()["takers"]
    if before.goal is not None:
        np.testing.assert_array_equal(robot.work.goal, before.goal)


def carry_out(orders: Sequence[TaskOrder], restarts: bool) -> Robot:
    """Carry out an order in a difficult household; each of its processes may be killed after each event."""
    robot = Robot()
    robot.doors["kitchen"] = (4.0, 1.0, 1.5)
    robot.work.begin(orders)
    robot.person(1.0)
    persons = iter([(1.0, 0.0), (1.0, 0.7), (1.0, -0.7)])
    ends = iter([(False, "nobody has taken it", False), (False, "the hand is empty", True)])
    for _ in range(100):
        match robot.work.state:
            case HouseholdState.IDLE:
                break
            case HouseholdState.GO if robot.states.count("DOOR") < 2:
                robot.work.unreachable("no path leads to the goal")
            case HouseholdState.DOOR:
                robot.drive()
                robot.work.see_ahead(3.0)
                robot.work.step()
            case HouseholdState.PICK:
                robot.look()
            case HouseholdState.MEET:
                place = next(persons)
                robot.person(*place)
                if robot.work.state is HouseholdState.MEET:
                    robot.drive()
                    robot.person(*place)
            case HouseholdState.HAND | HouseholdState.PUT:
                robot.work.ended(*next(ends, (True, "", False)))
            case HouseholdState.FOLLOW | HouseholdState.WHO:
                robot.work.ended(True)
            case _:
                robot.drive()
        robot.said += robot.work.sayings()
        if restarts:
            kept, robot.work = decode(encode(robot.work.memory())).state, robot.new_work()
            robot.work.remember(kept)
            robot.work.see_pose(robot.pose)
    return robot


@pytest.mark.parametrize("order", [BRING, PUT, GO, FOLLOW, TaskOrder(Task.WHO)])
def test_robot_killed_after_each_step_does_what_a_robot_does_that_is_never_killed(order: TaskOrder) -> None:
    robot, killed = (carry_out([order, GO], restarts) for restarts in (False, True))
    assert [end.is_done for end in robot.work.ends] == [True, True]
    assert killed.states == robot.states
    assert killed.said == robot.said
    assert killed.work.memory() == robot.work.memory()


def test_journal_of_another_version_of_the_program_ends_the_order(robot: Robot) -> None:
    robot.work.begin([GO])
    kept = robot.work.memory()
    kept["journal"] = [[("_begin_task", None), ("_fly", None)]]
    robot.work = robot.new_work()
    robot.work.remember(kept)
    assert (robot.work.order, robot.work.state) == (None, HouseholdState.IDLE)
    assert "_fly" in robot.work.ends[-1].reason
    assert not robot.work.cancel("enough")


def test_page_shows_the_declared_states() -> None:
    page = (DOCS / "home.md").read_text()
    assert mermaid(HouseholdState.IDLE, TRANSITIONS, HouseholdSettings().time_outs()) in page
