"""Persons are recognized by their faces: in real pictures, which are not part of the project."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from robbie_robots.workers.faces import face_recognition
from robbie_robots.workers.faces.face_recognition import (
    MAX_DISTANCE,
    NUMBERS,
    FaceRecognizer,
    FacesMissing,
    confidence_of,
)
from robbie_robots.workers.taught import Box, Pixels, TeachingError
from tools.trials.missions.who_is_who import changed

pytestmark = pytest.mark.slow
FOLDER = Path("/work/shared/data/home/faces")
pytest.importorskip("dlib", reason="RECOGNITION OF FACES IS NOT TESTED: pip install 'robbie-mp[faces]'")
needs_pictures = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"RECOGNITION OF REAL FACES IS NOT TESTED: {FOLDER} is not here"
)


@pytest.fixture(scope="module")
def loaded() -> FaceRecognizer:
    return FaceRecognizer()


@pytest.fixture
def recognizer(loaded: FaceRecognizer) -> FaceRecognizer:
    loaded.restore({})
    return loaded


def picture(name: str) -> Pixels:
    return np.asarray(Image.open(FOLDER / name).convert("RGB"))


def whole(pixels: Pixels) -> Box:
    return Box(0.0, 0.0, float(pixels.shape[1]), float(pixels.shape[0]))


def teach(recognizer: FaceRecognizer, name: str, file: str) -> None:
    recognizer.teach(name, picture(file), whole(picture(file)))


@needs_pictures
def test_person_is_known_in_another_picture_and_a_stranger_is_not(recognizer: FaceRecognizer) -> None:
    teach(recognizer, "Barack", "obama_1.jpg")
    (seen,) = recognizer.find(picture("obama_2.jpg"))
    assert seen.name == "Barack"
    assert 0.5 <= seen.confidence < 1.0
    (stranger,) = recognizer.find(picture("biden_1.jpg"))
    assert (stranger.name, stranger.confidence) == ("", 0.0)
    plain = recognizer.plain()
    recognizer.restore({})
    recognizer.restore(plain)
    assert recognizer.find(picture("obama_2.jpg")) == [seen]
    with pytest.raises(TeachingError, match="this face is known as 'Barack'"):
        teach(recognizer, "Joe", "obama_2.jpg")
    recognizer.forget("Barack")
    assert recognizer.find(picture("obama_2.jpg"))[0].name == ""


@needs_pictures
def test_no_stranger_is_taken_for_a_known_person(loaded: FaceRecognizer) -> None:
    """Each picture is changed as cameras and lights would change it, and compared with the original ones."""
    names = ("biden_1.jpg", "obama_1.jpg", "obama_2.jpg")
    seen = {
        (name, how): faces[0]
        for name in names
        for how, pixels in changed(picture(name))
        if (faces := loaded.describe(pixels))
    }
    same: list[float] = []
    strangers: list[float] = []
    for taught in names:
        for (name, how), face in seen.items():
            if (name, how) != (taught, "as it is"):
                distance = float(np.linalg.norm(seen[taught, "as it is"] - face))
                (same if name[:4] == taught[:4] else strangers).append(distance)
    assert min(strangers) > MAX_DISTANCE
    assert sum(distance > MAX_DISTANCE for distance in same) <= 0.1 * len(same)


def test_box_without_a_face_is_refused(recognizer: FaceRecognizer) -> None:
    with pytest.raises(TeachingError, match="no face is found in the box"):
        recognizer.teach("Nobody", np.full((100, 100, 3), 128, np.uint8), Box(10, 10, 60, 60))


def test_unknown_name_cannot_be_forgotten(recognizer: FaceRecognizer) -> None:
    with pytest.raises(TeachingError, match="nobody is known as 'Anna'"):
        recognizer.forget("Anna")


@pytest.mark.parametrize("numbers", [None, [0.0] * (NUMBERS - 1), ["x"] * NUMBERS, [float("nan")] * NUMBERS])
def test_damaged_descriptions_are_refused(recognizer: FaceRecognizer, numbers: object) -> None:
    with pytest.raises(TeachingError, match="'Anna': expected 128"):
        recognizer.restore({"Anna": [numbers]})


def test_confidence_falls_with_the_distance() -> None:
    assert [confidence_of(distance, 0.5) for distance in (0.0, 0.25, 0.5)] == [1.0, 0.75, 0.5]


def test_missing_library_and_missing_models_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(face_recognition, "find_spec", lambda _name: None)
    with pytest.raises(FacesMissing, match=r"needs shape_predictor_5_face_landmarks\.dat"):
        FaceRecognizer()

    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(face_recognition, "import_module", missing)
    with pytest.raises(FacesMissing, match="install dlib-bin and face-recognition-models"):
        FaceRecognizer()
