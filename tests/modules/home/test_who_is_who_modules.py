"""The modules of "who is who": orders, faces, what is learnt, what is kept over a restart, and the guests."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import (
    BoundingBox2D,
    CallRefusal,
    CameraInfo,
    Detection2D,
    Detection2DArray,
    GoalEnd,
    Image,
    MapAnnotations,
    MapMetaData,
    NavigateTo,
    NavigationResult,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    OccupancyGrid,
    Odometry,
    PanTiltCommand,
    Point,
    Point2D,
    PointOfInterest,
    Pose,
    Pose2D,
    PoseWithCovariance,
    Quaternion,
    RecognitionTaught,
    TaughtNames,
    TeachRecognition,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.people import WalkingPeople
from robbie_robots.modules.devices.simulated_world import SimulatedPeople
from robbie_robots.modules.home.guests import SimulatedGuests
from robbie_robots.modules.home.messages import (
    Following,
    LearnPerson,
    WhoIsWho,
    WhoIsWhoFeedback,
    WhoIsWhoResult,
)
from robbie_robots.modules.home.who_is_who import CANNOT, STOPPED, WhoIsWhoTask
from robbie_robots.modules.maps.planar_messages import pose_stamped
from robbie_robots.modules.people.messages import People, Person
from robbie_robots.modules.people.people import PEOPLE, THINGS
from robbie_robots.modules.speech.messages import Say, SpokenOrder, SpokenSlot
from tests._support.places import ARENAS

APARTMENT = ARENAS / "apartment.yaml"
FOCAL_PX, CENTRE_PX = 500.0, 320.0
Harness = ModuleHarness[WhoIsWhoTask]


def header(harness: Harness, frame: str = "map") -> Header:
    return Header(stamp=Time.from_nanoseconds(harness.module.clock.now_ns()), frame_id=frame)


def transforms(harness: Harness) -> None:
    """Tell where the camera is: it looks along x, from 1.1 m above the robot's middle."""
    optical = Transform(translation=Vector3(z=1.1), rotation=Quaternion(x=-0.5, y=0.5, z=-0.5, w=0.5))
    moves = {"map": Transform(rotation=Quaternion(w=1.0))}
    for name, (parent, transform) in {
        "base_link": ("map", moves["map"]),
        "camera_optical": ("base_link", optical),
    }.items():
        topic = "tf" if parent == "map" else "tf_static"
        told = TransformStamped(header=header(harness, parent), child_frame_id=name, transform=transform)
        harness.send(TFMessage(transforms=[told]), topic=topic)


def face(name: str, y_per_x: float = 0.0) -> Detection2D:
    """Return a face in a direction from the camera."""
    place = Pose2D(position=Point2D(x=CENTRE_PX - FOCAL_PX * y_per_x, y=200.0))
    box = BoundingBox2D(center=place, size_x=60.0, size_y=60.0)
    known = [ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=0.9))]
    return Detection2D(results=known if name else [], bbox=box, id=name or "face")


def show(
    harness: Harness,
    *persons: tuple[float, float],
    faces: list[Detection2D] | None = None,
    topic: str = PEOPLE,
) -> None:
    """Let the robot, which stands at the origin, see persons and faces for 0.3 s."""
    for _ in range(3):
        transforms(harness)
        harness.send(pose_stamped([0.0, 0.0, 0.0], header(harness)), topic="map_pose")
        told = [
            Person(
                name=str(number), position=Point(x=x, y=y), reliability=0.9, tagnames=["unseen_s"], tags=["0"]
            )
            for number, (x, y) in enumerate(persons)
        ]
        harness.send(People(header=header(harness), people=told), topic=topic)
        if topic != PEOPLE:
            harness.send(People(header=header(harness)), topic=PEOPLE)
        k = [FOCAL_PX, 0.0, CENTRE_PX, 0.0, FOCAL_PX, 256.0, 0.0, 0.0, 1.0]
        harness.send(CameraInfo(header=header(harness), k=np.array(k)), topic="camera")
        seen = header(harness, "camera_optical")
        pixel = np.zeros(3, np.uint8)
        harness.send(
            Image(header=seen, height=1, width=1, encoding="rgb8", step=3, data=pixel), topic="camera"
        )
        if faces is not None:
            harness.send(Detection2DArray(header=seen, detections=faces), topic="camera")
        transforms(harness)
        harness.advance(0.1)


def know(harness: Harness, *names: str) -> None:
    harness.send(TaughtNames(names=list(names), examples=np.ones(len(names), np.uint32)), topic="persons")


def room(harness: Harness) -> None:
    """Send a map of 3 m by 3 m around the robot, all of it in sight."""
    cells = np.zeros((60, 60), np.int8)
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    info = MapMetaData(width=60, height=60, resolution=0.05, origin=Pose(position=Point(x=-1.5, y=-1.5)))
    grid = OccupancyGrid(header=header(harness), info=info, data=cells.ravel())
    harness.send(grid)


def test_robot_without_a_recognizer_of_faces_says_so() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        task.send_goal(WhoIsWho(), client="host")
        assert "install the extra 'faces'" in task.take(CallRefusal, "host")[0].reason
        task.send(SpokenOrder(order="name", slots=[SpokenSlot(name="name", words="Anna")]))
        assert [say.text for say in task.take(Say)] == [CANNOT, CANNOT]


def test_robot_that_follows_somebody_looks_for_nobody() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task)
        task.send(Following(state="FOLLOW"))
        task.send_goal(WhoIsWho(), client="host")
        assert task.take(CallRefusal, "host")[0].reason.startswith("the robot follows a person")
        task.send_goal(LearnPerson(name="\n"), client="guest")
        assert "printable" in task.take(CallRefusal, "guest")[0].reason


def test_person_who_says_the_name_is_learnt_from_the_picture_of_the_face() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task)
        task.send(SpokenOrder(order="name", slots=[SpokenSlot(name="name", words="Anna")]))
        show(task, (1.2, 0.0))
        assert task.module.tour.state.name == "LOOK"
        tilt = task.take(PanTiltCommand)[-1].tilt_rad
        assert tilt == pytest.approx(-math.atan2(0.45, 1.2), abs=0.05)
        show(task, (1.2, 0.0), faces=[face("", 0.5)])  # somebody beside
        assert task.take(TeachRecognition) == []
        show(task, (1.2, 0.0), faces=[face("", 0.5), face("", 0.02)])
        (request,) = task.take(TeachRecognition)
        assert (request.name, request.image.width) == ("Anna", 1)
        assert request.box.center.position.x == pytest.approx(CENTRE_PX - 10.0)
        task.reply(request, RecognitionTaught(examples=2))
        task.advance(0.3)
        assert task.take(Say)[-1].text == "Hello Anna."


def test_round_tells_who_is_where_and_goes_on_after_a_restart(tmp_path: Path) -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task, "Anna")
        task.send_goal(WhoIsWho(), client="host")
        show(task, (1.2, 0.0), (0.1, 1.2))
        show(task, (1.2, 0.0), (0.1, 1.2), faces=[face("Anna")])
        show(task, (1.2, 0.0), (0.1, 1.2), faces=[face("Anna")])
        assert [one.name for one in task.module.tour.met] == ["Anna"]
        assert {told.state for told in task.take(WhoIsWhoFeedback, "host")} == {"LOOK"}
        kept = task.checkpoint
    with ModuleHarness(WhoIsWhoTask, restored=kept, output_directory=tmp_path) as task:
        know(task, "Anna")
        places = [
            PointOfInterest(name=name, pose=Pose(position=Point(x=x)))
            for name, x in (("door", 1.5), ("bed", 9))
        ]
        task.send(MapAnnotations(places=places))
        room(task)
        show(task, (1.2, 0.0), (0.1, 1.2))
        assert task.module.tour.state.name == "LOOK"
        for _ in range(3):
            show(task, (1.2, 0.0), (0.1, 1.2), faces=[face("", 12.0)])
        show(task, (1.2, 0.0), (0.1, 1.2))
        task.advance(1.0)
        (result,) = task.take(WhoIsWhoResult, "host")
        assert [(one.name, one.place) for one in result.persons] == [("Anna", "door"), ("", "door")]
        assert [say.text for say in task.take(Say)][-2:] == [
            "Anna is at the door.",
            "Somebody I do not know is at the door.",
        ]
        task.module.teardown()
        assert json.loads((tmp_path / "who_is_who.json").read_text())["done"] == 1


def test_robot_drives_to_a_person_and_stops_when_it_is_told_to() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task, "Anna")
        task.send(SpokenOrder(order="who"))
        show(task, (4.0, 0.0))
        (drive,) = task.take(NavigateTo)
        assert drive.pose.pose.position.x == pytest.approx(2.9)
        task.end_goal(drive, NavigationResult())
        show(task, (4.0, 0.0))
        assert task.module.tour.state.name == "LOOK"
        task.send(SpokenOrder(order="stop"))
        assert task.module.tour.state.name == "IDLE"
        assert task.take(Say)[-1].text == STOPPED


def test_robot_looks_also_at_somebody_who_stands_where_the_map_shows_a_thing() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task, "Anna")
        task.send_goal(WhoIsWho(), client="host")
        show(task, (1.2, 0.0), topic=THINGS)
        for _ in range(2):
            show(task, (1.2, 0.0), topic=THINGS, faces=[face("Anna")])
        assert [one.name for one in task.module.tour.met] == ["Anna"]


def test_order_ends_when_the_robot_begins_to_follow_somebody() -> None:
    with ModuleHarness(WhoIsWhoTask) as task:
        know(task)
        task.send_goal(WhoIsWho(), client="host")
        show(task, (4.0, 0.0))
        task.send(Following(state="CHOOSE"))
        assert task.module.tour.state.name == "IDLE"
        (end,) = task.take(GoalEnd, "host")
        assert end.reason == "the robot follows a person now"


def test_guest_in_front_of_the_robot_tells_the_name_until_it_is_greeted(tmp_path: Path) -> None:
    people = WalkingPeople(read_arena(APARTMENT).people).shown.ravel()
    settings = {"arena": str(APARTMENT), "introduce": ["Anna"], "asks_s": 30.0}
    with ModuleHarness(SimulatedGuests, settings, output_directory=tmp_path) as guests:

        def later(seconds: int, x_m: float = 0.0) -> list[str]:
            guests.send(SimulatedPeople(shown=people), topic="ground_truth")
            there = Pose(position=Point(x=x_m), orientation=Quaternion.from_yaw(0.0))
            stamp = Header(stamp=Time(sec=seconds))
            guests.send(Odometry(header=stamp, pose=PoseWithCovariance(pose=there)), topic="ground_truth")
            guests.advance(0.3)
            return [order.text for order in guests.take(SpokenOrder)]

        assert later(1, -3.0) == []
        assert later(2) == ["my name is Anna"]
        assert later(3) == []
        assert later(15) == ["my name is Anna"]
        guests.send(Say(text="Hello Anna."))
        assert later(29) == []
        later(32)
        (asked,) = guests.take(WhoIsWho)
        guests.end_goal(asked, WhoIsWhoResult(duration_s=9.0))
        assert guests.module.stop_requested
        guests.module.teardown()
    told = json.loads((tmp_path / "guests.json").read_text())
    assert (told["known"], told["found"], told["duration_s"]) == (["Anna"], [], 9.0)
    anna = next(one for one in told["truth"] if one["name"] == "Anna")
    assert (anna["x_m"], anna["y_m"]) == pytest.approx((1.175, -0.025), abs=0.01)
