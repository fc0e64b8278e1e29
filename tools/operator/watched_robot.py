"""The modules of a robot whose page shows much at once. They publish as much, and as often, as real ones."""

import math

import numpy as np

from robbie_mp import Header, Module, Time, setting
from robbie_mp.messages import (
    LaserScan,
    MapMetaData,
    OccupancyGrid,
    Point,
    PointCloud2,
    PointField,
    Pose,
    PoseStamped,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from tools.operator.moving_camera import MovingCamera

CELL_M = 0.05
RADIUS_M, SPEED_RAD_PER_S = 8.0, 0.1
RAYS, FARTHEST_M = 720, 12.0
LOG_TICKS = 10
PATCH = 120
"""Cells along each edge of the patch that changes between two maps."""


class Rover(Module):
    """Drives in a circle, and publishes its pose and laser scans."""

    period_s = 0.05

    def setup(self) -> None:
        """Begin."""
        self.ticks = 0

    def tick(self) -> None:
        """Drive on."""
        if self.ticks % LOG_TICKS == 0:
            self.log.info("drives on, %d", self.ticks)
        self.ticks += 1
        now_ns = self.clock.now_ns()
        turned_rad = SPEED_RAD_PER_S * now_ns / 1e9 % (2 * math.pi)
        header = Header(stamp=Time.from_nanoseconds(now_ns), frame_id="map")
        x_m, y_m = RADIUS_M * math.cos(turned_rad), RADIUS_M * math.sin(turned_rad)
        heading = Quaternion.from_yaw(turned_rad + math.pi / 2)
        moved = Transform(translation=Vector3(x=x_m, y=y_m), rotation=heading)
        self.publish(_transforms(header, base_link=moved), topic="tf")
        here = PoseStamped(header=header, pose=Pose(position=Point(x=x_m, y=y_m), orientation=heading))
        self.publish(here, topic="map_pose")
        if self.ticks % 2:
            self._scan(header.stamp)
        if self.ticks == 1:
            on_base = Header(stamp=header.stamp, frame_id="base_link")
            above = Transform(translation=Vector3(x=0.2, z=0.3), rotation=Quaternion(w=1.0))
            parts = _transforms(on_base, laser=above, depth=above)
            self.publish(parts, topic="tf_static", latched=True)

    def _scan(self, stamp: Time) -> None:
        ranges = 4.0 + np.random.default_rng(self.ticks).normal(0.0, 0.02, RAYS)
        self.publish(
            LaserScan(
                header=Header(stamp=stamp, frame_id="laser"),
                angle_min=-math.pi,
                angle_increment=2 * math.pi / RAYS,
                range_min=0.1,
                range_max=FARTHEST_M,
                ranges=ranges.astype(np.float32),
            )
        )


def _transforms(header: Header, **children: Transform) -> TFMessage:
    made = [
        TransformStamped(header=header, child_frame_id=name, transform=transform)
        for name, transform in children.items()
    ]
    return TFMessage(transforms=made)


class MapMaker(Module):
    """Publishes a map of rooms once a second. Each time, a patch of it has changed."""

    cells: int = setting(1000, "along each edge")
    period_s = 1.0

    def setup(self) -> None:
        """Draw it."""
        self.chance = np.random.default_rng(3)
        size = self.cells
        # As in real maps, not all cells are equally certain.
        self.grid = self.chance.choice(np.array([0, 2, 5], np.int8), (size, size), p=[0.9, 0.07, 0.03])
        self.grid[::100] = self.grid[:, ::100] = 100
        self.grid[size // 2 :: 100] = 0
        self.grid[: size // 10] = -1

    def tick(self) -> None:
        """Change a patch."""
        row, column = self.chance.integers(0, max(1, self.cells - PATCH), 2)
        patch = self.grid[row : row + PATCH, column : column + PATCH]
        patch[:] = self.chance.choice(np.array([0, 3, 100], np.int8), patch.shape, p=[0.9, 0.05, 0.05])
        corner = Point(x=-self.cells * CELL_M / 2, y=-self.cells * CELL_M / 2)
        info = MapMetaData(
            resolution=CELL_M,
            width=self.cells,
            height=self.cells,
            origin=Pose(position=corner, orientation=Quaternion(w=1.0)),
        )
        header = Header(stamp=Time.from_nanoseconds(self.clock.now_ns()), frame_id="map")
        self.publish(OccupancyGrid(header=header, info=info, data=self.grid.ravel()), latched=True)


class SecondCamera(MovingCamera):
    """Publishes the pictures of another camera."""

    topic = "second_camera"


class DepthCamera(Module):
    """Publishes clouds of points five times a second."""

    points: int = setting(50_000, "of each cloud")
    period_s = 0.2

    def setup(self) -> None:
        """Make a wavy surface."""
        side = np.sqrt(self.points)
        number = np.arange(self.points)
        self.cloud = np.zeros((self.points, 4), np.float32)  # x, y, z, and another field
        self.cloud[:, 0] = 1.0 + number // side * 6.0 / side
        self.cloud[:, 1] = -3.0 + number % side * 6.0 / side
        self.ticks = 0

    def tick(self) -> None:
        """Move the waves, and publish the cloud."""
        self.ticks += 1
        self.cloud[:, 2] = 0.2 * np.sin(3 * self.cloud[:, 0] + self.ticks / 5)
        fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
        self.publish(
            PointCloud2(
                header=Header(stamp=Time.from_nanoseconds(self.clock.now_ns()), frame_id="depth"),
                height=1,
                width=self.points,
                fields=fields,
                point_step=16,
                row_step=16 * self.points,
                data=self.cloud.reshape(-1).view(np.uint8),
                is_dense=True,
            ),
            topic="depth",
        )
