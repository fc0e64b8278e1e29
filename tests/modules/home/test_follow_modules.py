"""The modules of "follow me": orders, persons, goals, what is kept over a restart, and the referee."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import CallRefused, Header, ModuleHarness, Time
from robbie_mp.messages import (
    LaserScan,
    Odometry,
    PanTiltCommand,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
)
from robbie_mp.module.harness import NotSubscribed
from robbie_robots.hw.pose import Pose as Pose2D
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.follow_referee import FollowReferee
from robbie_robots.hw.simulation.people import WalkingPeople
from robbie_robots.modules.devices.base import SimulatedBase
from robbie_robots.modules.devices.laser import SimulatedLaserRangeFinder
from robbie_robots.modules.devices.simulated_world import SimulatedPeople
from robbie_robots.modules.home.follow import BINS, FollowMe
from robbie_robots.modules.home.messages import Following, FollowOrder
from robbie_robots.modules.home.referee import Referee, SimulatedVoice
from robbie_robots.modules.maps.planar_messages import pose_stamped
from robbie_robots.modules.people.messages import People, PeopleClothes, Person
from robbie_robots.modules.people.people import PEOPLE, THINGS, hides, number_of
from robbie_robots.modules.speech.messages import Say, SpokenOrder
from robbie_robots.workers.home.follow import ARE_YOU_THERE, I_FOLLOW
from robbie_robots.workers.laser.laser_sweep import LaserSweep
from tests._support.commands import waits
from tests._support.places import ARENAS

APARTMENT = ARENAS / "apartment.yaml"


def stamp(harness: ModuleHarness[FollowMe]) -> Header:
    return Header(stamp=Time.from_nanoseconds(harness.module.clock.now_ns()), frame_id="map")


def person(name: str, x_m: float, y_m: float, unseen: float = 0.0) -> Person:
    tags = {"unseen_s": str(unseen), "has_moved": "1"}
    return Person(
        name=name,
        position=Point(x=x_m, y=y_m),
        tagnames=list(tags),
        tags=list(tags.values()),
        reliability=0.9,
    )


def show(harness: ModuleHarness[FollowMe], *persons: Person, seconds: float = 0.3) -> None:
    for _ in range(round(seconds * 10)):
        harness.send(pose_stamped([0.0, 0.0, 0.0], stamp(harness)), topic="map_pose")
        harness.send(People(header=stamp(harness), people=list(persons)), topic=PEOPLE)
        harness.advance(0.1)


def test_spoken_order_starts_the_task_and_the_person_is_followed(tmp_path: Path) -> None:
    with ModuleHarness(FollowMe, output_directory=tmp_path) as follow:
        follow.send(SpokenOrder(order="follow", text="follow me"))
        show(follow, person("3", 1.2, 0.1), seconds=0.5)
        assert [say.text for say in follow.take(Say)] == [I_FOLLOW]
        newest = follow.take(Following)[-1]
        assert (newest.state, newest.person, newest.position.x) == ("STAND", "3", 1.2)
        assert follow.take(PanTiltCommand)[-1].pan_rad == pytest.approx(math.atan2(0.1, 1.2), abs=0.05)
        show(follow, person("3", 2.5, 0.1), seconds=0.5)
        assert follow.module.task.state.name == "FOLLOW"
        follow.module.teardown()
        assert json.loads((tmp_path / "follow.json").read_text())["losses"] == 0


def test_call_does_the_same_as_speech_and_an_unknown_order_is_refused() -> None:
    with ModuleHarness(FollowMe) as follow:
        taken = [follow.call(FollowOrder(order=order)) for order in ("follow", "follow", "stop")]
        answers = [(one.changed, one.state) for one in taken]
        assert answers == [(True, "CHOOSE"), (False, "CHOOSE"), (True, "IDLE")]
        with pytest.raises(CallRefused, match="there are: follow, stop, here"):
            follow.call(FollowOrder(order="jump"))
        follow.send(SpokenOrder(order="bring"))  # another module's
        assert follow.module.task.state.name == "IDLE"


def test_order_that_waited_in_a_stopped_module_starts_nothing_but_stop_does_its_work(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with ModuleHarness(FollowMe) as follow:
        waits(follow, monkeypatch, 5.0)
        follow.send(SpokenOrder(order="follow"))
        assert follow.module.task.state.name == "IDLE"
        monkeypatch.undo()
        follow.send(SpokenOrder(order="follow"))
        waits(follow, monkeypatch, 5.0)
        follow.send(SpokenOrder(order="stop"))
        assert follow.module.task.state.name == "IDLE"


def test_thing_that_looks_like_a_person_is_not_followed() -> None:
    with ModuleHarness(FollowMe) as follow:
        show(follow, person("1", 1.2, 0.0))
        things = People(header=stamp(follow), people=[person("2", 0.8, 0.0)])
        follow.send(SpokenOrder(order="follow"))
        with pytest.raises(NotSubscribed):
            follow.send(things, topic=THINGS)
        follow.advance(0.2)
        assert follow.module.task.person == "1"


def test_killed_task_goes_on_with_its_person() -> None:
    with ModuleHarness(FollowMe) as follow:
        follow.send(SpokenOrder(order="follow"))
        show(follow, person("3", 1.2, 0.1))
        worn = np.zeros(BINS, np.float32)
        worn[[1, BINS // 2]] = 1.0
        follow.send(PeopleClothes(names=["3"], clothes=worn))
        show(follow, person("3", 1.2, 0.1))
        kept = follow.checkpoint
    with ModuleHarness(FollowMe, restored=kept) as follow:
        assert follow.module.task.state.name == "LOST"
        show(follow, person("3", 1.2, 0.1), person("4", 0.8, 2.5))
        assert (follow.module.task.state.name, follow.module.task.person) == ("STAND", "3")
        np.testing.assert_array_equal(follow.module.task.memory()["clothes"], worn)


def test_clothes_of_a_wrong_length_are_counted_and_ignored() -> None:
    with ModuleHarness(FollowMe) as follow:
        follow.send(PeopleClothes(names=["3"], clothes=np.zeros(7, np.float32)))
        assert follow.module.wrong_clothes == 1


def test_person_without_a_valid_age_counts_as_not_seen() -> None:
    assert number_of(person("1", 0, 0, 0.25), "unseen_s", math.inf) == 0.25
    assert number_of(Person(), "unseen_s", math.inf) == math.inf
    assert number_of(Person(tagnames=["unseen_s"], tags=["soon"]), "unseen_s", math.inf) == math.inf


def test_nearer_return_hides_a_place_and_a_farther_one_does_not() -> None:
    ranges = np.full(360, 5.0, np.float32)
    ranges[180:185] = 1.0
    scan = LaserSweep.from_ranges(ranges, -math.pi, math.pi / 180, 0.05, 10.0)
    here = np.array([1.0, 1.0, 0.0])
    assert hides(scan, here, np.array([3.0, 1.05]))
    assert not hides(scan, here, np.array([1.5, 1.01]))
    assert not hides(scan, here, np.array([1.0, 3.0]))
    turned = np.array([1.0, 1.0, math.pi / 2])
    assert hides(scan, turned, np.array([0.95, 3.0]))


def truth(x_m: float, y_m: float) -> Odometry:
    start = read_arena(APARTMENT).start
    place = Pose(position=Point(x=x_m - start.x_m, y=y_m - start.y_m), orientation=Quaternion.from_yaw(0.0))
    return Odometry(header=Header(stamp=Time(sec=1)), pose=PoseWithCovariance(pose=place))


def test_base_moves_the_people_and_the_laser_sees_them(tmp_path: Path) -> None:
    settings: dict[str, object] = {"arena": str(APARTMENT)}
    fine = {"steps": 1024, "angle_increment_rad": math.tau / 1024}
    with (
        ModuleHarness(SimulatedBase, settings, output_directory=tmp_path) as base,
        ModuleHarness(SimulatedLaserRangeFinder, settings | fine) as laser,
    ):
        base.advance(16.0)
        kept = base.checkpoint
        newest = base.take(SimulatedPeople)[-1].shown.reshape(-1, 5)
        assert newest[0, 0] > 2.5  # Anna has left the place where she began
        laser.send(SimulatedPeople(shown=newest.ravel()), topic="ground_truth")
        laser.send(truth(1.125, 4.125), topic="ground_truth")
        laser.advance(0.1)
        ranges = laser.take(LaserScan)[-1].ranges
        assert ranges[490:534].min() == pytest.approx(newest[0, 0] - 1.125, abs=0.4)
        base.module.teardown()
        assert json.loads((tmp_path / "base.json").read_text())["touches"] == 0
    with ModuleHarness(SimulatedBase, settings, restored=kept) as base:
        base.advance(0.1)
        again = base.take(SimulatedPeople)[-1].shown.reshape(-1, 5)
        np.testing.assert_allclose(again[:, :2], newest[:, :2], atol=0.1)


def test_simulated_person_orders_until_it_is_followed_and_answers_when_it_hears_the_robot() -> None:
    people = WalkingPeople(read_arena(APARTMENT).people).shown.ravel()
    with ModuleHarness(SimulatedVoice, {"arena": str(APARTMENT), "order_s": 0.0}) as voice:

        def later(seconds: int, x_m: float) -> list[str]:
            voice.send(SimulatedPeople(shown=people), topic="ground_truth")
            there = truth(x_m, 4.1)
            there = Odometry(header=Header(stamp=Time(sec=seconds)), pose=there.pose)
            voice.send(there, topic="ground_truth")
            voice.advance(0.3)
            return [order.order for order in voice.take(SpokenOrder)]

        assert later(1, 1.1) == ["follow"]
        assert later(2, 1.1) == []
        assert later(11, 1.1) == ["follow"]
        voice.send(Following(state="STAND"))
        assert later(30, 1.1) == []
        voice.send(Say(text=ARE_YOU_THERE))
        assert later(31, 1.1) == []
        assert later(32, 1.1) == ["here"]
        later(40, 9.0)
        voice.send(Say(text=ARE_YOU_THERE))
        assert later(45, 9.0) == []


def test_referee_counts_who_is_followed_and_who_crosses() -> None:
    referee = FollowReferee(Pose2D(1.0, 0.0, 0.0))
    robot = Pose2D(1.0, 0.0, 0.0)

    def see(now_s: float, followed: tuple[float, float] | None, other_y_m: float, busy: bool = True) -> None:
        shown = np.array([[3.0, 0.0, 0, 0, 0], [2.0, other_y_m, 0, 0, 0]])
        referee.see(now_s, robot, shown, followed, busy)

    see(0.0, None, 1.0, busy=False)
    assert referee.counts.task_s == 0.0
    for tick in range(1, 11):
        see(tick / 10, (2.0, 0.0), 1.0)
    for tick in range(11, 21):
        see(tick / 10, (1.0, 0.1), 0.1)  # between them, and taken for the person
    for tick in range(21, 31):
        see(tick / 10, None, 1.0)
    counts = referee.counts
    assert counts.task_s == pytest.approx(3.0)
    assert counts.near_share == pytest.approx(1.0)
    assert counts.following_s == pytest.approx(2.0)
    assert counts.wrong_s == pytest.approx(1.0)
    assert (counts.wrong_times, counts.crossings) == (1, 1)
    see(3.1, None, 0.1)
    assert referee.counts.crossings == 1
    see(6.0, None, 0.1)
    assert referee.counts.crossings == 2


def test_referee_survives_a_restart_and_ends_the_run(tmp_path: Path) -> None:
    settings = {"arena": str(APARTMENT), "ends_after_s": 5.0}
    people = WalkingPeople(read_arena(APARTMENT).people).shown.ravel()

    def play(referee: ModuleHarness[Referee], seconds: int) -> None:
        referee.send(SimulatedPeople(shown=people), topic="ground_truth")
        there = Odometry(header=Header(stamp=Time(sec=seconds)), pose=truth(1.1, 4.1).pose)
        referee.send(there, topic="ground_truth")
        referee.send(Following(state="STAND", position=Point(x=1.2)))
        referee.advance(0.2)

    with ModuleHarness(Referee, settings) as referee:
        play(referee, 1)
        play(referee, 3)
        kept = referee.checkpoint
    with ModuleHarness(Referee, settings, restored=kept, output_directory=tmp_path) as referee:
        requested = []
        for second in (4, 6):
            play(referee, second)
            requested.append(referee.module.stop_requested)
        assert requested == [False, True]
        referee.module.teardown()
    judgement = json.loads((tmp_path / "referee.json").read_text())
    assert (judgement["task_s"], judgement["near_share"], judgement["wrong_times"]) == (5.0, 1.0, 0)
