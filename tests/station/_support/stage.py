"""Copied into the workspace of tests: a robot of which everything is known."""

import numpy as np

from robbie_mp import Header, Module, SettingError, setting
from robbie_mp.messages import (
    LaserScan,
    MapMetaData,
    OccupancyGrid,
    Odometry,
    Path,
    PointCloud2,
    PointField,
    PointOfInterest,
    PointsOfInterest,
    Pose,
    PoseStamped,
    PoseWithCovariance,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
)
from robbie_mp.messages import Point as Place

UPRIGHT = Quaternion(w=1.0)


class Stage(Module):
    """Stands at a place, sees two walls, and means to drive ahead."""

    x_m: float = setting(1.5, "where it stands", minimum=-5.0, maximum=5.0, changeable=True)
    color: str = setting("red", "of its light", choices=["red", "green"], changeable=True)
    fixed: int = setting(7, "what cannot be changed")
    virtual_charge: float = setting(0.75, "of its battery", minimum=0.0, maximum=1.0, changeable=True)
    virtual_pressed: list[str] = setting([], "of its bumper", choices=["left", "right"], changeable=True)
    virtual_level: int = setting(3, "of its water", minimum=0, maximum=10, changeable=True)
    virtual_fails: bool = setting(False, "its laser", changeable=True)
    period_s = 0.1

    def setting_changed(self, name: str) -> None:
        if name == "x_m" and self.x_m == 3.0:
            raise SettingError("there is a hole at 3 m", "x_m")

    def tick(self) -> None:
        stamp = self.now()
        in_map = Header(stamp=stamp, frame_id="map")
        self.publish(
            TFMessage(
                transforms=[
                    TransformStamped(
                        header=in_map,
                        child_frame_id="base_link",
                        transform=Transform(translation=Vector3(x=self.x_m, y=-0.5), rotation=UPRIGHT),
                    )
                ]
            ),
            topic="tf",
        )
        other = Transform(translation=Vector3(x=3.0, y=1.25), rotation=Quaternion.from_yaw(1.0))
        red = TransformStamped(header=in_map, child_frame_id="red/base_link", transform=other)
        self.publish(TFMessage(transforms=[red]), topic="tf")
        laser = TransformStamped(
            header=Header(stamp=stamp, frame_id="base_link"),
            child_frame_id="laser",
            transform=Transform(translation=Vector3(x=0.2, z=0.1), rotation=UPRIGHT),
        )
        self.publish(TFMessage(transforms=[laser]), topic="tf_static")
        self.publish(
            LaserScan(
                header=Header(stamp=stamp, frame_id="laser"),
                angle_min=0.0,
                angle_increment=0.5,
                range_min=0.1,
                range_max=10.0,
                ranges=np.array([2.0, 0.05, np.inf, 3.0], np.float32),
            ),
        )
        xyz = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
        cloud = np.full((5, 3), 0.5, np.float32)
        self.publish(
            PointCloud2(
                header=in_map, height=1, width=5, fields=xyz, point_step=12, row_step=60,
                data=cloud.view(np.uint8).ravel(),
            ),
            topic="depth",
        )  # fmt: skip
        info = MapMetaData(resolution=0.5, width=8, height=4, origin=Pose(position=Place(x=-2.0, y=-1.0)))
        self.publish(OccupancyGrid(header=in_map, info=info, data=np.zeros(32, np.int8)))
        way = [PoseStamped(pose=Pose(position=Place(x=self.x_m + ahead))) for ahead in range(3)]
        self.publish(Path(header=in_map, poses=way), topic="path")
        door = PointOfInterest(name="door", pose=Pose(position=Place(x=-1.0, y=0.5)))
        self.publish(PointsOfInterest(header=in_map, points=[door]))
        pose = PoseWithCovariance(pose=Pose(position=Place(x=self.x_m, y=-0.5)))
        self.publish(Odometry(header=in_map, pose=pose), topic="odom")
        by_hand = f"{self.virtual_charge} {'+'.join(self.virtual_pressed)} {self.virtual_fails}"
        self.status = f"stands at {self.x_m} m; {self.color}; {by_hand} {self.virtual_level}"
