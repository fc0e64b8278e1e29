"""Copied into the workspace of tests: a camera that turns, whose pictures show when they were taken."""

import time

import numpy as np

from robbie_mp import Header, Module, Time
from robbie_mp.messages import (
    BoundingBox2D,
    Bumper,
    Detection2D,
    Detection2DArray,
    Image,
    JointState,
    LaserScan,
    MapMetaData,
    OccupancyGrid,
    Point2D,
    Pose2D,
    PoseStamped,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_mp.scene import RigidTransform

BITS, EDGE_PX = 16, 16
FRAME, REAR = "camera_optical", "rear_optical"
AHEAD = RigidTransform(0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
SEEN_BEFORE_NS = 300_000_000


class Clockface(Module):
    """Shows the machine's monotonic time in ms as black and white squares, lowest bit first; has a pose.

    It detects something in the picture of 0.3 s before, as a slow detector does.
    """

    period_s = 0.1

    def setup(self) -> None:
        self.pan_rad = 0.0
        self.subscribe(JointState, self.on_joints, topic="pan_tilt", optional=True)

    def on_joints(self, state: JointState) -> None:
        self.pan_rad = dict(zip(state.name, state.position.tolist(), strict=True))["pan"]

    def tick(self) -> None:
        header = Header(stamp=self.now(), frame_id=FRAME)
        now_ms = time.monotonic_ns() // 1_000_000
        bits = np.array([255 * (now_ms >> bit & 1) for bit in range(BITS)], np.uint8)
        pixels = np.kron(bits[None], np.ones((2 * EDGE_PX, EDGE_PX), np.uint8))
        height, width = pixels.shape
        for topic, frame in (("camera", FRAME), ("rear_camera", REAR)):
            taken = Header(stamp=header.stamp, frame_id=frame)
            self.publish(
                Image(
                    header=taken,
                    height=height,
                    width=width,
                    encoding="mono8",
                    step=width,
                    data=pixels.ravel(),
                ),
                topic=topic,
            )
        self.publish_surroundings(Header(stamp=header.stamp, frame_id="base_link"))
        before = Header(
            stamp=Time.from_nanoseconds(header.stamp.nanoseconds - SEEN_BEFORE_NS), frame_id=FRAME
        )
        box = BoundingBox2D(center=Pose2D(position=Point2D(x=99.0, y=9.0)), size_x=20.0, size_y=9.0)
        self.publish(
            Detection2DArray(header=before, detections=[Detection2D(bbox=box, id="it")]), topic="camera"
        )
        self.publish_place(Header(stamp=header.stamp, frame_id="map"))

    def publish_surroundings(self, on_base: Header) -> None:
        """A wall at the left, 1 m from the robot's middle, and a bumper that touches something."""
        ranges = np.full(8, 6.0, np.float32)
        ranges[2] = 1.0
        scan = LaserScan(
            header=on_base, angle_increment=np.pi / 4, range_min=0.1, range_max=8.0, ranges=ranges
        )
        self.publish(scan, topic="around")
        self.publish(Bumper(header=on_base, pressed=["front_left"]), topic="bumper")

    def publish_place(self, in_map: Header) -> None:
        self.publish(PoseStamped(header=in_map), topic="map_pose")
        info = MapMetaData(resolution=0.5, width=8, height=4)
        self.publish(OccupancyGrid(header=in_map, info=info, data=np.zeros(32, np.int8)))
        turned = RigidTransform.from_rpy((0.0, 0.0, 0.3), (0.0, 0.0, self.pan_rad)) @ AHEAD
        on_base = Header(stamp=in_map.stamp, frame_id="base_link")
        back = RigidTransform.from_rpy((0.0, 0.0, 0.3), (0.0, 0.0, np.pi)) @ AHEAD
        places = [(in_map, "base_link", RigidTransform()), (on_base, FRAME, turned), (on_base, REAR, back)]
        self.publish(
            TFMessage(
                transforms=[
                    TransformStamped(
                        header=header,
                        child_frame_id=child,
                        transform=Transform(
                            translation=Vector3(x=pose.x, y=pose.y, z=pose.z),
                            rotation=Quaternion(x=pose.qx, y=pose.qy, z=pose.qz, w=pose.qw),
                        ),
                    )
                    for header, child, pose in places
                ]
            ),
            topic="tf",
        )
