"""The modules of cameras publish images with their projection, and tell when the camera is away."""

import logging
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from robbie_mp import ModuleHarness, SettingError
from robbie_mp.messages import CameraInfo, CompressedImage, DeviceState, Image
from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.emulation.lepton import EmulatedLepton
from robbie_robots.hw.simulation.camera import SimulatedThermalCamera
from robbie_robots.hw.video import source
from robbie_robots.hw.video.lepton import LeptonCamera
from robbie_robots.modules.devices.video_camera import (
    JpegCameraModule,
    LeptonCameraModule,
    OpenCvCameraModule,
)
from tests.hw.simulation.test_camera import ROOM
from tests.hw.video.test_cameras import GREYS, HEIGHT, WIDTH, video

CALIBRATION = """\
image_width: {width}
image_height: 48
camera_name: front
camera_matrix: {{rows: 3, cols: 3, data: [60, 0, 31.5, 0, 61, 23.5, 0, 0, 1]}}
distortion_model: plumb_bob
distortion_coefficients: {{rows: 1, cols: 5, data: [0.1, -0.2, 0, 0, 0]}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
projection_matrix: {{rows: 3, cols: 4, data: [59, 0, 31, 0, 0, 60, 23, 0, 0, 0, 1, 0]}}
"""


def first(harness: ModuleHarness[Any], kind: type[Any]) -> Any:
    for _ in range(2000):
        harness.advance(0.005)
        if messages := harness.take(kind):
            return messages[0]
    raise AssertionError(harness.module.status)


def calibration(folder: Path, width: int = WIDTH) -> Path:
    file = folder / "front.yaml"
    file.write_text(CALIBRATION.format(width=width))
    return file


def test_decoded_images_come_with_the_calibration(tmp_path: Path) -> None:
    settings = {"source": str(video(tmp_path / "video.avi")), "calibration": calibration(tmp_path)}
    with ModuleHarness(OpenCvCameraModule, settings, name="front") as camera:
        image = first(camera, Image)
        assert (image.width, image.height, image.encoding, image.step) == (WIDTH, HEIGHT, "rgb8", 3 * WIDTH)
        assert image.data.mean() == pytest.approx(GREYS[0], abs=3)
        assert image.header.frame_id == "camera_optical"
        info = first(camera, CameraInfo)
        np.testing.assert_array_equal(info.k.reshape(3, 3), [[60, 0, 31.5], [0, 61, 23.5], [0, 0, 1]])
        np.testing.assert_array_equal(info.d, [0.1, -0.2, 0, 0, 0])
        assert (info.width, info.height, info.p[0]) == (WIDTH, HEIGHT, 59)
        assert first(camera, DeviceState).port == settings["source"]


def test_jpeg_images_are_passed_on_as_they_are(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="NOT TESTED: PyAV is not installed")
    settings = {"source": str(video(tmp_path / "video.avi")), "topic": "rear", "field_of_view_rad": 1.0}
    with ModuleHarness(JpegCameraModule, settings) as camera:
        image = first(camera, CompressedImage)
        assert image.format == "jpeg" and image.header.frame_id == "rear_optical"
        decoded = cv2.imdecode(image.data, cv2.IMREAD_COLOR)
        assert decoded is not None and decoded.shape == (HEIGHT, WIDTH, 3)
        info = first(camera, CameraInfo)
        assert info.k[0] == pytest.approx(WIDTH / 2 / np.tan(0.5))


def test_calibration_for_other_images_is_ignored_with_an_error(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    settings = {"source": str(video(tmp_path / "video.avi")), "calibration": calibration(tmp_path, 640)}
    with caplog.at_level(logging.ERROR), ModuleHarness(OpenCvCameraModule, settings) as camera:
        for _ in range(3):
            assert not first(camera, CameraInfo).k.any()
    assert caplog.text.count("the calibration is for images of 640 x 48, and these have 64 x 48") == 1


def test_missing_camera_is_told_and_nothing_is_published(tmp_path: Path) -> None:
    with ModuleHarness(OpenCvCameraModule, {"source": str(tmp_path / "none"), "period_s": 0.5}) as camera:
        camera.advance(0.5)
        states = [state.state for state in camera.take(DeviceState)]
        assert states and set(states) == {"DISCONNECTED"}
        camera.advance(1.0)
        assert "there is no camera at" in camera.module.status
        assert camera.take(Image) == [] and camera.take(CameraInfo) == []


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("just text", "has no entries"),
        ("image_width: 64", "image_height is missing"),
        (CALIBRATION.format(width=64).replace("[60, 0,", "[60,"), "camera_matrix"),
        (CALIBRATION.format(width=64).replace("[60", "[.nan"), "not finite"),
        ("[", "YAML: while parsing"),
        ("image_width: 2026-13-45", "image_width must be a whole number"),
        (CALIBRATION.format(width=64.5), "image_width must be a whole number from 1 to 65535, not 64.5"),
        (CALIBRATION.format(width=-64), "image_width must be a whole number"),
        (CALIBRATION.format(width=64).replace("[60, 0,", "[-60, 0,"), "camera_matrix must be fx 0 cx"),
        (
            CALIBRATION.format(width=64).replace(
                "[60, 0, 31.5, 0, 61, 23.5, 0, 0, 1]", "[60, 0, 0, 0, 61, 0, 31, 23, 1]"
            ),
            "camera_matrix must be fx 0 cx",
        ),
    ],
)
def test_wrong_calibration_is_refused_before_the_start(text: str, problem: str, tmp_path: Path) -> None:
    (tmp_path / "wrong.yaml").write_text(text)
    with pytest.raises(SettingError, match=problem):
        ModuleHarness(OpenCvCameraModule, {"source": "x", "calibration": tmp_path / "wrong.yaml"})


def test_emulated_thermal_camera_shows_the_temperatures_of_the_simulated_scene(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = SimulatedThermalCamera(ROOM, CameraGeometry(160, 120))
    scene.place(ROOM.start, 0.0)
    pixels = scene.capture().pixels
    emulated = EmulatedLepton(lambda: pixels.astype(np.uint16))
    monkeypatch.setattr(source, "check", lambda name: None)
    monkeypatch.setattr(source, "is_device", lambda name: True)
    monkeypatch.setattr(
        "robbie_robots.modules.devices.video_camera.LeptonCamera",
        partial(LeptonCamera, capture=emulated.capture),
    )
    with ModuleHarness(LeptonCameraModule, {"source": "/dev/thermal"}) as camera:
        image = first(camera, Image)
    assert (image.width, image.height, image.encoding, image.step) == (160, 120, "mono16", 320)
    assert image.header.frame_id == "thermal_optical"
    np.testing.assert_array_equal(image.data.view("<u2").reshape(120, 160), pixels)
    assert int(pixels.min()) < int(pixels.max())
