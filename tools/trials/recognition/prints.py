"""Measures whether objects of the same size are told apart by what is printed on them.

    python -m tools.trials prints --seeds 40 [--width 960]

Each seed makes a room with three objects on a table (`hw.simulation.table_room`), two of which differ only by
their print. These two are taught from pictures of the simulated camera, alone on the table, turned a bit
further for each picture, in a box as a person draws it. Then the camera looks once at the table of the room,
from a place and in a light that differ a little, and every object gets its name as on the robot. For
comparison, names by size alone, which are right by chance.
"""

import argparse
import math
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

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
from robbie_robots.hw.simulation.table_room import TWINS, generate_room
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, on_floor, table_solids
from robbie_robots.modules.manipulation.table_objects import read_objects
from robbie_robots.workers.manipulation.object_names import Prints
from robbie_robots.workers.manipulation.table_view import KnownObject, TableFinder, TableView, points_of
from robbie_robots.workers.objects.object_recognition import ObjectRecognizer
from robbie_robots.workers.taught import Box, Pixels, Sighting, TeachingError
from tools.trials.harness import Case, TrialSubject

ROBOT, OBJECTS = Path("hw/robots/home.urdf"), Path("hw/robots/home_objects.yaml")
GEOMETRY = CameraGeometry(200, 150, 1.0)
STANDS = Pose(3.38, 1.8, 0.0)
"""Where the robot stands before the table."""
SHOWN_AT = (3.82, 1.8)
"""Where an object stands that is taught."""
BESIDE_M, TURNED_RAD = 0.05, 0.05
"""Greatest error of the robot's place when it looks."""
LIGHT = (0.7, 1.15)
MARGIN_PX = (0.0, 8.0)
"""By how much a person's box is larger than the object, at each side."""
PICTURE_WIDTH = 960
"""Columns of a picture, as in the stock profiles."""
PICTURES = (1, 4, 8)
"""Numbers of pictures from which each object is taught."""
WOOD = (150, 110, 70)
JOINTS = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_pitch", "wrist_roll", "gripper"]
ASIDE = [1.9, 0.3, 0.9, 0.0, -1.2, 0.0, 0.0]


class Look(NamedTuple):
    """What the camera has measured, and where it was."""

    depths_mm: NDArray[np.uint16]
    picture: Pixels
    X_AC: Floats
    X_AB: Floats


@dataclass
class Count:
    """How many objects of pairs were named.

    Attributes:
        right: with their own name.
        wrong: with the name of something else.
        unnamed: with no name.
        rooms_right: rooms in which both objects of the pair, and the third one, were named right.
    """

    right: int = 0
    wrong: int = 0
    unnamed: int = 0
    rooms_right: int = 0


@dataclass
class Figures:
    """What was measured; `by_pictures` by the number of pictures from which each object was taught."""

    rooms: int = 0
    by_size: Count = field(default_factory=Count)
    by_pictures: dict[int, Count] = field(default_factory=lambda: {count: Count() for count in PICTURES})
    refused_pictures: int = 0
    unseen: int = 0
    worst_place_m: float = 0.0
    worst_heading_rad: float = 0.0


class Camera:
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
        return self.prints(look, (), ()).place(moved(X_BO, placed.solid.surface(0.01)))

    def prints(self, look: Look, found: Sequence[Sighting], taught: Iterable[str]) -> Prints:
        """Return what was recognized in a picture, as the robot has it."""
        X_CB = np.linalg.inv(look.X_AC) @ look.X_AB
        centre_px = self.wide.centre_px
        return Prints(tuple(found), frozenset(taught), X_CB, self.wide.focal_length_px, centre_px)


def placed_of(one: StandingObject) -> Placed:
    """Return an object as a solid."""
    middle = (one.x_m, one.y_m, one.base_m + one.size_m[2] / 2)
    return Placed(Solid(one.size_m, one.is_round), pose_at(middle, one.yaw_rad))


def find(look: Look, known: Sequence[KnownObject], prints: Prints | None) -> TableView | None:
    """Return the named objects of a look, base's frame."""
    X_BC = np.linalg.inv(look.X_AB) @ look.X_AC
    focal_px = GEOMETRY.focal_length_px
    points = moved(X_BC, points_of(look.depths_mm, focal_px, GEOMETRY.centre_px))
    return TableFinder(known).find(points, 0.0, 1 / focal_px, X_BC[:3, 3], prints)


def run_room(figures: Figures, seed: int, width: int) -> None:
    """Teach the pair of a room, and name its objects."""
    random = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "room.yaml"
        file.write_text(generate_room(seed, has_twins=True))
        arena = read_arena(file)
    twins = TWINS[seed % 2][:2]
    shown = {one.name: one for one in arena.objects}
    teacher = Camera(arena, width, seed, 1.0)
    x, y, turn = random.uniform(-1.0, 1.0, 3) * (BESIDE_M, BESIDE_M, TURNED_RAD)
    camera = Camera(arena, width, seed + 1, float(random.uniform(*LIGHT)))
    look = camera.look(arena.objects, STANDS.plus(Pose(x, y, turn)))
    known = read_objects(OBJECTS)
    twin_of = next(one for one in known if one.name == twins[0])
    both = [*known, KnownObject(twins[1], twin_of.size_m, twin_of.is_round)]
    figures.rooms += 1
    judge(figures, figures.by_size, look, arena.objects, twins, find(look, both, None))
    for count in PICTURES:
        recognizer = ObjectRecognizer()
        for name in twins:
            figures.refused_pictures += teach(recognizer, teacher, shown[name], count, random)
        prints = camera.prints(look, recognizer.find(look.picture), recognizer.examples())
        judge(figures, figures.by_pictures[count], look, arena.objects, twins, find(look, known, prints))


def teach(
    recognizer: ObjectRecognizer,
    camera: Camera,
    one: StandingObject,
    count: int,
    random: np.random.Generator,
) -> int:
    """Teach an object from pictures from all sides; return how many were refused."""
    begin_rad = float(random.uniform(-math.pi, math.pi))
    refused = 0
    for number in range(count):
        x, y = SHOWN_AT
        turned = replace(one, x_m=x, y_m=y, yaw_rad=begin_rad + math.tau * number / count)
        look = camera.look([turned], STANDS)
        box = camera.box(turned, look)
        left, top, right, bottom = random.uniform(*MARGIN_PX, 4)
        drawn = Box(box.left - left, box.top - top, box.width + left + right, box.height + top + bottom)
        try:
            recognizer.teach(one.name, look.picture, drawn)
        except TeachingError:
            refused += 1
    return refused


def judge(
    figures: Figures,
    count: Count,
    look: Look,
    objects: Sequence[StandingObject],
    twins: Sequence[str],
    view: TableView | None,
) -> None:
    """Count the names of the pair, by where the objects truly are."""
    names: dict[str, str] = {}
    for one in objects:
        truth = np.linalg.inv(look.X_AB) @ placed_of(one).pose
        seen = [] if view is None else view.objects
        near = [shape for shape in seen if math.dist(shape.pose[:2, 3], truth[:2, 3]) < 0.05]
        if not near:
            figures.unseen += one.name in twins
            continue
        names[one.name] = near[0].name
        if near[0].name == one.name:
            figures.worst_place_m = max(figures.worst_place_m, math.dist(near[0].pose[:2, 3], truth[:2, 3]))
            if not one.is_round:
                turn = math.remainder(yaw_of(near[0].pose) - yaw_of(truth), math.pi)
                figures.worst_heading_rad = max(figures.worst_heading_rad, abs(turn))
    for name in twins:
        given = names.get(name, "unknown")
        count.right += given == name
        count.unnamed += given.startswith("unknown")
        count.wrong += given != name and not given.startswith("unknown")
    count.rooms_right += all(names.get(one.name) == one.name for one in objects)


def yaw_of(pose: Floats) -> float:
    """Return the heading of a pose, rad."""
    return math.atan2(pose[1, 0], pose[0, 0])


def play(case: Case) -> dict[str, Any]:
    """Teach and name the objects of a room; return the figures of all rooms so far."""
    run_room(case.prepared, case.seed, case.options.width)
    return asdict(case.prepared)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of pictures."""
    width = "columns of a picture (960)"
    parser.add_argument("--width", type=int, default=PICTURE_WIDTH, metavar="PIXELS", help=width)


SUBJECT = TrialSubject(
    play=play,
    options=options,
    prepare=lambda _: Figures(),
    summary=lambda so_far: so_far[-1],
    seed_makes="a room",
)
