"""Teaches objects that differ only by what is printed on them, from pictures of the simulated camera."""

import json
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import StandingObject
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.depth_camera import SimulatedDepthCamera
from robbie_robots.hw.simulation.object_prints import ObjectPrint
from robbie_robots.hw.simulation.solid import Floats, Placed, Solid, moved, pose_at
from robbie_robots.hw.simulation.table_picture import Printed, TablePictures
from robbie_robots.hw.simulation.table_room import TWINS
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, on_floor, table_solids
from robbie_robots.workers.manipulation.object_names import Prints
from robbie_robots.workers.objects.object_recognition import ObjectRecognizer
from robbie_robots.workers.taught import Box, Pixels, TeachingError, as_json

ROBOT = Path("hw/robots/home.urdf")
GEOMETRY = CameraGeometry(200, 150, 1.0)
STANDS = Pose(3.38, 1.8, 0.0)
"""Where the robot stands before the table."""
SHOWN_AT = (3.82, 1.8)
"""Where an object stands that is taught."""
MARGIN_PX = (0.0, 8.0)
"""By how much a person's box is larger than the object, at each side."""
PICTURE_WIDTH = 960
"""Columns of a picture, as in the stock profiles."""
WOOD = (150, 110, 70)
JOINTS = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll", "gripper"]
ASIDE = [1.9, 0.3, 0.9, 0.0, -1.2, 0.0, 0.0]


TAUGHT_PICTURES = 4


class Look(NamedTuple):
    """What the camera has measured, and where it was."""

    depths_mm: NDArray[np.uint16]
    picture: Pixels
    X_AC: Floats
    X_AB: Floats


class TwinCamera:
    """The robot's camera for depth and colour, in a room.

    Args:
        arena: the room.
        width: columns of a colour picture.
        seed: of the noise.
        light: brightness.
    """

    def __init__(self, arena: Arena, width: int, seed: int, light: float) -> None:
        self.wide = CameraGeometry(width, width * GEOMETRY.height // GEOMETRY.width, 1.0)
        self._depth = SimulatedDepthCamera(GEOMETRY, seed=seed)
        self._pictures = TablePictures(self.wide, light=light, seed=seed)
        self._tables = table_solids(arena)
        self._robot = RobotShapes(ROBOT)
        self._robot.move(dict(zip(JOINTS, ASIDE, strict=True)))

    def look(self, objects: Sequence[StandingObject], robot: Pose) -> Look:
        """Return what it sees."""
        at = self._robot.pose("depth_optical", robot)
        shapes = self._robot.all(robot)
        behind = self._depth.view(at, [*self._tables, *shapes])
        printed = [
            Printed(placed_of(one), ObjectPrint(placed_of(one).solid, one.print_seed)) for one in objects
        ]
        depths = self._depth.measured(self._depth.view(at, [one.placed for one in printed], behind).depths_m)
        colours = [WOOD] * len(self._tables) + [(60, 62, 66)] * len(shapes)
        return Look(depths, self._pictures.capture(at, behind, colours, printed), at, on_floor(robot))

    def box(self, one: StandingObject, look: Look) -> Box:
        """Return the rectangle around an object in a picture."""
        placed = placed_of(one)
        X_BO = np.linalg.inv(look.X_AB) @ placed.pose
        X_CB = np.linalg.inv(look.X_AC) @ look.X_AB
        prints = Prints((), frozenset(), X_CB, self.wide.focal_length_px, self.wide.centre_px)
        return prints.place(moved(X_BO, placed.solid.surface(0.01)))


def placed_of(one: StandingObject) -> Placed:
    """Return an object as a solid."""
    middle = (one.x_m, one.y_m, one.base_m + one.size_m[2] / 2)
    return Placed(Solid(one.size_m, one.is_round), pose_at(middle, one.yaw_rad))


def teach(
    recognizer: ObjectRecognizer,
    camera: TwinCamera,
    one: StandingObject,
    count: int,
    random: np.random.Generator,
) -> None:
    """Teach an object from pictures from all sides; one that shows too little is refused."""
    begin_rad = float(random.uniform(-math.pi, math.pi))
    for number in range(count):
        x, y = SHOWN_AT
        turned = replace(one, x_m=x, y_m=y, yaw_rad=begin_rad + math.tau * number / count)
        look = camera.look([turned], STANDS)
        box = camera.box(turned, look)
        left, top, right, bottom = random.uniform(*MARGIN_PX, 4)
        drawn = Box(box.left - left, box.top - top, box.width + left + right, box.height + top + bottom)
        with suppress(TeachingError):
            recognizer.teach(one.name, look.picture, drawn)


def twins_settings(seed: int, room: Path, folder: Path) -> list[str]:
    """Teach the objects that differ only by their print; return the settings of the robot that knows them.

    Args:
        seed: of the room.
        room: its file.
        folder: folder for what was taught.
    """
    random = np.random.default_rng(seed)
    arena = read_arena(room)
    twins = TWINS[seed % 2][:2]
    camera, recognizer = TwinCamera(arena, PICTURE_WIDTH, seed, 1.0), ObjectRecognizer()
    for one in arena.objects:
        if one.name in twins:
            teach(recognizer, camera, one, TAUGHT_PICTURES, random)
    file = folder / "objects.json"
    file.write_bytes(as_json("objects", recognizer.plain()))
    words = {"object": [one.name for one in arena.objects], "place": ["table", "counter"]}
    return [
        f"objects.taught_file={file}",
        f"household.words={json.dumps(words)}",
        f'household.start_orders=["put the {random.choice(twins)} on the counter"]',
    ]
