"""The modules that recognize what people have taught them."""

import json
from pathlib import Path

import numpy as np
import pytest

from robbie_mp import CallRefused, Header, ModuleHarness, SettingError, Time, replace
from robbie_mp.messages import Detection2DArray, ForgetRecognition, Image, TaughtNames, TeachRecognition
from robbie_robots.modules.taught_recognition import TaughtFaces, TaughtObjects, bounding_box
from robbie_robots.workers.faces import face_recognition
from robbie_robots.workers.taught import Box, Pixels
from tests.workers.objects._support.prints import SEEN_PX, TAUGHT_PX, drawn_print, scene


def image(pixels: Pixels) -> Image:
    height, width, _ = pixels.shape
    header = Header(stamp=Time(sec=3), frame_id="camera_optical")
    return Image(
        header=header, height=height, width=width, encoding="rgb8", step=3 * width, data=pixels.ravel()
    )


def teaching(name: str = "tea", seed: int = 1) -> TeachRecognition:
    pixels, box = scene(np.random.default_rng(seed), drawn_print(seed), TAUGHT_PX)
    return TeachRecognition(name=name, image=image(pixels), box=bounding_box(box), image_topic="camera")


def names(harness: ModuleHarness[TaughtObjects]) -> dict[str, int]:
    told = harness.latched(TaughtNames, "objects")
    assert told is not None
    return dict(zip(told.names, told.examples.tolist(), strict=True))


def show(harness: ModuleHarness[TaughtObjects], seed: int = 1) -> Box:
    """Let the module see a print; return where it is."""
    pixels, box = scene(np.random.default_rng(7), drawn_print(seed), SEEN_PX)
    harness.send(image(pixels), topic="camera")
    harness.advance(0.2)
    return box


def test_taught_object_is_published_with_its_box_until_it_is_forgotten() -> None:
    with ModuleHarness(TaughtObjects) as harness:
        assert names(harness) == {}
        assert harness.call(teaching(), topic="objects").examples == 1
        assert names(harness) == {"tea": 1}
        box = show(harness)
        (found,) = harness.take(Detection2DArray, "camera")
        assert (found.header.stamp.sec, found.header.frame_id) == (3, "camera_optical")
        (one,) = found.detections
        assert (one.id, one.results[0].hypothesis.class_id) == ("tea", "tea")
        assert one.results[0].hypothesis.score > 0.6
        assert one.bbox.center.position.x == pytest.approx(box.left + box.width / 2, abs=10.0)
        assert one.bbox.size_y == pytest.approx(box.height, abs=12.0)
        harness.call(ForgetRecognition(name="tea"), topic="objects")
        assert names(harness) == {}
        show(harness)
        assert harness.take(Detection2DArray, "camera")[-1].detections == []


def test_what_was_taught_survives_a_restart_of_the_robot(tmp_path: Path) -> None:
    settings = {"taught_file": tmp_path / "state" / "objects.json"}
    with ModuleHarness(TaughtObjects, settings) as harness:
        harness.call(teaching(), topic="objects")
    with ModuleHarness(TaughtObjects, settings) as harness:
        assert names(harness) == {"tea": 1}
        show(harness)
        assert len(harness.take(Detection2DArray, "camera")[-1].detections) == 1


def test_refusals_say_why_and_change_nothing(tmp_path: Path) -> None:
    with ModuleHarness(TaughtObjects) as harness:
        whole = teaching()
        small = replace(whole, box=replace(whole.box, size_x=3.0))
        with pytest.raises(CallRefused, match="the box is smaller than 16 x 16 pixels"):
            harness.call(small, topic="objects")
        strange = replace(whole, image=replace(whole.image, encoding="16UC1"))
        with pytest.raises(CallRefused, match="encoded as '16UC1'"):
            harness.call(strange, topic="objects")
        with pytest.raises(CallRefused, match="no object is known as 'tea'"):
            harness.call(ForgetRecognition(name="tea"), topic="objects")
        assert names(harness) == {}
    with ModuleHarness(TaughtObjects, {"taught_file": tmp_path / "no_folder" / "objects.json"}) as harness:
        (tmp_path / "no_folder").write_text("")
        with pytest.raises(CallRefused, match="it cannot be saved in"):
            harness.call(teaching(), topic="objects")
        assert harness.module.recognizer.examples() == {}


def test_damaged_file_is_an_error_before_the_robot_starts(tmp_path: Path) -> None:
    file = tmp_path / "objects.json"
    file.write_text(json.dumps({"version": 1, "kind": "objects", "taught": {"tea": ["no picture"]}}))
    with pytest.raises(SettingError, match="expected pictures as PNG"):
        TaughtObjects.check({"taught_file": file})


def test_image_that_cannot_be_used_is_counted() -> None:
    with ModuleHarness(TaughtObjects) as harness:
        harness.send(Image(encoding="bayer", height=2, width=2), topic="camera")
        harness.advance(0.2)
        assert harness.module.unusable == 1
        assert harness.take(Detection2DArray, "camera") == []


def test_missing_extra_for_faces_is_an_error_before_the_robot_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(face_recognition, "import_module", missing)
    with pytest.raises(ImportError, match="install dlib-bin and face-recognition-models"):
        TaughtFaces.check({"max_distance": 0.5, "doublings": 0, "taught_file": None})
