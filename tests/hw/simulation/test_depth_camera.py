"""The simulated depth camera measures where rays end; random rooms have room for all objects."""

import math
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.depth_camera import SimulatedDepthCamera
from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.hw.simulation.table_room import KINDS, TWINS, generate_room, main

GEOMETRY = CameraGeometry(81, 61, 1.0)


def looking_down(x: float, z: float, down_rad: float) -> NDArray[np.float64]:
    """A camera's pose: z ahead along x and down, x to the right."""
    sin, cos = math.sin(down_rad), math.cos(down_rad)
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = (0, -1, 0), (-sin, 0, -cos), (cos, 0, -sin)
    pose[:3, 3] = (x, 0.0, z)
    return pose


def test_depths_are_those_of_the_nearest_surface() -> None:
    camera = SimulatedDepthCamera(GEOMETRY, noise_m=0.0)
    box = Placed(Solid((0.2, 0.2, 0.4)), pose_at((1.0, 0.0, 0.2)))
    down = camera.capture(looking_down(1.0, 1.0, math.pi / 2), [box])
    assert down[30, 40] == 600
    # Beside the box is the floor; depths are measured along the camera's axis.
    assert down[0, 0] == down[60, 80] == 1000
    # 45 degrees down, it sees the near edge of the top before the floor.
    ahead = camera.capture(looking_down(0.4, 0.9, math.pi / 4), [box])
    assert ahead[30, 40] == round(1000 * 0.5 * math.sqrt(2))


def test_what_is_too_near_or_too_far_is_not_measured() -> None:
    camera = SimulatedDepthCamera(GEOMETRY, noise_m=0.0, range_m=(0.3, 0.8))
    can = Placed(Solid((0.1, 0.1, 0.9), is_round=True), pose_at((1.0, 0.0, 0.45)))
    depths = camera.capture(looking_down(1.0, 1.0, math.pi / 2), [can])
    assert not depths.any()


def test_noise_grows_with_the_square_of_the_distance() -> None:
    camera = SimulatedDepthCamera(GEOMETRY, noise_m=0.004, seed=2)
    spread = [float(camera.capture(looking_down(0.0, z, math.pi / 2), []).std()) for z in (1.0, 2.0)]
    assert spread == pytest.approx([4.0, 16.0], rel=0.1)


def test_random_rooms_are_valid_and_differ(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    texts = [generate_room(seed) for seed in range(20)]
    assert len(set(texts)) == 20
    assert generate_room(3) == texts[3]
    file = tmp_path / "room.yaml"
    for text in texts[:5]:
        file.write_text(text)
        assert {one.name for one in read_arena(file).objects} == set(KINDS)
    assert main(["--seed", "3"]) == 0
    assert capsys.readouterr().out == texts[3]


def test_twins_of_a_random_room_differ_only_by_their_print(tmp_path: Path) -> None:
    file = tmp_path / "room.yaml"
    for seed in range(6):
        file.write_text(generate_room(seed, has_twins=True))
        named = {one.name: one for one in read_arena(file).objects}
        assert len(named) == 3
        one, other = (named[name] for name in TWINS[seed % 2][:2])
        assert (one.size_m, one.is_round) == (other.size_m, other.is_round)
        assert None not in (one.print_seed, other.print_seed) and one.print_seed != other.print_seed
