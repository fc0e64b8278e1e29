"""Victims are found in images, and placed by the size of their tags."""

import math

import numpy as np
import pytest

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import ArenaVictim, VictimKind, WallSpot
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.workers.rescue import victim_detection
from robbie_robots.workers.rescue.victim_detection import Projection, VictimDetector, VisionMissing

GEOMETRY = CameraGeometry(400, 200, 1.4)
PROJECTION = Projection((GEOMETRY.focal_length_px,) * 2, GEOMETRY.centre_px)
WALL_X_M, TAG = 8.0, 7


def seen_from(distance_m: float, aside_rad: float) -> list[victim_detection.TagSighting]:
    """What the detector sees when the camera looks at the victim's tag from a place."""
    victim = ArenaVictim(TAG, VictimKind.STILL, WallSpot(WALL_X_M, 3.0, 0.35, math.pi))
    arena = Arena(
        segments=box_segments(np.array([[0.0, 0.0, WALL_X_M, 6.0]])),
        circles=np.zeros((0, 3)),
        start=Pose(1.0, 1.0, 0.0),
        width_m=WALL_X_M,
        height_m=6.0,
        victims=(victim,),
    )
    camera = SimulatedCamera(arena, GEOMETRY)
    x, y = WALL_X_M - distance_m * math.cos(aside_rad), 3.0 + distance_m * math.sin(aside_rad)
    camera.place(Pose(x, y, -aside_rad).plus(Pose(-GEOMETRY.mount_m[0], 0.0, 0.0)), 0.0)
    return VictimDetector().detect(camera.capture().pixels.astype(np.uint8), PROJECTION)


@pytest.mark.parametrize(("distance_m", "aside_rad"), [(0.6, 0.0), (1.2, 0.9), (2.0, 0.5), (2.4, 0.0)])
def test_size_of_the_tag_gives_the_victims_position(distance_m: float, aside_rad: float) -> None:
    (sighting,) = seen_from(distance_m, aside_rad)
    assert sighting.tag == TAG
    assert sighting.position_m == pytest.approx([0.0, 0.0, distance_m], abs=0.12)
    # Where it looks to, of which only the side is told apart from afar.
    assert sighting.normal[2] == pytest.approx(-math.cos(aside_rad), abs=0.25)


def test_patch_shows_the_tag_and_what_is_around_it() -> None:
    (sighting,) = seen_from(1.0, 0.0)
    assert sighting.patch.shape[0] == pytest.approx(2 * sighting.edge_px, abs=4)
    assert sighting.patch.std() > 40  # black and white


def test_tag_that_is_too_small_is_ignored() -> None:
    assert seen_from(7.0, 0.0) == []


def test_missing_opencv_is_reported_with_the_package_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(victim_detection, "import_module", missing)
    with pytest.raises(VisionMissing, match="opencv-python-headless"):
        VictimDetector()
