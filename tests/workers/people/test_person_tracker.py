"""The tracker keeps persons apart who cross, forgets who has left, and takes furniture for furniture."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.workers.people.map_things import MapThings
from robbie_robots.workers.people.person_tracker import PersonTracker, TrackedPerson, TrackerSettings

Array = NDArray[np.float64]


def legs_of(x_m: float, y_m: float, heading_rad: float = 0.0, way_m: float = 0.0) -> Array:
    """Two legs that swing as the person walks."""
    swing = 0.22 * math.sin(math.tau * way_m / 0.9)
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    return np.array(
        [
            [x_m + cos * swing - sin * 0.09, y_m + sin * swing + cos * 0.09],
            [x_m - cos * swing + sin * 0.09, y_m - sin * swing - cos * 0.09],
        ]
    )


def watch(
    tracker: PersonTracker,
    scene: Callable[[float], Array],
    seconds: float,
    begin_s: float = 0.0,
    on_map: bool = False,
    hidden: bool = False,
) -> list[TrackedPerson]:
    """Show a scene at 10 Hz; with noise as a laser has it."""
    random = np.random.default_rng(1)
    for step in range(round(seconds * 10)):
        now_s = begin_s + step / 10
        legs = scene(now_s).reshape(-1, 2)
        legs = legs + random.normal(0.0, 0.01, legs.shape)
        tracker.see(now_s, legs, np.full(len(legs), 0.9), np.full(len(legs), on_map), lambda _xy: hidden)
    return tracker.persons


def nobody(_now_s: float) -> Array:
    return np.empty((0, 2))


def test_walking_person_is_one_track_with_place_and_velocity() -> None:
    persons = watch(PersonTracker(), lambda t: legs_of(0.8 * t, 1.0, 0.0, 0.8 * t), 5.0)
    assert len(persons) == 1
    np.testing.assert_allclose(persons[0].xy_m, (0.8 * 4.9, 1.0), atol=0.12)
    np.testing.assert_allclose(persons[0].velocity_m_per_s, (0.8, 0.0), atol=0.25)
    assert persons[0].has_moved and persons[0].unseen_s == 0.0


def test_persons_who_cross_at_a_right_angle_keep_their_numbers() -> None:
    def scene(t: float) -> Array:
        along, across = legs_of(0.7 * t, 0.0, 0.0, 0.7 * t), legs_of(2.1, 0.7 * t - 2.8, math.pi / 2, 0.7 * t)
        return np.concatenate([along, across])

    tracker = PersonTracker()
    before = {round(float(one.xy_m[1])): one.number for one in watch(tracker, scene, 1.5)}
    after = watch(tracker, scene, 5.0, begin_s=1.5)
    assert len(before) == len(after) == 2
    by_number = {one.number: one.xy_m for one in after}
    assert by_number[before[0]][0] > 4.0
    assert by_number[before[-2]][1] > 1.0


def test_person_hidden_for_a_moment_keeps_its_number_and_one_who_left_does_not() -> None:
    def scene(t: float) -> Array:
        return nobody(t) if 2.0 <= t < 3.8 else legs_of(0.5 * min(t, 2.4), 0.0)

    hidden = PersonTracker()
    first = watch(hidden, scene, 2.0)[0].number
    watch(hidden, scene, 1.8, begin_s=2.0, hidden=True)
    assert [one.number for one in watch(hidden, scene, 1.0, begin_s=3.8)] == [first]
    gone = PersonTracker()
    first = watch(gone, scene, 2.0)[0].number
    assert watch(gone, scene, 1.8, begin_s=2.0) == []
    assert [one.number for one in watch(gone, scene, 1.0, begin_s=3.8)] != [first]


def test_hidden_person_does_not_take_a_leg_of_the_one_in_front() -> None:
    def scene(t: float) -> Array:
        crosser = legs_of(2.0, 0.7 * t - 2.1, math.pi / 2, 0.7 * t)
        return crosser if 2.6 <= t < 4.0 else np.concatenate([crosser, legs_of(2.35, 0.0)])

    tracker = PersonTracker()
    before = {round(float(one.xy_m[1])): one.number for one in watch(tracker, scene, 2.0)}
    assert len(before) == 2
    hidden = {one.number: one for one in watch(tracker, scene, 1.9, begin_s=2.0, hidden=True)}
    assert hidden[before[-1]].unseen_s == 0.0
    assert hidden[before[0]].unseen_s > 1.0
    after = {one.number: one for one in watch(tracker, scene, 0.5, begin_s=4.0)}
    np.testing.assert_allclose(after[before[0]].xy_m, (2.35, 0.0), atol=0.15)


def test_person_shows_two_legs_and_a_corner_only_one() -> None:
    person, corner = legs_of(1.0, 1.0), np.array([[3.0, 0.0]])
    tracker = PersonTracker()
    persons = watch(tracker, lambda _t: np.concatenate([person, corner]), 2.0)
    again = PersonTracker()
    again.remember(tracker.memory())
    for seen in (persons, again.persons):
        assert {round(float(one.xy_m[0])): round(one.two_legs) for one in seen} == {1: 1, 3: 0}


def test_thing_on_the_map_is_no_person_until_it_moves() -> None:
    tracker = PersonTracker()
    assert watch(tracker, lambda _t: legs_of(1.0, 1.0), 2.0, on_map=True) == []
    (thing,) = tracker.things
    np.testing.assert_allclose(thing.xy_m, (1.0, 1.0), atol=0.05)
    persons = watch(tracker, lambda t: legs_of(1.0 + 0.6 * (t - 2.0), 1.0), 2.0, begin_s=2.0)
    assert [one.has_moved for one in persons] == [True]
    assert tracker.things == []


def test_unlikely_legs_begin_no_track_but_continue_one() -> None:
    tracker = PersonTracker()
    for step in range(20):
        tracker.see(step / 10, legs_of(1.0, 1.0), np.full(2, 0.3))
    assert tracker.persons == []
    watch(tracker, lambda _t: legs_of(1.0, 1.0), 1.0, begin_s=2.0)
    tracker.see(3.0, legs_of(1.0, 1.0), np.full(2, 0.3))
    assert [one.unseen_s for one in tracker.persons] == [0.0]


def test_tracks_are_bounded_and_those_that_end_are_counted() -> None:
    tracker = PersonTracker(TrackerSettings(max_tracks=5))
    crowd = np.concatenate([legs_of(2.0 * index, 0.0) for index in range(8)])
    assert len(watch(tracker, lambda _t: crowd, 1.0)) == 5
    assert tracker.dropped >= 3


def test_scan_that_is_not_newer_is_ignored() -> None:
    tracker = PersonTracker()
    watch(tracker, lambda _t: legs_of(1.0, 1.0), 1.0)
    tracker.see(0.3, np.empty((0, 2)), np.empty(0))
    assert tracker.persons[0].unseen_s == 0.0


def test_everybody_is_forgotten_when_time_jumps_back() -> None:
    tracker = PersonTracker()
    watch(tracker, lambda _t: legs_of(1.0, 1.0), 1.0, begin_s=50.0)
    tracker.see(3.0, np.empty((0, 2)), np.empty(0))
    assert tracker.persons == []


def test_restored_tracker_goes_on_with_the_same_numbers() -> None:
    tracker = PersonTracker()
    number = watch(tracker, lambda t: legs_of(0.5 * t, 0.0), 3.0)[0].number
    again = PersonTracker()
    again.remember(tracker.memory())
    persons = watch(again, lambda t: legs_of(0.5 * t, 0.0), 1.0, begin_s=3.3)
    assert [(one.number, one.has_moved) for one in persons] == [(number, True)]


def test_map_shows_things_at_their_places_and_a_little_around() -> None:
    cells = np.zeros((20, 40), np.int8)
    cells[10, 30] = 100
    things = MapThings(cells, 0.05, (-1.0, 2.0))
    at = np.array([[0.525, 2.525], [0.45, 2.525], [0.3, 2.525], [50.0, 50.0], [-1.2, 2.5]])
    assert things.at(at).tolist() == [True, True, False, False, False]


def test_leg_of_furniture_counts_as_a_person_only_until_the_map_shows_it() -> None:
    tracker = PersonTracker()
    assert len(watch(tracker, lambda _t: legs_of(1.0, 1.0), 1.0)) == 1
    assert watch(tracker, lambda _t: legs_of(1.0, 1.0), 2.0, begin_s=1.0, on_map=True) == []


def test_track_that_goes_over_from_one_thing_on_the_map_to_the_next_has_not_moved() -> None:
    def table(now_s: float) -> Array:  # the laser sees one leg of it, then the other one
        return np.array([[1.0, 0.55 * (now_s >= 1.0)]])

    tracker = PersonTracker()
    watch(tracker, table, 3.0, on_map=True)
    assert [one.has_moved for one in tracker.things] == [False]
    tracker = PersonTracker()
    watch(tracker, lambda t: legs_of(1.0 + max(0.0, 0.5 * (t - 1.0)), 0.0), 1.0, on_map=True)
    assert tracker.persons == [] and len(tracker.things) == 1
    watch(tracker, lambda t: legs_of(1.0 + 0.5 * (t - 1.0), 0.0), 3.0, begin_s=1.0)
    assert [one.has_moved for one in tracker.persons] == [True]


def test_person_whom_two_lasers_see_is_one_person_even_if_both_scans_have_one_stamp() -> None:
    tracker = PersonTracker()
    random = np.random.default_rng(1)
    for step in range(30):
        now_s = step / 10
        walker, behind = legs_of(0.5 * now_s, 1.0, 0.0, 0.5 * now_s), legs_of(-2.0, 0.0)
        for laser, legs in (("laser", walker), ("rear_laser", np.concatenate([walker[:1], behind]))):
            noisy = legs + random.normal(0.0, 0.01, legs.shape)
            tracker.see(now_s, noisy, np.full(len(legs), 0.9), laser=laser)
    persons = sorted(tracker.persons, key=lambda one: float(one.xy_m[0]))
    assert [one.unseen_s for one in persons] == [0.0, 0.0]
    np.testing.assert_allclose([one.xy_m for one in persons], [(-2.0, 0.0), (1.45, 1.0)], atol=0.15)


def test_scan_of_another_laser_that_is_a_little_late_counts_and_a_stale_one_does_not() -> None:
    tracker = PersonTracker()
    for step in range(20):
        now_s = 5.0 + step / 10
        tracker.see(now_s, nobody(now_s), np.empty(0), laser="laser")
        for laser, late_s, x_m in (("rear_laser", 0.05, -1.0), ("old_laser", 0.5, -3.0)):
            tracker.see(now_s - late_s, legs_of(x_m, 0.0), np.full(2, 0.9), laser=laser)
    (person,) = tracker.persons
    assert person.xy_m[0] == pytest.approx(-1.0, abs=0.05)
    again = PersonTracker()
    again.remember(tracker.memory())
    again.see(6.85, legs_of(-1.0, 0.0), np.full(2, 0.9), laser="rear_laser")
    assert len(again.persons) == 1, "a scan that it has seen before its restart"
    tracker.see(1.0, nobody(1.0), np.empty(0), laser="laser")
    assert tracker.persons == [], "time has jumped back"
