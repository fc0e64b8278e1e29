"""The household module: orders by call and voice, what it asks of other modules, and restarts."""

import json
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

from robbie_mp import GoalAborted, Header, ModuleHarness, SettingError, Time, replace
from robbie_mp.messages import (
    AnnotateMap,
    CallRefusal,
    CancelNavigation,
    GoalCancel,
    GoalEnd,
    LaserScan,
    MapAnnotated,
    MapAnnotations,
    NavigateTo,
    NavigationCancelled,
    NavigationResult,
    Point,
    PointOfInterest,
    TaughtNames,
)
from robbie_mp.module.harness import NotSubscribed
from robbie_robots.modules.home.household import SEVERAL, Household
from robbie_robots.modules.home.messages import (
    CancelOrder,
    CarryOut,
    CarryOutFeedback,
    CarryOutResult,
    Following,
    FollowOrder,
    FollowOrderTaken,
    HouseholdStatus,
    HouseholdTask,
    WhoIsWho,
    WhoIsWhoResult,
)
from robbie_robots.modules.manipulation.messages import (
    HandOver,
    HandStatus,
    PickUp,
    PickUpResult,
    PutDown,
    PutDownResult,
    StowArm,
    StowArmResult,
)
from robbie_robots.modules.maps.planar_messages import pose_stamped
from robbie_robots.modules.people.messages import People, Person
from robbie_robots.modules.people.people import PEOPLE
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.workers.home.household import OPEN_DOOR
from robbie_robots.workers.home.orders import OrderReader, Task
from robbie_robots.workers.speech.order_grammar import OrderGrammar
from tests._support.commands import waits
from tests._support.places import PROJECT

PLACES = {"desk": [2.0, 0.0, 0.0], "kitchen": [4.0, 2.0, 1.0]}
SETTINGS: dict[str, object] = {
    "orders": {
        "bring": ["bring me the <object>"],
        "put": ["put it on the <place>", "put the <object> on the <place>"],
        "go": ["go to the <place>"],
        "learn": ["this is the <place>"],
        "follow": ["follow me"],
        "who": ["who is who"],
        "stop": ["stop"],
        "several": ["go to the <place> and bring me the <object>"],
    },
    "words": {"object": ["soup"], "place": ["desk", "kitchen", "sofa"]},
    "places": PLACES,
    "tables": ["desk"],
}


class Robot:
    """The household module, with the modules around it."""

    def __init__(self, harness: ModuleHarness[Household]) -> None:
        self.harness = harness
        self.known = dict(PLACES)
        self.pose: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def header(self) -> Header:
        return Header(stamp=Time.from_nanoseconds(self.harness.clock.now_ns()), frame_id="map")

    def know_places(self) -> None:
        places = [
            PointOfInterest(name=name, pose=pose_stamped(place, self.header()).pose)
            for name, place in self.known.items()
        ]
        self.harness.send(MapAnnotations(places=places))

    def begin(self, has_arm: bool = True) -> None:
        self.know_places()
        if has_arm:
            self.harness.send(HandStatus(state="REST"))
        self.wait(0.2)

    def wait(self, seconds: float) -> None:
        for _ in range(max(1, round(seconds / 0.2))):
            self.harness.send(pose_stamped(self.pose, self.header()), topic="map_pose")
            self.harness.advance(0.2)

    def arrive(self) -> None:
        goal = self.harness.take(NavigateTo)[-1]
        at = goal.pose.pose
        self.pose = at.position.x, at.position.y, at.orientation.yaw
        self.wait(0.2)
        self.harness.end_goal(goal, NavigationResult(duration_s=1.0))
        self.wait(0.4)

    def said(self) -> list[str]:
        return [say.text for say in self.harness.take(Say)]


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    with ModuleHarness(Household, SETTINGS, name="household", output_directory=tmp_path) as harness:
        yield Robot(harness)


def test_call_in_words_drives_grasps_puts_down_and_tells_its_client(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="put the soup on the desk"), client="person")
    robot.wait(0.4)
    robot.arrive()
    (pick,) = robot.harness.take(PickUp)
    assert pick.object == "soup"
    robot.harness.end_goal(pick, PickUpResult())
    robot.wait(0.4)
    robot.arrive()
    (put,) = robot.harness.take(PutDown)
    assert put.object == "soup"
    robot.harness.end_goal(put, PutDownResult())
    robot.wait(0.4)
    (result,) = robot.harness.take(CarryOutResult, "person")
    assert result.duration_s > 0.0
    told = [feedback.state for feedback in robot.harness.take(CarryOutFeedback, "person")]
    assert told == ["FETCH", "PICK", "CARRY", "PUT"]
    assert robot.said() == ["I put the soup on the desk."]
    robot.harness.module.teardown()
    (end,) = json.loads((robot.harness.module.output_directory / "household.json").read_text())
    assert (end["task"], end["object"], end["place"], end["is_done"]) == ("put", "soup", "desk", True)


def test_robot_does_not_drive_before_it_has_stowed_an_arm_that_stands_out(robot: Robot) -> None:
    robot.begin()
    robot.harness.send(HandStatus(state="REST", stands_out=True))
    robot.wait(0.4)
    assert not robot.harness.take(StowArm)  # without an order, nothing moves
    robot.harness.send_goal(CarryOut(text="go to the kitchen"), client="person")
    robot.wait(1.0)
    (stow,) = robot.harness.take(StowArm)
    assert not robot.harness.take(NavigateTo)
    robot.harness.end_goal(stow, StowArmResult())
    robot.harness.send(HandStatus(state="REST"))
    robot.wait(0.4)
    assert robot.harness.take(NavigateTo)


def test_orders_name_what_people_have_taught_and_are_refused_when_it_is_forgotten(robot: Robot) -> None:
    robot.begin()
    robot.harness.send(TaughtNames(names=["soup", "Mint Tea", "no. 5"]), topic="objects")
    robot.wait(0.4)
    assert robot.harness.take(HouseholdStatus)[-1].objects == ["soup", "Mint Tea", "no. 5"]
    robot.harness.send_goal(CarryOut(text="bring me the mint tea"))
    robot.wait(0.4)
    robot.arrive()
    assert robot.harness.take(PickUp)[0].object == "Mint Tea"
    # What no grammar takes for words can still be chosen on the page.
    robot.harness.send_goal(CarryOut(tasks=[HouseholdTask(task="bring", object="no. 5")]))
    assert robot.harness.take(CallRefusal) == []
    robot.harness.send(TaughtNames(), topic="objects")
    robot.harness.send_goal(CarryOut(text="bring me the mint tea"))
    assert "I do not understand" in robot.harness.take(CallRefusal)[0].reason


def test_robot_waits_before_a_door_until_it_sees_through_it(tmp_path: Path) -> None:
    settings = SETTINGS | {"doors": {"kitchen": [4.0, 1.0, 1.5]}, "scan_topic": "scan"}
    with ModuleHarness(Household, settings, name="household", output_directory=tmp_path) as harness:
        robot = Robot(harness)
        robot.begin()
        harness.send_goal(CarryOut(text="go to the kitchen"), client="person")
        robot.wait(0.4)
        harness.end_goal(harness.take(NavigateTo)[-1], GoalAborted("no path leads to the goal"))
        robot.wait(0.4)
        robot.arrive()
        assert robot.pose == pytest.approx((4.0, 1.0, 1.5))
        assert robot.said() == ["I go to the kitchen.", OPEN_DOOR.format("kitchen")]
        beside_m = np.full(360, 5.0, np.float32)
        for ahead_m in (0.7, math.inf):
            harness.take(NavigateTo)
            ranges = beside_m.copy()
            ranges[175:186] = ahead_m
            scan = LaserScan(
                angle_min=-math.pi,
                angle_increment=math.pi / 180,
                range_min=0.05,
                range_max=10.0,
                ranges=ranges,
            )
            harness.send(scan, topic="scan")
            # What another laser sees does not count.
            with pytest.raises(NotSubscribed):
                harness.send(replace(scan, ranges=beside_m), topic="rear_scan")
            robot.wait(1.4)
        goal = harness.take(NavigateTo)[-1].pose.pose.position
        assert (goal.x, goal.y) == (4.0, 2.0)


def test_spoken_order_that_waited_in_a_stopped_module_starts_nothing(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot.begin()
    waits(robot.harness, monkeypatch, 5.0)
    robot.harness.send(SpokenOrder(order="bring", text="bring me the soup"))
    monkeypatch.undo()
    robot.wait(0.4)
    assert robot.harness.module.work.order is None


def test_spoken_order_brings_the_object_to_the_person_who_has_spoken(robot: Robot) -> None:
    robot.begin()
    robot.harness.send(SpokenOrder(order="bring", text="bring me the soup"))
    robot.wait(0.4)
    robot.arrive()
    robot.harness.end_goal(robot.harness.take(PickUp)[0], PickUpResult())
    robot.wait(0.4)
    robot.arrive()
    assert math.dist(robot.pose, (0.0, 0.0, 0.0)) < 0.01
    robot.harness.send(
        People(
            header=robot.header(),
            people=[Person(name="1", position=Point(x=0.9), tagnames=["unseen_s"], tags=["0.0"])],
        ),
        topic=PEOPLE,
    )
    robot.wait(0.4)
    (hand,) = robot.harness.take(HandOver)
    assert hand.object == "soup"
    assert robot.said() == ["I bring you the soup.", "Here is the soup. Please take it."]


def test_orders_that_the_robot_cannot_carry_out_are_refused_by_call_and_by_voice(robot: Robot) -> None:
    robot.begin(has_arm=False)
    for order in (
        CarryOut(text="dance"),
        CarryOut(text="bring me the soup"),
        CarryOut(tasks=[HouseholdTask(task="go", place="moon")]),
        CarryOut(tasks=[HouseholdTask(task="dance")]),
    ):
        robot.harness.send_goal(order)
    reasons = [refusal.reason for refusal in robot.harness.take(CallRefusal)]
    assert reasons == [
        "I do not understand 'dance'",
        "I have no arm that I can use",
        "I do not know the place 'moon'; I know: desk, kitchen",
        "there is no task 'dance'; there are: bring, put, go, learn, follow, who",
    ]
    robot.harness.send(SpokenOrder(order="bring", text="bring me the soup"))
    robot.harness.send(SpokenOrder(order="go", text="go to the sofa"))
    robot.harness.send(SpokenOrder(order="here", text="here I am"))  # another module's
    robot.wait(0.4)
    assert robot.said() == [
        "I have no arm that I can use.",
        "I do not know the place 'sofa'; I know: desk, kitchen.",
    ]
    assert not robot.harness.take(NavigateTo)


def test_map_takes_the_places_that_it_lacks_and_those_that_the_robot_learns(robot: Robot) -> None:
    robot.known = {"desk": [2.0, 0.0, 0.0]}
    robot.begin()
    (request,) = robot.harness.take(AnnotateMap)
    assert [place.name for place in request.places] == ["kitchen"]
    robot.harness.reply(request, MapAnnotated(revision=1))
    robot.pose = (3.0, 1.0, 0.5)
    robot.wait(0.4)
    robot.harness.send(SpokenOrder(order="learn", text="this is the sofa"))
    robot.wait(0.4)
    (request,) = robot.harness.take(AnnotateMap)
    (place,) = request.places
    assert (place.name, place.pose.position.x) == ("sofa", 3.0)
    robot.harness.reply(request, MapAnnotated(revision=2))
    robot.wait(0.4)
    assert robot.said() == ["This is the sofa."]


def test_place_is_not_learnt_from_an_old_pose(robot: Robot) -> None:
    robot.begin()
    robot.harness.advance(3.0)
    robot.harness.send(SpokenOrder(order="learn", text="this is the sofa"))
    robot.harness.advance(0.4)
    assert robot.harness.take(AnnotateMap) == []
    assert robot.said() == ["I could not call this place the sofa: I do not know where I am."]


def test_robot_follows_by_the_module_that_follows_until_that_ends(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="follow me and go to the desk"), client="person")
    robot.wait(0.4)
    (request,) = robot.harness.take(FollowOrder)
    assert request.order == "follow"
    robot.harness.reply(request, FollowOrderTaken(changed=True, state="CHOOSE"))
    robot.wait(0.4)
    robot.harness.send(Following(state="STAND"))
    robot.wait(0.4)
    assert robot.harness.module.work.state.name == "FOLLOW" and not robot.harness.take(NavigateTo)
    robot.harness.send(Following(state="IDLE", reason="was told to stop"))
    robot.wait(0.4)
    assert robot.harness.take(NavigateTo)[-1].pose.pose.position.x == pytest.approx(2.0)


def test_robot_that_begins_to_follow_when_the_order_has_ended_is_told_to_stop(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="follow me"), client="person")
    robot.wait(0.4)
    (request,) = robot.harness.take(FollowOrder)
    robot.harness.call(CancelOrder())
    robot.wait(0.4)
    robot.harness.reply(request, FollowOrderTaken(changed=True, state="CHOOSE"))
    robot.wait(0.4)
    assert [request.order for request in robot.harness.take(FollowOrder)] == ["stop"]


def test_robot_stops_following_before_it_drives_elsewhere(robot: Robot) -> None:
    robot.begin()
    robot.harness.send(Following(state="FOLLOW"))
    robot.harness.send_goal(CarryOut(text="go to the desk"))
    robot.wait(0.4)
    (request,) = robot.harness.take(FollowOrder)
    assert request.order == "stop" and not robot.harness.take(NavigateTo)
    robot.harness.reply(request, FollowOrderTaken(changed=True, state="IDLE"))
    robot.wait(0.4)
    assert robot.harness.take(NavigateTo)


def test_robot_has_the_module_that_knows_faces_look_who_is_where(robot: Robot) -> None:
    robot.begin()
    robot.harness.send(SpokenOrder(order="who", text="who is who"))
    robot.wait(0.4)
    (goal,) = robot.harness.take(WhoIsWho)
    robot.harness.end_goal(goal, WhoIsWhoResult())
    robot.wait(0.4)
    assert robot.harness.module.work.ends[-1].is_done
    robot.harness.send(SpokenOrder(order="who", text="who is who"))
    robot.wait(1.4)
    assert robot.harness.take(WhoIsWho)
    robot.harness.send(SpokenOrder(order="go", text="go to the desk"))
    robot.wait(0.4)
    assert robot.harness.take(GoalCancel)
    assert robot.harness.take(NavigateTo)


@pytest.mark.parametrize("how", ["goal", "request", "voice"])
def test_cancelled_order_stops_drive_and_ends_for_its_client(how: str, robot: Robot) -> None:
    robot.begin()
    sent = robot.harness.send_goal(CarryOut(text="go to the desk"), client="person")
    robot.wait(0.4)
    robot.harness.take(CancelNavigation)
    if how == "goal":
        robot.harness.cancel_goal(sent, "enough", client="person")
    elif how == "request":
        assert robot.harness.call(CancelOrder(reason="enough")).had_order
        assert not robot.harness.call(CancelOrder()).had_order
    else:
        robot.harness.send(SpokenOrder(order="stop", text="stop"))
    robot.wait(0.4)
    (end,) = robot.harness.take(GoalEnd, "person")
    assert end.outcome == GoalEnd.CANCELLED
    cancels = robot.harness.take(CancelNavigation)
    # By voice, the goals of all others end, too.
    assert [cancel.client for cancel in cancels] == (["", "household"] if how == "voice" else ["household"])
    for cancel in cancels:
        robot.harness.reply(cancel, NavigationCancelled())
    assert robot.harness.module.work.order is None


def test_arm_task_that_is_not_wanted_any_more_is_cancelled(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="bring me the soup"), client="person")
    robot.wait(0.4)
    robot.arrive()
    (pick,) = robot.harness.take(PickUp)
    robot.harness.send_goal(CarryOut(text="go to the kitchen"), client="other")
    robot.wait(0.4)
    (end,) = robot.harness.take(GoalEnd, "person")
    assert (end.outcome, end.reason) == (GoalEnd.PREEMPTED, "other has given another order")
    assert robot.harness.module.errand.wanted is None
    robot.harness.end_goal(pick, PickUpResult())  # it ends too late
    robot.wait(0.4)
    assert robot.harness.module.work.holds == ""


def test_arm_task_that_an_accident_has_ended_is_repeated(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="bring me the soup"))
    robot.wait(0.4)
    robot.arrive()
    assert robot.harness.take(PickUp)
    robot.harness.kill_server()
    robot.wait(2.0)
    assert robot.harness.take(PickUp)[-1].object == "soup"


def test_failed_order_is_told_to_its_client_with_the_reason(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="go to the desk"), client="person")
    for _ in range(3):
        robot.wait(2.4)
        (goal,) = robot.harness.take(NavigateTo)
        robot.harness.end_goal(goal, GoalAborted("no path leads to the goal"))
    robot.wait(0.4)
    (end,) = robot.harness.take(GoalEnd, "person")
    assert (end.outcome, end.reason) == (
        GoalEnd.ABORTED,
        "could not go to the desk: no path leads to the goal",
    )


def test_killed_robot_goes_on_and_its_client_notices_nothing(robot: Robot) -> None:
    robot.begin()
    robot.harness.send_goal(CarryOut(text="go to the kitchen and bring me the soup"), client="person")
    robot.wait(0.4)
    robot.arrive()
    robot.harness.take(NavigateTo)
    kept = robot.harness.checkpoint
    with ModuleHarness(Household, SETTINGS, name="household", restored=kept) as harness:
        again = Robot(harness)
        again.pose = robot.pose
        again.begin()
        again.arrive()
        again.harness.end_goal(again.harness.take(PickUp)[0], PickUpResult())
        again.wait(0.4)
        again.arrive()
        assert math.dist(again.pose, (0.0, 0.0, 0.0)) < 0.01  # where the order was given
        assert again.harness.take(CarryOutFeedback, "person")[-1].state == "MEET"


def test_orders_of_the_start_are_carried_out_and_then_the_module_ends() -> None:
    start = {"start_orders": ["go to the desk", "go to the kitchen"]}
    with ModuleHarness(Household, SETTINGS | start, name="household") as harness:
        robot = Robot(harness)
        robot.begin()
        robot.wait(0.4)
        robot.arrive()
        robot.arrive()
        robot.wait(1.4)
        assert harness.module.stop_requested
        assert [(end.order.place, end.is_done) for end in harness.module.work.ends] == [
            ("desk", True),
            ("kitchen", True),
        ]


def test_status_tells_the_page_what_can_be_ordered(robot: Robot) -> None:
    robot.begin()
    status = robot.harness.take(HouseholdStatus)[-1]
    assert (status.state, status.has_arm, status.objects) == ("IDLE", True, ["soup"])
    assert (status.places, status.names) == (["desk", "kitchen"], ["desk", "kitchen", "sofa"])
    robot.harness.send_goal(CarryOut(text="go to the desk and follow me"))
    robot.wait(0.4)
    status = robot.harness.take(HouseholdStatus)[-1]
    assert [one.task for one in status.tasks] == ["go", "follow"]


@pytest.mark.parametrize(
    ("text", "tasks"),
    [
        ("please bring me the soup", ["bring"]),
        ("put the tea on the desk", ["put"]),
        ("go to the living room and bring me the cola", ["go", "bring"]),
        ("go to the kitchen and then follow me", ["go", "follow"]),
        ("this is the sofa", ["learn"]),
        ("who is who", ["who"]),
    ],
)
def test_what_the_stock_robot_understands_by_voice_is_what_it_carries_out(
    text: str, tasks: list[str]
) -> None:
    modules = yaml.safe_load((PROJECT / "profiles" / "home.yaml").read_text())["modules"]
    heard, known = modules["orders"]["settings"], modules["household"]["settings"]
    spoken = OrderGrammar(heard["orders"], heard["words"]).parse(text)
    assert spoken is not None
    assert spoken.order in (*Task, SEVERAL)
    assert [one.task for one in OrderReader(known["orders"], known["words"]).read(spoken.text)] == tasks
    assert set(known["tables"]) <= set(known["places"]) & set(known["words"]["place"])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"orders": {"bring": ["bring it"]}}, "needs <object>"),
        ({"places": {"desk": [1.0]}}, "desk: expected x, y"),
        ({"start_orders": ["dance"]}, "I do not understand 'dance'"),
    ],
)
def test_mistakes_in_the_settings_are_named_before_anything_starts(
    change: dict[str, object], problem: str
) -> None:
    with (
        pytest.raises(SettingError, match=problem),
        ModuleHarness(Household, SETTINGS | change),
    ):
        pass
