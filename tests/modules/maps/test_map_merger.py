"""The map of a team."""

import math
from typing import Any

import numpy as np
import pytest

from robbie_mp import Module, ModuleHarness, SettingError
from robbie_mp.messages import MapMetaData, OccupancyGrid, Point, Pose, PoseStamped, Quaternion, TFMessage
from robbie_mp.module.harness import NotSubscribed
from robbie_robots.modules.maps import map_merger
from robbie_robots.modules.maps.map_merger import MapMerger
from robbie_robots.modules.navigation.navigation import Navigation
from robbie_robots.modules.rescue.mission import RescueMission
from robbie_robots.modules.rescue.team_messages import MapAlignment
from robbie_robots.modules.rescue.victims import Victims
from robbie_robots.workers.maps.map_alignment import GridMap
from tests._support.present import present
from tests.workers._support.known_room import draw
from tests.workers.maps.test_map_alignment import BLUE, RED, TRUE, off


def message(grid: GridMap) -> OccupancyGrid:
    x, y = np.asarray(grid.corner_xy_m, float).tolist()
    height, width = grid.cells.shape
    origin = Pose(position=Point(x=x, y=y))
    info = MapMetaData(resolution=grid.resolution_m, width=width, height=height, origin=origin)
    return OccupancyGrid(info=info, data=grid.cells.ravel())


def known_m2(grid: OccupancyGrid) -> float:
    return float((grid.data >= 0).sum()) * grid.info.resolution**2


def merge(other: GridMap, restored: object = None, **settings: Any) -> ModuleHarness[MapMerger]:
    harness = ModuleHarness(MapMerger, {"robots": ["blue"], **settings}, restored=restored)
    with harness:
        harness.send(message(draw(RED, to_x_m=7.0)), topic="own")
        harness.advance(0.0)
        harness.send(message(other), topic="blue/own")
        harness.advance(1.1)
    return harness


def test_maps_become_one_and_the_scene_graph_learns_where_the_other_map_is() -> None:
    harness = merge(draw(BLUE, from_x_m=1.0))
    alone, team = harness.take(OccupancyGrid, "team")
    assert known_m2(team) > 1.1 * known_m2(alone)
    (alignment,) = harness.take(MapAlignment, "blue")
    assert alignment.is_sure and not alignment.is_known
    position = alignment.pose.position
    assert off([position.x, position.y, alignment.pose.orientation.yaw])[0] < 0.06
    (placed,) = harness.take(TFMessage, "placed")[-1].transforms
    assert (placed.header.frame_id, placed.child_frame_id) == ("map", "blue/map")
    assert harness.module.status == "blue: sure"
    assert off(harness.checkpoint["places"]["blue"])[0] < 0.06


def test_map_that_does_not_fit_is_not_merged() -> None:
    harness = merge(draw(BLUE, from_x_m=0.1, to_x_m=0.2))
    alone, team = harness.take(OccupancyGrid, "team")
    assert known_m2(team) == known_m2(alone)
    assert not harness.take(TFMessage, "placed")
    assert not harness.take(MapAlignment, "blue")[-1].is_sure
    assert harness.module.status.startswith("blue: only 0.")


def test_known_start_counts_until_the_maps_confirm_it() -> None:
    harness = merge(draw(BLUE, from_x_m=7.0), starts={"blue": TRUE.tolist()})
    alone, team = harness.take(OccupancyGrid, "team")
    assert known_m2(team) > known_m2(alone)
    (alignment,) = harness.take(MapAlignment, "blue")
    assert alignment.is_known and not alignment.is_sure


@pytest.mark.parametrize("is_restarted", [False, True])
def test_what_was_another_robot_is_no_wall_on_the_team_map(is_restarted: bool) -> None:
    own = np.zeros((80, 80), np.int8)
    own[38:42, 38:42] = 100  # blue, as this robot's laser saw it when it stood there
    own[47, 50] = 100  # what blue left there while it moved, 0.35 m from its way
    own[70, :] = 100
    seen_by_blue = message(GridMap(np.zeros((80, 80), np.int8), 0.05, (0.0, 0.0)))
    settings = {"robots": ["blue"], "starts": {"blue": [1.0, 0.0, 0.0]}}
    with ModuleHarness(MapMerger, settings) as harness:
        for x_m in (1.0, 1.5, 2.0):  # in the map of blue, whose frame lies at x = 1 m
            pose = Pose(position=Point(x=x_m, y=2.0))
            harness.send(PoseStamped(pose=pose), topic="blue/map_pose")
        harness.advance(1.1)
        if not is_restarted:
            harness.send(message(GridMap(own, 0.05, (0.0, 0.0))), topic="own")
            harness.send(seen_by_blue, topic="blue/own")
            harness.advance(1.1)
    if is_restarted:
        harness = ModuleHarness(MapMerger, settings, restored=harness.checkpoint)
        with harness:
            harness.send(message(GridMap(own, 0.05, (0.0, 0.0))), topic="own")
            harness.send(seen_by_blue, topic="blue/own")
            harness.advance(1.1)
    team = harness.take(OccupancyGrid, "team")[-1]
    cells = team.data.reshape(team.info.height, team.info.width)
    assert (cells[38:42, 38:42] == 0).all()
    assert cells[47, 50] == 0
    assert (cells[70, :80] == 100).all()


def test_trail_of_a_robot_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_merger, "MAX_TRAIL", 10)
    with ModuleHarness(MapMerger, {"robots": ["blue"]}) as harness:
        for number in range(40):
            pose = Pose(position=Point(x=0.2 * number))
            harness.send(PoseStamped(pose=pose), topic="blue/map_pose")
            harness.send(PoseStamped(pose=pose), topic="blue/map_pose")
        trail = harness.module.trails["blue"]
    assert len(trail) <= 10
    assert trail[-1][0] == pytest.approx(7.8)


def test_restarted_merger_still_knows_where_the_other_map_is() -> None:
    restored = {"places": {"blue": TRUE.tolist()}, "trails": {}}
    with ModuleHarness(MapMerger, {"robots": ["blue"]}, restored=restored) as harness:
        harness.send(message(draw(RED)), topic="own")
        harness.advance(0.0)
        (placed,) = harness.take(TFMessage, "placed")[-1].transforms
        assert placed.transform.translation.x == pytest.approx(TRUE[0])


@pytest.mark.parametrize(
    ("module", "kept"), [(Navigation, "grid"), (RescueMission, "map"), (Victims, "map_info")]
)
def test_modules_use_the_map_that_the_profile_names_and_no_other(module: type[Module], kept: str) -> None:
    with ModuleHarness(module, {"map_topic": "team"}) as harness:
        with pytest.raises(NotSubscribed):
            harness.send(message(draw(BLUE)), topic="blue/own")
        assert getattr(harness.module, kept) is None
        harness.send(message(draw(RED)), topic="team")
        assert getattr(harness.module, kept) is not None


def test_empty_map_is_ignored() -> None:
    with ModuleHarness(MapMerger, {"robots": ["blue"]}) as harness:
        harness.send(OccupancyGrid(), topic="blue/own")
        harness.advance(1.1)
        assert harness.module.refused == 1
        assert harness.module.status == "waiting for this robot's map"


def test_turned_map_is_used_along_the_axes() -> None:
    cells = np.array([[0, 0, 100]], np.int8)
    origin = Pose(position=Point(x=1.0, y=2.0), orientation=Quaternion.from_yaw(math.pi / 2))
    info = MapMetaData(resolution=0.5, width=3, height=1, origin=origin)
    with ModuleHarness(MapMerger, {"robots": ["blue"]}) as harness:
        harness.send(OccupancyGrid(info=info, data=cells.ravel()), topic="own")
        harness.advance(1.1)
        own = present(harness.module.own)
        assert own.cells.tolist() == [[0], [0], [100]]
        assert own.corner_xy_m == pytest.approx((0.5, 2.0))


@pytest.mark.parametrize(
    ("starts", "problem"),
    [({"green": [0.0, 0.0, 0.0]}, "'green' is none of the robots blue"), ({"blue": [1.0]}, "expected x, y")],
)
def test_wrong_starts_are_explained(starts: dict[str, list[float]], problem: str) -> None:
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(MapMerger, {"robots": ["blue"], "starts": starts})
