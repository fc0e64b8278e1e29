"""The tasks "learn this person" and "who is who": which persons the robot meets, and whose face it sees."""

import math

import numpy as np
import pytest

from robbie_mp.base.state_machine import mermaid
from robbie_mp.bus.checkpoint.image import decode, encode
from robbie_robots.workers.home.follow import PersonReport
from robbie_robots.workers.home.person_places import MAX_PLACES, Eye, SeenFace
from robbie_robots.workers.home.person_tour import (
    TRANSITIONS,
    Met,
    PersonTour,
    TourOrders,
    TourSettings,
    TourState,
)
from tests._support.places import PROJECT


class Scene:
    """A robot that drives as it is told, at 10 Hz, in a room of 10 m by 6 m; its camera is in its middle."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.pose = (0.0, 0.0, 0.0)
        self.pan_rad = 0.0
        self.persons: dict[str, tuple[float, float]] = {}
        self.faces: dict[str, str] = {}
        self.walked: set[str] = set()
        self.confidence: dict[str, float] = {}
        self.cells = np.zeros((120, 200), np.int8)
        self.cells[[0, -1], :] = self.cells[:, [0, -1]] = 100
        self.tour = self.started()

    def started(self) -> PersonTour:
        tour = PersonTour(lambda: self.now_s)
        tour.see_map(self.cells, 0.05, (-1.0, -3.0))
        return tour

    def restart(self) -> None:
        kept = decode(encode(self.tour.memory())).state
        self.tour = self.started()
        self.tour.remember(kept)

    def run(self, seconds: float) -> TourOrders:
        orders = TourOrders()
        for _ in range(round(seconds * 10)):
            self.now_s += 0.1
            self.tour.see_pose(self.pose)
            self.tour.see_persons([self.report(name) for name in self.persons])
            eye = Eye(*self.pose[:2], self.pose[2] + self.pan_rad, 0.6)
            shown = [SeenFace(*self.seen(name)) for name in self.faces]
            self.tour.see_faces(
                [face for face in shown if abs(face.bearing_rad - eye.bearing_rad) < 0.6], eye
            )
            orders = self.tour.step()
            self.turn(orders.look_at_xy_m)
            if orders.goal is not None:
                self.drive(*orders.goal.tolist())
        return orders

    def report(self, name: str) -> PersonReport:
        confidence = self.confidence.get(name, 1.0)
        return PersonReport(name, self.persons[name], has_moved=name in self.walked, confidence=confidence)

    def turn(self, to: tuple[float, float] | None) -> None:
        self.pan_rad = 0.0
        if to is not None:
            self.pan_rad = math.atan2(to[1] - self.pose[1], to[0] - self.pose[0]) - self.pose[2]

    def seen(self, name: str) -> tuple[str, float, None, float]:
        x, y = np.subtract(self.persons[name], self.pose[:2])
        return self.faces[name], math.atan2(y, x), None, math.hypot(x, y)

    def drive(self, x: float, y: float, heading: float) -> None:
        away = math.dist((x, y), self.pose[:2])
        if away < 0.3:
            self.tour.arrived()
            return
        step = 0.07 / away
        self.pose = (
            self.pose[0] + step * (x - self.pose[0]),
            self.pose[1] + step * (y - self.pose[1]),
            heading,
        )


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_robot_meets_everybody_and_ends_when_it_has_looked_everywhere(scene: Scene) -> None:
    scene.persons = {"1": (3.0, 2.0), "2": (7.5, -1.5), "3": (5.0, 0.0)}
    scene.faces = {"1": "Anna", "2": "", "3": "Ben"}
    scene.tour.go_round(0)
    scene.run(90.0)
    assert scene.tour.end is not None and scene.tour.end.is_done
    assert {(one.name, one.xy_m) for one in scene.tour.met} == {
        ("Anna", (3.0, 2.0)),
        ("", (7.5, -1.5)),
        ("Ben", (5.0, 0.0)),
    }
    assert max(one.faces for one in scene.tour.met) == TourSettings().most_faces


def test_each_place_is_one_goal_and_the_robot_does_not_weave_through_a_wide_room(scene: Scene) -> None:
    scene.tour.go_round(0)
    goals = [tuple(goal.tolist()) for _ in range(130) if (goal := scene.run(0.1).goal) is not None]
    different = list(dict.fromkeys(goals))
    assert len(different) == len({goal[:2] for goal in different})
    sides = np.sign([goal[1] for goal in different])
    assert np.count_nonzero(np.diff(sides)) <= 4


def test_round_for_one_person_ends_with_that_person(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (2.0, 1.0), "2": (6.0, 1.0)}, {"1": "Anna", "2": "Ben"}
    scene.tour.go_round(1)
    scene.run(30.0)
    assert [one.name for one in scene.tour.met] == ["Anna"]


def approaches(scene: Scene) -> int:
    """Let the robot end its round, and return how often it went to somebody."""
    count, was = 0, scene.tour.state
    while scene.tour.end is None:
        scene.run(0.1)
        count += scene.tour.state is not was and scene.tour.state is TourState.APPROACH
        was = scene.tour.state
    assert (scene.tour.end.is_done, scene.tour.end.reason) == (True, "has looked everywhere")
    return count


@pytest.mark.parametrize(
    ("confidence", "has_walked", "expected"),
    [
        (0.9, False, 1),  # furniture that looks much like legs
        (0.5, False, 0),  # a little: the camera looks at it in passing
        (0.5, True, 2),  # somebody who may have looked away
    ],
)
def test_robot_goes_to_what_shows_no_face_according_to_how_likely_it_is_a_person(
    scene: Scene, confidence: float, has_walked: bool, expected: int
) -> None:
    scene.persons, scene.confidence = {"1": (3.0, 1.0)}, {"1": confidence}
    scene.walked = {"1"} if has_walked else set()
    scene.tour.go_round(0)
    assert approaches(scene) == expected
    assert scene.tour.met == []


def test_thing_that_showed_no_face_is_left_alone_when_its_legs_get_a_new_track(scene: Scene) -> None:
    scene.persons = {"1": (3.0, 1.0)}
    scene.tour.go_round(0)
    scene.run(1.0)
    while scene.tour.state is not TourState.SEARCH:
        scene.run(0.1)
    scene.persons = {"2": (3.1, 1.1)}
    assert approaches(scene) == 0


def test_face_of_somebody_behind_a_thing_is_not_that_of_the_thing(scene: Scene) -> None:
    scene.persons = {"thing": (2.0, 0.0), "stranger": (2.9, 0.1)}
    scene.faces = {"stranger": ""}
    scene.tour.go_round(0)
    scene.run(60.0)
    assert [(one.name, one.xy_m) for one in scene.tour.met] == [("", (2.9, 0.1))]


def test_somebody_whose_legs_are_hardly_legs_is_met_because_the_camera_finds_the_face(scene: Scene) -> None:
    scene.persons, scene.confidence, scene.faces = {"1": (3.0, 1.0)}, {"1": 0.3}, {"1": "Anna"}
    scene.tour.go_round(0)
    assert approaches(scene) == 1
    assert [one.name for one in scene.tour.met] == ["Anna"]


def test_who_walks_on_after_the_meeting_is_told_where_she_stands_at_the_end(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": ""}
    scene.tour.go_round(0)
    scene.run(1.0)
    assert [one.xy_m for one in scene.tour.met] == [(1.2, 0.0)]
    for step in range(1, 11):
        scene.persons["1"] = (1.2 + 0.28 * step, 0.2 * step)
        scene.run(0.1)
    assert approaches(scene) == 0
    assert [one.xy_m for one in scene.tour.met] == [(4.0, 2.0)]


def test_somebody_else_who_gets_the_track_of_who_was_met_is_met_too(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": ""}
    scene.tour.go_round(0)
    scene.run(1.0)
    scene.persons["1"] = (6.0, 2.0)  # after a restart of the tracker
    assert approaches(scene) == 1
    assert [one.xy_m for one in scene.tour.met] == [(1.2, 0.0), (6.0, 2.0)]


def test_robot_waits_only_a_moment_for_somebody_who_has_gone(scene: Scene) -> None:
    scene.persons = {"1": (3.0, 0.0)}
    scene.walked = {"1"}
    scene.tour.go_round(0)
    while scene.tour.state is not TourState.LOOK:
        scene.run(0.1)
    scene.persons = {}
    scene.run(TourSettings().gone_s + 0.2)
    assert scene.tour.machine.reason == "saw no face"


def test_places_beyond_the_limit_are_counted(scene: Scene) -> None:
    scene.persons = {str(number): (0.5 * number, 0.0) for number in range(MAX_PLACES + 3)}
    scene.run(0.1)
    assert scene.tour.places.dropped == 3


def test_face_that_is_seldom_recognized_stays_unknown(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": ""}
    scene.tour.go_round(0)
    scene.run(0.2)
    for name in ("Anna", "", "", "Anna", "", ""):
        scene.faces["1"] = name
        scene.run(0.1)
    assert [one.name for one in scene.tour.met] == [""]


def test_name_that_is_met_again_elsewhere_replaces_the_older_place(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": "Anna"}
    scene.tour.go_round(0)
    scene.run(1.0)
    scene.persons["1"] = (1.2, 1.0)
    scene.run(3.0)
    assert scene.tour.met == [Met("Anna", (1.2, 1.0), 3)]


def test_person_in_front_is_learnt_and_refused_pictures_are_taken_again(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (2.0, 0.1), "2": (0.0, 1.0)}, {"1": "", "2": ""}
    scene.tour.learn("Anna")
    scene.run(3.0)
    assert scene.tour.to_learn == SeenFace(*scene.seen("1"))
    scene.tour.not_learnt("no face is found")
    assert scene.tour.state is TourState.LOOK
    scene.run(0.2)
    scene.tour.learnt()
    assert scene.tour.end is not None
    assert (scene.tour.end.is_done, scene.tour.state) == (True, TourState.IDLE)


def test_learning_fails_if_nobody_is_in_front_or_shows_a_face_or_all_pictures_are_refused(
    scene: Scene,
) -> None:
    reasons = []
    for persons, faces in (({}, {}), ({"1": (1.2, 0.0)}, {}), ({"1": (1.2, 0.0)}, {"1": ""})):
        scene.persons, scene.faces = persons, faces
        scene.tour.learn("Anna")
        while scene.tour.end is None:
            scene.run(0.1)
            scene.tour.not_learnt("no face is found")
        assert not scene.tour.end.is_done
        reasons.append(scene.tour.end.reason)
    assert reasons == ["nobody is in front of the robot", "sees no face", "no face is found"]


def test_robot_goes_on_to_others_if_it_cannot_get_to_a_person(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (4.0, 0.0), "2": (6.0, 2.0)}, {"2": "Ben"}
    scene.tour.go_round(0)
    for _ in range(900):
        scene.run(0.1)
        if scene.tour.state is TourState.APPROACH and scene.tour.machine.reason.endswith("person 1"):
            scene.tour.unreachable("no way")
    assert [one.name for one in scene.tour.met] == ["Ben"]


def test_round_ends_in_time_with_those_who_were_met(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": "Anna"}
    scene.tour.go_round(0)
    scene.run(1.0)
    scene.now_s += TourSettings().tour_s
    scene.run(0.1)
    assert scene.tour.end is not None and scene.tour.end.is_done
    assert [one.name for one in scene.tour.met] == ["Anna"]


def test_cancelled_order_ends_at_once_and_none_is_not_cancelled(scene: Scene) -> None:
    scene.tour.cancel("was told to stop")
    assert scene.tour.end is None
    scene.persons["1"] = (3.0, 0.0)
    scene.tour.go_round(0)
    scene.run(1.0)
    scene.tour.cancel("was told to stop")
    assert scene.tour.state is TourState.IDLE
    assert scene.run(0.2) == TourOrders()


def test_order_that_ends_on_the_way_to_a_place_leaves_no_goal(scene: Scene) -> None:
    scene.tour.go_round(0)
    assert scene.run(1.0).goal is not None
    scene.tour.cancel("enough")
    assert scene.run(0.1) == TourOrders()


def test_restarted_task_goes_on_with_those_who_were_met(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0), "2": (1.0, 1.5)}, {"1": "Anna", "2": "Ben"}
    scene.tour.go_round(2)
    scene.run(0.7)
    assert [one.name for one in scene.tour.met] == ["Anna"]
    scene.restart()
    scene.run(10.0)
    assert [one.name for one in scene.tour.met] == ["Anna", "Ben"]
    assert scene.tour.end is not None and scene.tour.end.is_done
    scene.tour.learn("Clara")
    memory = scene.tour.memory()
    again = scene.started()
    again.remember(memory)
    assert (again.state, again.learns) == (TourState.CHOOSE, "Clara")


@pytest.mark.parametrize("state", [TourState.SEARCH, TourState.APPROACH, TourState.LOOK])
def test_round_killed_in_each_state_meets_everybody(state: TourState, scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (3.0, 0.0), "2": (5.0, 1.5)}, {"1": "Anna", "2": "Ben"}
    scene.tour.go_round(2)
    for met in (0,) if state is TourState.SEARCH else (0, 1):
        while scene.tour.state is not state or len(scene.tour.met) != met:
            scene.run(0.1)
        scene.restart()
    scene.run(60.0)
    assert [one.name for one in scene.tour.met] == ["Anna", "Ben"]
    assert scene.tour.end is not None and scene.tour.end.is_done


@pytest.mark.parametrize("state", [TourState.CHOOSE, TourState.APPROACH, TourState.LOOK, TourState.LEARN])
def test_lesson_killed_in_each_state_begins_again(state: TourState, scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (2.0, 0.1)}, {"1": ""}
    scene.tour.learn("Anna")
    while scene.tour.state is not state:
        scene.run(0.1)
    scene.restart()
    while scene.tour.to_learn is None:
        scene.run(0.1)
    scene.tour.learnt()
    assert scene.tour.end is not None and scene.tour.end.is_done


def test_lesson_that_is_never_answered_ends(scene: Scene) -> None:
    scene.persons, scene.faces = {"1": (1.2, 0.0)}, {"1": ""}
    scene.tour.learn("Anna")
    settings = TourSettings()
    scene.run(settings.teachings * (settings.learn_s + 1.0))
    assert scene.tour.end is not None
    assert (scene.tour.end.is_done, scene.tour.end.reason) == (False, "that took too long")


def test_state_diagram_in_the_documentation_matches_the_declaration() -> None:
    page = (PROJECT / "docs" / "home.md").read_text()
    assert mermaid(TourState.IDLE, TRANSITIONS, TourSettings().time_outs()) in page
