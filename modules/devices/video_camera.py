"""The robot's real cameras: on V4L2 (USB), on the network, or video files in their place."""

from pathlib import Path

import numpy as np

from robbie_mp import REQUIRED, Header, SettingError, Time, setting
from robbie_mp.messages import CameraInfo, CompressedImage, Image
from robbie_robots.hw.camera import CameraFrame
from robbie_robots.hw.video.calibration import Calibration, CalibrationError, ideal, read_calibration, unknown
from robbie_robots.hw.video.jpeg import JpegCamera, JpegFrame
from robbie_robots.hw.video.lepton import LeptonCamera
from robbie_robots.hw.video.opencv import OpenCvCamera
from robbie_robots.hw.video.source import VideoFormat, VideoSource
from robbie_robots.modules.devices.pluggable import ReconnectingDeviceModule, T


class VideoCameraModule(ReconnectingDeviceModule[T]):
    """A camera that may be pulled out and plugged in. A subclass opens its driver.

    Publishes `CameraInfo` with each image, latched, and `DeviceState` on a topic named after the module.
    """

    source: str = setting(
        REQUIRED, "a path such as /dev/v4l/by-id/…-index0, an address such as rtsp://…, or a video file"
    )
    topic: str = setting("camera", "topic of the images; their frame is this with _optical behind it")
    width: int = setting(640, "columns of an image", minimum=16, maximum=8192)
    height: int = setting(480, "rows of an image", minimum=16, maximum=8192)
    rate_hz: float = setting(30.0, "images each second", minimum=0.1, maximum=240.0)
    calibration: Path | None = setting(
        None, "file of the camera's calibration, as ROS's camera_calibration writes it", must_exist=True
    )
    field_of_view_rad: float = setting(
        0.0, "without a calibration: horizontal field of view; 0: unknown", minimum=0.0, maximum=3.0
    )
    silence_s: float = setting(
        2.0, "the camera counts as disconnected when it sends no image for this time", minimum=0.1
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Read the calibration, so that a mistake in it is reported before anything starts."""
        file = settings["calibration"]
        if isinstance(file, Path):
            try:
                read_calibration(file)
            except CalibrationError as error:
                raise SettingError(str(error), "calibration") from error

    def setup(self) -> None:
        """Create the driver."""
        super().setup()
        self.calibrated = None if self.calibration is None else read_calibration(self.calibration)
        self.projection = unknown(0, 0)

    @property
    def place(self) -> str:
        """Return the camera's source."""
        return self.source

    @property
    def wanted(self) -> VideoFormat:
        """Return what the camera is asked for."""
        return VideoFormat(self.width, self.height, self.rate_hz)

    @property
    def camera(self) -> VideoSource[T]:
        """Return the driver."""
        assert isinstance(self.device, VideoSource)
        return self.device

    def header_at(self, stamp_s: float) -> Header:
        """Return the header of an image and of its `CameraInfo`."""
        stamp = Time.from_nanoseconds(round(stamp_s * 1e9))
        return Header(stamp=stamp, frame_id=f"{self.topic}_optical")

    def publish_info(self, header: Header, width: int, height: int) -> None:
        """Publish how the camera projects, if that is known for images of this size."""
        projection = self.projection
        if (projection.width, projection.height) != (width, height):
            projection = self.projection = self._projection_of(width, height)
        self.publish(
            CameraInfo(
                header=header,
                height=height,
                width=width,
                distortion_model=projection.model,
                d=projection.distortion,
                k=projection.matrix.ravel(),
                r=projection.rectification.ravel(),
                p=projection.projection.ravel(),
            ),
            topic=self.topic,
            latched=True,
        )

    def _projection_of(self, width: int, height: int) -> Calibration:
        if self.calibrated is None:
            is_known = self.field_of_view_rad > 0.0
            return ideal(width, height, self.field_of_view_rad) if is_known else unknown(width, height)
        if (self.calibrated.width, self.calibrated.height) == (width, height):
            return self.calibrated
        self.log.error(
            "the calibration is for images of %d x %d, and these have %d x %d: it is ignored",
            self.calibrated.width,
            self.calibrated.height,
            width,
            height,
        )
        return unknown(width, height)

    def status_line(self) -> str:
        """Return the line that `robbie top` shows."""
        if not self.device.is_connected:
            return super().status_line()
        counters = self.device.counters
        return (
            f"{counters.values} images, {self.camera.dropped} dropped, {self.camera.missed} missing, "
            f"{counters.damaged} damaged, lost {counters.losses} times"
        )


class OpenCvCameraModule(VideoCameraModule[CameraFrame]):
    """A camera whose images are decoded; publishes `Image` (rgb8) on topic `camera`."""

    pixel_format: str = setting("", 'four letters that the camera is asked for, such as "MJPG"; "": any')

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Raise SettingError if the format or the calibration is impossible."""
        super().check(settings)
        if len(str(settings["pixel_format"])) not in (0, 4):
            raise SettingError("expected four letters, such as MJPG or YUYV", "pixel_format")

    def open_device(self) -> OpenCvCamera:
        """Return the driver."""
        return OpenCvCamera(
            self.source,
            self.wanted,
            pixel_format=self.pixel_format,
            clock=self.time_s,
            silence_s=self.silence_s,
        )

    def on_value(self, value: CameraFrame) -> None:
        """Publish an image."""
        height, width = value.pixels.shape[:2]
        header = self.header_at(value.stamp_s)
        self.publish_info(header, width, height)
        self.publish(
            Image(
                header=header,
                height=height,
                width=width,
                encoding="rgb8",
                step=3 * width,
                data=value.pixels.view(np.uint8).ravel(),
            ),
            topic=self.topic,
        )


class JpegCameraModule(VideoCameraModule[JpegFrame]):
    """A camera that compresses its images itself; publishes `CompressedImage` (jpeg) on topic `camera`.

    No image is decoded on the robot.
    """

    def open_device(self) -> JpegCamera:
        """Return the driver."""
        return JpegCamera(self.source, self.wanted, clock=self.time_s, silence_s=self.silence_s)

    def on_value(self, value: JpegFrame) -> None:
        """Publish an image."""
        header = self.header_at(value.stamp_s)
        self.publish_info(header, value.width, value.height)
        self.publish(CompressedImage(header=header, format="jpeg", data=value.data), topic=self.topic)


class LeptonCameraModule(VideoCameraModule[CameraFrame]):
    """A FLIR Lepton 3.5 on a PureThermal board.

    Publishes `Image` (mono16, hundredths of a kelvin) on topic `thermal`, as a simulated thermal camera does.
    """

    topic: str = setting("thermal", "topic of the images; their frame is this with _optical behind it")

    def open_device(self) -> LeptonCamera:
        """Return the driver, which knows the size and rate of its images."""
        return LeptonCamera(self.source, clock=self.time_s, silence_s=self.silence_s)

    def on_value(self, value: CameraFrame) -> None:
        """Publish an image."""
        height, width = value.pixels.shape
        header = self.header_at(value.stamp_s)
        self.publish_info(header, width, height)
        data = value.pixels.astype("<u2").view(np.uint8).ravel()
        self.publish(
            Image(header=header, height=height, width=width, encoding="mono16", step=2 * width, data=data),
            topic=self.topic,
        )
