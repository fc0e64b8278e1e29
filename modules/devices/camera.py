"""The robot's cameras."""

import math
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from robbie_mp import Header, SettingError, setting
from robbie_mp.messages import CameraInfo, Image, JointState
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.simulation.arena_file import read_arena
from robbie_robots.hw.simulation.camera import SimulatedCamera, SimulatedThermalCamera
from robbie_robots.hw.simulation.people import FacesError, read_heads
from robbie_robots.modules.devices.pan_tilt_history import PanTiltHistory
from robbie_robots.modules.devices.simulated_world import SharedWorld, SimulatedDevice


class SimulatedCameraModule(SimulatedDevice):
    """A simulated camera on the pan-tilt unit; publishes `Image` and `CameraInfo` on topic `camera`.

    `CameraInfo` is latched. Without a pan-tilt unit, the camera looks straight ahead.
    """

    width: int = setting(320, "columns of an image", minimum=16, maximum=1280)
    height: int = setting(240, "rows of an image", minimum=16, maximum=1024)
    field_of_view_rad: float = setting(1.047, "horizontal field of view", minimum=0.1, maximum=2.0)
    noise: float = setting(2.0, "standard deviation of pixel values", minimum=0.0)
    seed: int = setting(0, "random seed of the noise")
    period_s: float = setting(0.1, "time between images", minimum=0.01)

    camera_class: ClassVar[type[SimulatedCamera]] = SimulatedCamera
    topic: ClassVar[str] = "camera"
    mount_m: ClassVar[tuple[float, float, float]] = CameraGeometry().mount_m
    encoding: ClassVar[str] = "rgb8"

    def setup(self) -> None:
        """Create the camera; it takes no image until the simulated base has published its pose."""
        geometry = CameraGeometry(self.width, self.height, self.field_of_view_rad, self.mount_m)
        self.world = SharedWorld(self)
        self.camera = self.camera_class(self.world.arena, geometry, self.noise, self.seed)
        self.intrinsics = intrinsic_matrix(geometry)
        self.images = 0
        self.prepare_direction()

    def prepare_direction(self) -> None:
        """Learn how the pan-tilt unit turns."""
        self.directions = PanTiltHistory()
        self.subscribe(JointState, self.directions.add, topic="pan_tilt")

    def direction_at(self, stamp_s: float) -> tuple[float, float]:
        """Return pan and tilt of the camera at a time, rad."""
        return self.directions.at(stamp_s)

    def tick(self) -> None:
        """Publish an image."""
        truth = self.world.truth
        if truth is None:
            self.status = "waiting for the simulated base"
            return
        self.camera.arena, self.camera.people = self.world.arena, self.world.people
        self.camera.place(truth.pose, truth.stamp_s)
        self.camera.look(*self.direction_at(truth.stamp_s))
        pixels = self.camera.capture().pixels
        header = Header(stamp=self.world.stamp, frame_id=f"{self.topic}_optical")
        k = self.intrinsics
        self.publish(
            CameraInfo(
                header=header,
                height=self.height,
                width=self.width,
                distortion_model="plumb_bob",
                k=k.ravel(),
                r=np.eye(3).ravel(),
                p=np.hstack([k, np.zeros((3, 1))]).ravel(),
            ),
            topic=self.topic,
            latched=True,
        )
        self.publish(
            Image(
                header=header,
                height=self.height,
                width=self.width,
                encoding=self.encoding,
                step=pixels.strides[0],
                data=pixels.view(np.uint8).ravel(),
            ),
            topic=self.topic,
        )
        self.images += 1
        self.status = f"{self.images} images"


class SimulatedRearCameraModule(SimulatedCameraModule):
    """A simulated camera that looks behind the robot; publishes `Image` on topic `rear_camera`."""

    topic = "rear_camera"
    mount_m = (-0.2, 0.0, 0.3)
    tilt_rad: ClassVar[float] = 0.2
    """Angle below the horizon, so that the floor behind the robot is in sight."""

    def prepare_direction(self) -> None:
        """Do nothing: the camera does not turn."""

    def direction_at(self, stamp_s: float) -> tuple[float, float]:
        """Return pan and tilt, rad."""
        return math.pi, self.tilt_rad


class SimulatedHeadCameraModule(SimulatedCameraModule):
    """A simulated camera on a pan-tilt unit at the height of a table and more; for `hw/robots/home.yaml`.

    With a folder of pictures, people have these heads: `NAME.jpg`, or `NAME_1.jpg`, `NAME_2.jpg` in turns.
    """

    faces: Path | None = setting(None, "folder with pictures of people's heads; null: nobody has a face")

    mount_m = (0.05, 0.0, 1.1)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read arena and pictures, so that a mistake in them is reported before anything starts."""
        super().check(settings)
        folder, arena = settings["faces"], settings["arena"]
        if isinstance(folder, Path):
            assert isinstance(arena, Path)
            try:
                read_heads(folder, [person.name for person in read_arena(arena).people])
            except FacesError as error:
                raise SettingError(str(error), "faces") from error

    def setup(self) -> None:
        """Create the camera, and give people their heads."""
        super().setup()
        if self.faces is not None:
            names = [person.name for person in self.world.arena.people]
            self.camera.heads = read_heads(self.faces, names)


class SimulatedThermalCameraModule(SimulatedCameraModule):
    """A simulated thermal camera; publishes `Image` (mono16, hundredths of a kelvin) on topic `thermal`."""

    width: int = setting(160, "columns of an image", minimum=16, maximum=1280)
    height: int = setting(120, "rows of an image", minimum=16, maximum=1024)
    noise: float = setting(5.0, "standard deviation of pixel values, hundredths of a kelvin", minimum=0.0)

    camera_class = SimulatedThermalCamera
    topic = "thermal"
    encoding = "mono16"


def intrinsic_matrix(geometry: CameraGeometry) -> NDArray[np.float64]:
    """Return a camera's intrinsic matrix: (3, 3), pixels."""
    focal, (x, y) = geometry.focal_length_px, geometry.centre_px
    return np.array([[focal, 0.0, x], [0.0, focal, y], [0.0, 0.0, 1.0]])
