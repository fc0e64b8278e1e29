"""Cameras through OpenCV and PyAV, on video files and on a fake of V4L2."""

import errno
import fcntl
import re
import struct
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.hw.framing import DamagedFrame
from robbie_robots.hw.video import source
from robbie_robots.hw.video.huffman import with_huffman_tables
from robbie_robots.hw.video.jpeg_check import whole_jpeg
from robbie_robots.hw.video.opencv import OpenCvCamera
from robbie_robots.hw.video.source import CameraLibraryMissing, VideoFormat, VideoSource

LIMIT_S = 20.0
WIDTH, HEIGHT, IMAGES, RATE_HZ = 64, 48, 5, 100.0
GREYS = [40 * number for number in range(1, IMAGES + 1)]


def video(file: Path, letters: str = "MJPG") -> Path:
    """Write a video whose images are grey, each brighter than the one before."""
    coding = cv2.VideoWriter.fourcc(*letters)
    writer = cv2.VideoWriter(str(file), coding, RATE_HZ, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for grey in GREYS:
        writer.write(np.full((HEIGHT, WIDTH, 3), grey, np.uint8))
    writer.release()
    return file


def jpeg_camera(path: Path) -> VideoSource[Any]:
    pytest.importorskip("av", reason="NOT TESTED: PyAV is not installed")
    from robbie_robots.hw.video.jpeg import JpegCamera  # noqa: PLC0415

    return JpegCamera(str(path))


def opencv_camera(path: Path) -> VideoSource[Any]:
    return OpenCvCamera(str(path))


KINDS = [jpeg_camera, opencv_camera]


def grey(frame: Any) -> int:
    """Return how bright an image is, after decoding it if it is JPEG."""
    pixels = frame.pixels if hasattr(frame, "pixels") else cv2.imdecode(frame.data, cv2.IMREAD_COLOR)
    assert pixels is not None and pixels.shape == (HEIGHT, WIDTH, 3)
    return round(float(pixels.mean()))


def taken(camera: VideoSource[Any], count: int) -> list[Any]:
    give_up_s = time.monotonic() + LIMIT_S
    frames: list[Any] = []
    while len(frames) < count:
        assert time.monotonic() < give_up_s, camera.reason
        frames += camera.poll(0.1)
    return frames


def until(camera: VideoSource[Any], condition: Callable[[], bool]) -> None:
    give_up_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < give_up_s, camera.reason
        camera.poll(0.01)


@pytest.mark.parametrize("kind", KINDS)
def test_images_of_a_file_come_at_its_rate_again_and_again(
    kind: Callable[[Path], VideoSource[Any]], tmp_path: Path
) -> None:
    began_s = time.time()
    with closing(kind(video(tmp_path / "video.avi"))) as camera:
        frames = taken(camera, 2 * IMAGES)
        assert camera.counters.losses == 0
    told = [grey(frame) for frame in frames[: 2 * IMAGES]]
    if not camera.dropped:
        assert told == pytest.approx(GREYS * 2, abs=3)
    stamps = [frame.stamp_s for frame in frames]
    assert stamps == sorted(stamps) and began_s <= stamps[0] <= time.time()
    assert stamps[-1] - stamps[0] > (len(frames) - 2) / RATE_HZ


@pytest.mark.parametrize("kind", KINDS)
def test_camera_is_found_again_by_its_name(kind: Callable[[Path], VideoSource[Any]], tmp_path: Path) -> None:
    name = tmp_path / "camera"
    with closing(kind(name)) as camera:
        until(camera, lambda: "there is no camera" in camera.reason)
        name.symlink_to(video(tmp_path / "video.avi"))
        taken(camera, 1)
        assert camera.is_connected and camera.reason == ""
        name.unlink()
        until(camera, lambda: not camera.is_connected)
        assert camera.reason == f"there is no camera at {name}: is it plugged in?"
        assert camera.poll() == []
        name.symlink_to(tmp_path / "video.avi")
        taken(camera, 1)
        assert (camera.counters.connections, camera.counters.losses) == (2, 1)


@pytest.mark.parametrize("kind", KINDS)
def test_file_that_is_no_video_is_told(kind: Callable[[Path], VideoSource[Any]], tmp_path: Path) -> None:
    (tmp_path / "text").write_text("no video")
    with closing(kind(tmp_path / "text")) as camera:
        until(camera, lambda: "cannot open" in camera.reason)


def test_video_without_jpeg_is_refused_by_the_driver_that_does_not_decode(tmp_path: Path) -> None:
    with closing(jpeg_camera(video(tmp_path / "video.mp4", "mp4v"))) as camera:
        until(camera, lambda: camera.reason.endswith("gives mpeg4, not JPEG: read it through OpenCV"))


def test_device_that_is_no_camera_is_told() -> None:
    with closing(OpenCvCamera("/dev/null")) as camera:
        until(camera, lambda: camera.reason.startswith("/dev/null is no camera"))


class FakeV4l2:
    """Answers the questions that the driver asks a V4L2 device, and gives its images."""

    def __init__(self) -> None:
        self.capabilities, self.error = source.VIDEO_CAPTURE, 0
        self.properties: dict[int, float] = {}
        self.fixed: dict[int, float] = {}
        self.stamps_s: list[float] = []
        self.releases, self.is_pulled_out = 0, False

    def ioctl(self, _descriptor: int, request: int, data: bytes) -> bytes:
        if request == source.VIDIOC_QUERYCAP:
            return struct.pack("=88xI12x", self.capabilities)
        if request == source.VIDIOC_S_FMT and self.error:
            raise OSError(self.error, "fake")
        return data

    def capture(self, name: str, library: int) -> "FakeV4l2":
        assert (name, library) == ("/dev/null", cv2.CAP_V4L2)
        return self

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        self.properties[key] = value
        return True

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_POS_MSEC:
            return self.taken_s * 1000
        return self.fixed.get(key, self.properties.get(key, 0.0))

    def read(self) -> tuple[bool, Any]:
        while not self.stamps_s and not self.is_pulled_out:
            time.sleep(0.001)
        if self.is_pulled_out:
            return False, None
        self.taken_s = self.stamps_s.pop(0)
        return True, np.zeros((HEIGHT, WIDTH, 3), np.uint8)

    def release(self) -> None:
        self.releases += 1


@pytest.fixture
def v4l2(monkeypatch: pytest.MonkeyPatch) -> FakeV4l2:
    fake = FakeV4l2()
    monkeypatch.setattr(fcntl, "ioctl", fake.ioctl)
    return fake


def on_v4l2(fake: FakeV4l2, pixel_format: str = "") -> OpenCvCamera:
    wanted = VideoFormat(WIDTH, HEIGHT, 10.0)
    return OpenCvCamera("/dev/null", wanted, pixel_format=pixel_format, capture=fake.capture)


@pytest.mark.parametrize(
    ("capabilities", "error", "fixed", "reason"),
    [
        (0, 0, {}, "gives no images: a camera's images come from its node with index 0"),
        (1, errno.EBUSY, {}, "is in use by another program"),
        (1, errno.EIO, {}, "does not tell its format: fake"),
        (1, 0, {cv2.CAP_PROP_FOURCC: 1.0}, "has no format MJPG"),
        (1, 0, {cv2.CAP_PROP_FRAME_WIDTH: 32.0}, "gives 32 x 48, not 64 x 48"),
    ],
)
def test_camera_that_cannot_be_used_says_why(
    v4l2: FakeV4l2, capabilities: int, error: int, fixed: dict[int, float], reason: str
) -> None:
    v4l2.capabilities, v4l2.error, v4l2.fixed = capabilities, error, fixed
    with closing(on_v4l2(v4l2, "MJPG")) as camera:
        until(camera, lambda: reason in camera.reason)
        assert not camera.is_connected


def test_images_have_the_drivers_stamps_and_missing_ones_are_counted(v4l2: FakeV4l2) -> None:
    began_s = time.monotonic() - 2.0
    v4l2.stamps_s = [began_s, began_s + 0.1, began_s + 0.41, began_s + 0.5]
    with closing(on_v4l2(v4l2)) as camera:
        frames = taken(camera, 4)
        shown_s = time.time() - (time.monotonic() - began_s)
        v4l2.is_pulled_out = True
        until(camera, lambda: camera.reason == "/dev/null gives no more images")
        assert camera.missed == 2 and v4l2.releases >= 1
    assert frames[0].stamp_s == pytest.approx(shown_s, abs=0.01)
    assert frames[2].stamp_s - frames[1].stamp_s == pytest.approx(0.31, abs=0.01)


def test_library_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cv2", None)
    with pytest.raises(CameraLibraryMissing, match="pip install opencv-python-headless"):
        OpenCvCamera("/dev/null")


def test_image_without_huffman_tables_gets_the_usual_ones() -> None:
    image = cv2.imencode(".jpg", np.random.default_rng(1).integers(0, 255, (16, 16, 3), np.uint8))[
        1
    ].tobytes()
    without, position = image[:2], 2
    while image[position + 1] != 0xDA:
        length = 2 + int.from_bytes(image[position + 2 : position + 4], "big")
        if image[position + 1] != 0xC4:
            without += image[position : position + length]
        position += length
    without += image[position:]
    assert with_huffman_tables(image) == image
    repaired = np.frombuffer(with_huffman_tables(without), np.uint8)
    expected = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(cv2.imdecode(repaired, cv2.IMREAD_COLOR), expected)
    for strange in (b"", b"\xff\xd8", b"\xff\xd8\xff\xe0\x00", b"no JPEG", image[:100]):
        assert with_huffman_tables(strange) == strange


def picture(width: int = 64, height: int = 48, restarts: int = 0, *, is_progressive: bool = False) -> bytes:
    pixels = np.random.default_rng(1).integers(0, 255, (height, width, 3), np.uint8)
    options = [cv2.IMWRITE_JPEG_RST_INTERVAL, restarts, cv2.IMWRITE_JPEG_PROGRESSIVE, int(is_progressive)]
    return bytes(cv2.imencode(".jpg", pixels, options)[1].tobytes())


@pytest.mark.parametrize("behind", [b"", b"\0", b"\0" * 1000, b"next"])
@pytest.mark.parametrize(("restarts", "is_progressive"), [(0, False), (1, False), (0, True)])
def test_whole_image_passes_without_what_follows_it(
    behind: bytes, restarts: int, is_progressive: bool
) -> None:
    image = picture(restarts=restarts, is_progressive=is_progressive)
    assert whole_jpeg(image + behind, 64, 48) == image


def test_image_of_one_colour_is_long_enough() -> None:
    image = cv2.imencode(".jpg", np.full((480, 640, 3), 128, np.uint8))[1].tobytes()
    assert whole_jpeg(image, 640, 480) == image


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_image_that_is_cut_anywhere_is_damaged(share: float) -> None:
    image = picture()
    with pytest.raises(DamagedFrame):
        whole_jpeg(image[: int(share * len(image))], 64, 48)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (picture(32, 48), "of 32 x 48, not 64 x 48"),
        (picture()[2:], "does not begin with SOI"),
        (picture()[:-2], "without an end"),
        (picture()[: picture().index(b"\xff\xda") + 24] + b"\xff\xd9", "10 bytes code no image"),
        (picture()[:2000] + picture(), "no marker|segment|frame"),
        (b"\xff\xd8\xff\xd9", "without a frame or a scan"),
        (picture(restarts=1).replace(b"\xff\xd1", b"", 1), "a part is missing"),
    ],
)
def test_image_with_missing_parts_is_damaged(image: bytes, said: str) -> None:
    with pytest.raises(DamagedFrame, match=said):
        whole_jpeg(image, 64, 48)


def test_damaged_images_are_counted_and_not_passed_on(tmp_path: Path) -> None:
    data = video(tmp_path / "video.avi").read_bytes()
    begins = [match.start() for match in re.finditer(b"\xff\xd8\xff", data)]
    assert len(begins) == IMAGES
    # Within the file, images keep their length: the second one lacks its end, the third one has another size.
    end = data.index(b"\xff\xd9", begins[1])
    height = data.index(b"\xff\xc0", begins[2]) + 5
    damaged = bytearray(data)
    damaged[end : end + 2] = bytes(2)
    damaged[height : height + 2] = (HEIGHT // 2).to_bytes(2, "big")
    (tmp_path / "damaged.avi").write_bytes(damaged)
    with closing(jpeg_camera(tmp_path / "damaged.avi")) as camera:
        frames = taken(camera, IMAGES - 2)
        assert camera.counters.damaged >= 2
    if not camera.dropped:
        told = [grey(frame) for frame in frames[: IMAGES - 2]]
        assert told == pytest.approx([GREYS[0], GREYS[3], GREYS[4]], abs=3)
