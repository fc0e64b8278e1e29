"""The module that keeps the no-go areas and places that people draw on the map."""

from pathlib import Path

import pytest

from robbie_mp import CallRefused, ModuleHarness, SettingError
from robbie_mp.messages import (
    AnnotateMap,
    MapAnnotations,
    NoGoArea,
    Point,
    PointOfInterest,
    Pose,
    Quaternion,
    TimeJump,
    UndoMapAnnotation,
)
from robbie_robots.modules.maps.map_annotations import MapAnnotator

STAIRS = NoGoArea(name="stairs", corners=[Point(x=x, y=y) for x, y in ((0, 0), (1, 0), (1, 1))])
KITCHEN = PointOfInterest(
    name="kitchen", pose=Pose(position=Point(x=2.0, y=0.5), orientation=Quaternion.from_yaw(1.5))
)
DRAW = AnnotateMap(no_go=[STAIRS], places=[KITCHEN])


def newest(harness: ModuleHarness[MapAnnotator]) -> MapAnnotations:
    return harness.take(MapAnnotations)[-1]


def names(told: MapAnnotations) -> tuple[list[str], list[str]]:
    return [area.name for area in told.no_go], [place.name for place in told.places]


def test_annotations_are_published_and_can_be_taken_back() -> None:
    with ModuleHarness(MapAnnotator) as harness:
        assert names(newest(harness)) == ([], [])
        assert harness.call(DRAW).revision == 1
        told = newest(harness)
        assert (told.header.frame_id, told.revision, told.can_undo) == ("map", 1, True)
        assert [(corner.x, corner.y) for corner in told.no_go[0].corners] == [(0, 0), (1, 0), (1, 1)]
        assert told.places[0].pose.orientation.yaw == pytest.approx(1.5)
        assert harness.call(UndoMapAnnotation()).revision == 2
        assert names(newest(harness)) == ([], [])
        with pytest.raises(CallRefused, match="there is no change to take back"):
            harness.call(UndoMapAnnotation())


def test_invalid_change_is_refused_whole() -> None:
    with ModuleHarness(MapAnnotator) as harness:
        harness.take(MapAnnotations)
        bad = AnnotateMap(no_go=[STAIRS, NoGoArea(name="hole")])
        with pytest.raises(CallRefused, match="'hole' must have 3 to 64 corners"):
            harness.call(bad)
        assert not harness.take(MapAnnotations)
        assert harness.checkpoint is None


def test_annotations_are_saved_beside_the_map_and_kept_when_module_or_robot_restart(tmp_path: Path) -> None:
    settings = {"map_file": str(tmp_path / "arena.yaml")}
    with ModuleHarness(MapAnnotator, settings) as harness:
        harness.call(DRAW)
        kept = harness.checkpoint
    assert (tmp_path / "arena.annotations.yaml").is_file()
    with ModuleHarness(MapAnnotator, settings) as robot_restarted:
        assert names(newest(robot_restarted)) == (["stairs"], ["kitchen"])
    with ModuleHarness(MapAnnotator, settings, restored=kept) as restarted:
        assert names(newest(restarted)) == (["stairs"], ["kitchen"])
        restarted.call(UndoMapAnnotation())
        assert names(newest(restarted)) == ([], [])
    with ModuleHarness(MapAnnotator, restored=kept) as on_another_map:
        assert names(newest(on_another_map)) == ([], [])


def test_change_that_cannot_be_saved_is_refused_and_not_made(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("a file", encoding="utf-8")
    with ModuleHarness(MapAnnotator, output_directory=tmp_path / "taken") as harness:
        with pytest.raises(CallRefused, match=r"the annotations cannot be saved in .*taken"):
            harness.call(DRAW)
        assert names(newest(harness)) == ([], [])


def test_unreadable_annotations_stop_the_robot_before_it_starts(tmp_path: Path) -> None:
    (tmp_path / "arena.annotations.yaml").write_text("no_go: 5", encoding="utf-8")
    with pytest.raises(SettingError, match="no_go and places must map names to coordinates"):
        ModuleHarness(MapAnnotator, {"map_file": str(tmp_path / "arena.yaml")})


@pytest.mark.parametrize("has_file", [False, True])
def test_time_jump_removes_only_annotations_of_a_map_that_begins_anew(tmp_path: Path, has_file: bool) -> None:
    settings = {"map_file": str(tmp_path / "arena.yaml")} if has_file else {}
    with ModuleHarness(MapAnnotator, settings) as harness:
        harness.call(DRAW)
        harness.send(TimeJump(reason="seek"))
        assert names(newest(harness)) == ((["stairs"], ["kitchen"]) if has_file else ([], []))
