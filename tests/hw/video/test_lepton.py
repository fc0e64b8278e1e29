"""A thermal camera's frames are temperatures, each once; frames that are none are refused."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from robbie_robots.hw.camera import CameraFrame
from robbie_robots.hw.emulation.lepton import EmulatedLepton
from robbie_robots.hw.video import source
from robbie_robots.hw.video.lepton import COLUMNS, ROWS, LeptonCamera

LIMIT_S = 20.0
NOWHERE = "emulated://lepton"


class Warming:
    """A scene whose pixels differ, one hundredth of a kelvin warmer with each frame."""

    def __init__(self) -> None:
        self.frames = 0

    def __call__(self) -> NDArray[np.uint16]:
        self.frames += 1
        pixels = 29_315 + self.frames + np.arange(ROWS * COLUMNS) % 500
        return pixels.reshape(ROWS, COLUMNS).astype(np.uint16)


@pytest.fixture
def on_v4l2(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a name count as a V4L2 device that can be used."""
    monkeypatch.setattr(source, "check", lambda name: None)
    monkeypatch.setattr(source, "is_device", lambda name: True)


@pytest.fixture
def emulated() -> EmulatedLepton:
    return EmulatedLepton(Warming())


@pytest.fixture
def camera(emulated: EmulatedLepton, on_v4l2: None) -> Iterator[LeptonCamera]:
    with closing(LeptonCamera("/dev/thermal", capture=emulated.capture)) as made:
        yield made


def until(camera: LeptonCamera, condition: Callable[[], bool]) -> list[CameraFrame]:
    frames: list[CameraFrame] = []
    give_up_s = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < give_up_s, camera.reason
        frames += camera.poll(0.01)
    return frames


def first(camera: LeptonCamera) -> CameraFrame:
    give_up_s = time.monotonic() + LIMIT_S
    while not (frames := camera.poll(0.1)):
        assert time.monotonic() < give_up_s, camera.reason
    return frames[0]


def test_frames_are_temperatures_and_repeated_ones_come_once(camera: LeptonCamera) -> None:
    frames = until(camera, lambda: camera.counters.values >= 6)
    warmth = [int(frame.pixels[0, 0]) for frame in frames]
    assert len(set(warmth)) == len(warmth) > 0
    assert frames[0].pixels.dtype == np.uint16 and frames[0].pixels.shape == (120, 160)
    assert int(frames[0].pixels[2, 10]) - warmth[0] == 330
    assert 29_315 < warmth[0] < 31_000
    assert camera.repeated >= 2 * (camera.counters.values - 1)


def test_tenths_of_a_kelvin_become_hundredths(camera: LeptonCamera, emulated: EmulatedLepton) -> None:
    emulated.is_fine = False
    pixels = first(camera).pixels
    assert not (pixels % 10).any() and 29_310 <= int(pixels[0, 0]) < 31_000


def test_camera_without_tlinear_is_refused_until_it_is_on(
    camera: LeptonCamera, emulated: EmulatedLepton
) -> None:
    emulated.is_linear = False
    until(camera, lambda: "switch on its mode TLinear" in camera.reason)
    assert not camera.is_connected
    emulated.is_linear = True
    first(camera)


def test_camera_that_is_pulled_out_comes_back(camera: LeptonCamera, emulated: EmulatedLepton) -> None:
    first(camera)
    emulated.is_plugged_in = False
    until(camera, lambda: not camera.is_connected)
    assert camera.poll() == []
    emulated.is_plugged_in = True
    first(camera)
    assert (camera.counters.connections, camera.counters.losses) == (2, 1)


@pytest.mark.parametrize(
    "image", [np.zeros((120, 160), np.uint16), np.zeros((122, 160, 3), np.uint8), np.zeros(0, np.uint16)]
)
def test_other_images_are_refused(
    image: NDArray[Any], on_v4l2: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulated = EmulatedLepton(Warming())
    monkeypatch.setattr(emulated, "read", lambda: (True, image))
    with closing(LeptonCamera("/dev/thermal", capture=emulated.capture)) as camera:
        until(camera, lambda: "not 122 x 160 of 16 bits with telemetry" in camera.reason)
