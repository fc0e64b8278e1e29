"""Draws the robot with the arm before its table: `python -m tools.pictures.arm`. It takes some seconds.

On the left the hand is around an object; on the right is what the depth camera sees before that, with the arm
out of its view: the nearer, the brighter.
"""

import argparse
import contextlib
import math
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.depth_camera import SimulatedDepthCamera
from robbie_robots.hw.simulation.solid import Placed, Solid, pose_at
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, on_floor, table_solids
from robbie_robots.workers.manipulation.arm_model import ArmModel
from robbie_robots.workers.manipulation.collisions import Shape, Surroundings
from robbie_robots.workers.manipulation.errors import Unreachable
from robbie_robots.workers.manipulation.grasps import grasps
from robbie_robots.workers.manipulation.hand_work_states import HandSettings
from robbie_robots.workers.manipulation.planning import reach

FILE = Path("docs/images/arm.png")
ROBOT = Path("hw/robots/home.urdf")
JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll")
STANDS = Pose(3.39, 1.8, 0.0)
HEIGHT_PX, WIDTH_PX = 420, 560
EYE, AIM = (3.1, 0.35, 1.25), (3.62, 1.8, 0.45)
SUN = np.array([-0.4, -0.5, 0.77])
FLOOR, TABLE, THING, BODY = (228, 228, 222), (186, 150, 110), (200, 60, 50), (70, 90, 150)
PAPER = (255, 255, 255)

Floats = NDArray[np.float64]


def main() -> int:
    """Write the picture."""
    argparse.ArgumentParser(prog="python -m tools.pictures.arm", description=__doc__).parse_args()
    arena = read_arena(Path("hw/simulation/arenas/arm.yaml"))
    things = [
        Placed(
            Solid(one.size_m, one.is_round),
            pose_at((one.x_m, one.y_m, one.base_m + one.size_m[2] / 2), one.yaw_rad),
        )
        for one in arena.objects
    ]
    tables, shapes = table_solids(arena), RobotShapes(ROBOT)
    shapes.move(dict(zip(JOINTS, HandSettings().aside, strict=True)) | {"gripper": 0.045})
    camera = SimulatedDepthCamera(CameraGeometry(200, 150, 1.0))
    depths = camera.capture(shapes.pose("depth_optical", STANDS), [*tables, *things, *shapes.all(STANDS)])
    near = np.clip(255 - (depths.astype(float) - 500) / 1000 * 255, 0, 255) * (depths > 0)
    depth_picture = Image.fromarray(near.astype(np.uint8)).convert("RGB")
    shapes.move(dict(zip(JOINTS, _grasp(things[0], tables[0]).tolist(), strict=True)) | {"gripper": 0.034})
    colours = [*[TABLE] * len(tables), *[THING] * len(things)]
    robot = shapes.all(STANDS)
    colours += [BODY] * len(robot)
    outside = _shaded([*tables, *things, *robot], colours)
    size = (HEIGHT_PX * 4 // 3, HEIGHT_PX)
    picture = Image.new("RGB", (WIDTH_PX + 10 + size[0], HEIGHT_PX), PAPER)
    picture.paste(Image.fromarray(outside), (0, 0))
    picture.paste(depth_picture.resize(size), (WIDTH_PX + 10, 0))
    picture.quantize(128, dither=Image.Dither.NONE).save(FILE, optimize=True)
    print(f"{FILE}: {picture.width} x {picture.height}, {FILE.stat().st_size / 1024:.0f} KiB")
    return 0


def _grasp(thing: Placed, table: Placed) -> Floats:
    """Return the joints of the best grasp of an object."""
    arm = ArmModel(ROBOT, JOINTS, ("gripper", "right_finger"))
    to_base = np.linalg.inv(on_floor(STANDS))
    shape = Shape("thing", thing.solid.size_m, to_base @ thing.pose, thing.solid.is_round)
    around = [shape, Shape("table", table.solid.size_m, to_base @ table.pose)]
    surroundings = Surroundings(arm, around, margin_m=0.003, touchable=("thing",))
    chance, stow = np.random.default_rng(0), np.array(HandSettings().stow)
    for pose in grasps(shape, 0.4, arm.shoulder, arm.opening_m):
        with contextlib.suppress(Unreachable):
            return reach(arm, surroundings, pose, stow, chance, restarts=6)
    raise Unreachable("no grasp is possible")


def _shaded(solids: list[Placed], colours: list[tuple[int, int, int]]) -> NDArray[np.uint8]:
    """Return a picture of solids on the floor, lit by the sun, by one ray for each pixel."""
    eye = np.array(EYE)
    ahead = np.array(AIM) - eye
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, ahead)
    columns, rows = np.meshgrid(np.arange(WIDTH_PX) - WIDTH_PX / 2, np.arange(HEIGHT_PX) - HEIGHT_PX / 2)
    focal = WIDTH_PX / 2 / math.tan(0.45)
    rays = (columns[..., None] * right - rows[..., None] * up) / focal + ahead
    flat = rays.reshape(-1, 3)
    depths = np.full(len(flat), np.inf)
    np.divide(-eye[2], flat[:, 2], out=depths, where=flat[:, 2] < -1e-9)
    paint = np.tile(np.array(FLOOR, float), (len(flat), 1))
    for solid, colour in zip(solids, colours, strict=True):
        rotation = solid.pose[:3, :3]
        ranges = solid.solid.ranges_m((eye - solid.pose[:3, 3]) @ rotation, flat @ rotation)
        nearer = ranges < depths
        depths[nearer], paint[nearer] = ranges[nearer], colour
    points = (eye + flat * np.where(np.isfinite(depths), depths, 50.0)[:, None]).reshape(*rays.shape)
    # The normal of a pixel is that of the triangle with the pixels beside and below it.
    normals = np.cross(np.roll(points, -1, 0) - points, np.roll(points, -1, 1) - points)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    light = 0.55 + 0.45 * np.clip(np.abs(normals @ SUN), 0.0, 1.0)
    shaded = np.clip(paint.reshape(rays.shape) * light[..., None], 0, 255)
    return np.asarray(shaded, np.uint8)


if __name__ == "__main__":
    sys.exit(main())
