"""A simulated camera for depth and colour that sees tables, objects and the robot's own arm."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp import REQUIRED, Header, MessageHandling, setting
from robbie_mp.messages import CameraInfo, Image, JointState
from robbie_mp.scene.conversion import from_pose
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.depth_camera import DepthView, SimulatedDepthCamera
from robbie_robots.hw.simulation.object_prints import ObjectPrint
from robbie_robots.hw.simulation.solid import Floats, Placed, Solid, pose_at
from robbie_robots.hw.simulation.table_picture import Printed, TablePictures
from robbie_robots.modules.devices.camera import intrinsic_matrix
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice
from robbie_robots.modules.manipulation.messages import TabletopTruth
from robbie_robots.modules.manipulation.robot_shapes import RobotShapes, table_solids

FRAME = "depth_optical"
PICTURES = "table_camera"
WALL_M = 0.02
WOOD, WALL, ROBOT = (150, 110, 70), (190, 190, 180), (60, 62, 66)


class SimulatedDepthCameraModule(SimulatedDevice):
    """A depth camera on the robot; publishes `Image` (16UC1, mm; 0: nothing) and `CameraInfo` on `depth`.

    With `picture_width`, it also takes colour pictures (rgb8) from the same place at the same times, and
    publishes them with their `CameraInfo` on `table_camera`.
    """

    robot: Path = setting(REQUIRED, "the robot's URDF, with the frame depth_optical", must_exist=True)
    width: int = setting(200, "columns of an image", minimum=16, maximum=640)
    height: int = setting(150, "rows of an image", minimum=16, maximum=480)
    field_of_view_rad: float = setting(1.0, "horizontal field of view", minimum=0.1, maximum=2.0)
    noise_m: float = setting(
        0.002, "standard deviation of a depth of 1 m; it grows with its square", minimum=0.0
    )
    picture_width: int = setting(
        0, "columns of a colour picture; 0: the camera takes none", minimum=0, maximum=1920
    )
    light: float = setting(1.0, "brightness of the colour pictures", minimum=0.1, maximum=2.0)
    seed: int = setting(0, "random seed of the noise")
    period_s: float = setting(1.0, "time between images", minimum=0.05)

    def setup(self) -> None:
        """Create the camera; it takes no image until the base and the arm have said where they are."""
        geometry = CameraGeometry(self.width, self.height, self.field_of_view_rad)
        self.world = SharedWorld(self)
        self.shapes = RobotShapes(self.robot)
        self.camera = SimulatedDepthCamera(geometry, self.noise_m, seed=self.seed)
        arena = self.world.arena
        tables, walls = table_solids(arena), _walls(arena)
        self.walls = [*tables, *walls]
        self.colours = [WOOD] * len(tables) + [WALL] * len(walls)
        self.sizes = {one.name: Solid(one.size_m, one.is_round) for one in arena.objects}
        self.pictures: TablePictures | None = None
        if self.picture_width:
            rows = self.picture_width * self.height // self.width
            wide = CameraGeometry(self.picture_width, rows, self.field_of_view_rad)
            self.pictures = TablePictures(wide, light=self.light, seed=self.seed)
            self.prints = {
                one.name: ObjectPrint(self.sizes[one.name], one.print_seed) for one in arena.objects
            }
        self.truth: TabletopTruth | None = None
        self.images = 0
        newest = MessageHandling.KEEP_ONLY_NEWEST
        self.subscribe(TabletopTruth, self.on_truth, newest, topic="ground_truth")
        self.subscribe(JointState, self.on_joints, newest)

    def on_truth(self, truth: TabletopTruth) -> None:
        """Take where the objects are."""
        self.truth = truth

    def on_joints(self, state: JointState) -> None:
        """Take where the arm is."""
        self.shapes.move(dict(zip(state.name, state.position.tolist(), strict=False)))

    def tick(self) -> None:
        """Publish an image."""
        if self.world.truth is None or self.truth is None:
            self.status = "waiting for the simulated base and arm"
            return
        robot = self.world.truth.pose
        objects = {
            name: Placed(self.sizes[name], from_pose(pose).matrix)
            for name, pose in zip(self.truth.names, self.truth.poses, strict=True)
            if name not in self.truth.taken
        }
        at = self.shapes.pose(FRAME, robot)
        behind = self.camera.view(at, [*self.walls, *self.shapes.all(robot)])
        depths = self.camera.measured(self.camera.view(at, objects.values(), behind).depths_m)
        self._publish("depth", self.camera.geometry, "16UC1", depths)
        if self.pictures is not None:
            self._take_picture(self.pictures, at, behind, objects)
        self.images += 1
        self.status = f"{self.images} images"

    def _take_picture(
        self, pictures: TablePictures, at: Floats, behind: DepthView, objects: dict[str, Placed]
    ) -> None:
        """Publish a colour picture."""
        printed = [Printed(placed, self.prints[name]) for name, placed in objects.items()]
        # What is no table and no wall belongs to the robot.
        colours = [*self.colours, *[ROBOT] * (int(behind.shapes.max()) + 1 - len(self.colours))]
        self._publish(PICTURES, pictures.geometry, "rgb8", pictures.capture(at, behind, colours, printed))

    def _publish(self, topic: str, geometry: CameraGeometry, encoding: str, pixels: NDArray[Any]) -> None:
        """Publish an image, with the camera's projection."""
        header = Header(stamp=self.world.stamp, frame_id=FRAME)
        k = intrinsic_matrix(geometry)
        info = CameraInfo(
            header=header,
            height=geometry.height,
            width=geometry.width,
            distortion_model="plumb_bob",
            k=k.ravel(),
            r=np.eye(3).ravel(),
            p=np.hstack([k, np.zeros((3, 1))]).ravel(),
        )
        self.publish(info, topic=topic, latched=True)
        self.publish(
            Image(
                header=header,
                height=geometry.height,
                width=geometry.width,
                encoding=encoding,
                step=pixels.strides[0],
                data=np.ascontiguousarray(pixels).view(np.uint8).ravel(),
            ),
            topic=topic,
        )


def _walls(arena: Arena) -> list[Placed]:
    """Return the walls of an arena without the sides of its tables, which are lower."""
    corners = np.array([table.corners_m for table in arena.tables]).reshape(-1, 4)
    sides = {tuple(side) for side in box_segments(corners).tolist()}
    placed = []
    for x1, y1, x2, y2 in arena.segments.tolist():
        if (x1, y1, x2, y2) in sides:
            continue
        length, yaw = float(np.hypot(x2 - x1, y2 - y1)), float(np.arctan2(y2 - y1, x2 - x1))
        middle = ((x1 + x2) / 2, (y1 + y2) / 2, arena.wall_height_m / 2)
        placed.append(Placed(Solid((length, WALL_M, arena.wall_height_m)), pose_at(middle, yaw)))
    return placed
