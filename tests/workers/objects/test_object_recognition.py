"""Objects are found again after one picture, and nothing else is taken for them."""

import base64
import json
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.workers.objects import object_recognition
from robbie_robots.workers.objects.object_recognition import ObjectRecognizer, ObjectsMissing
from robbie_robots.workers.taught import (
    MAX_EXAMPLES,
    MAX_NAMES,
    Box,
    Pixels,
    TeachingError,
    as_json,
    read_taught,
)
from tests.workers.objects._support.prints import SEEN_PX, TAUGHT_PX, drawn_print, scene, trial


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(1)


@pytest.fixture
def taught(random: np.random.Generator) -> ObjectRecognizer:
    recognizer = ObjectRecognizer()
    recognizer.teach(" tea ", *scene(random, drawn_print(1), TAUGHT_PX))
    return recognizer


def plain_grey(level: int = 128) -> Pixels:
    return np.full((240, 320, 3), level, np.uint8)


def overlap(one: Box, other: Box) -> float:
    """What both boxes have in common, as a share of what they cover together."""
    across = min(one.left + one.width, other.left + other.width) - max(one.left, other.left)
    down = min(one.top + one.height, other.top + other.height) - max(one.top, other.top)
    common = max(0.0, across) * max(0.0, down)
    return common / (one.width * one.height + other.width * other.height - common)


@pytest.mark.parametrize("angle_deg", [0, 40, -40])
def test_object_is_found_where_it_is(
    taught: ObjectRecognizer, random: np.random.Generator, angle_deg: float
) -> None:
    picture, box = scene(random, drawn_print(1), SEEN_PX, angle_deg)
    (found,) = taught.find(picture)
    assert found.name == "tea"
    assert 0.6 < found.confidence <= 1.0
    assert overlap(found.box, box) > 0.6


def test_another_object_and_an_empty_picture_are_not_it(
    taught: ObjectRecognizer, random: np.random.Generator
) -> None:
    assert taught.find(scene(random, drawn_print(2), SEEN_PX)[0]) == []
    assert taught.find(plain_grey()) == []


def test_one_equal_word_on_two_things_does_not_make_them_one(random: np.random.Generator) -> None:
    one, other = drawn_print(3), drawn_print(4)
    other[20:70, 20:170] = one[120:170, 100:250]
    recognizer = ObjectRecognizer()
    recognizer.teach("one", *scene(random, one, TAUGHT_PX))
    assert recognizer.find(scene(random, other, SEEN_PX)[0]) == []


def test_forgotten_object_is_not_found(taught: ObjectRecognizer, random: np.random.Generator) -> None:
    taught.forget("tea")
    assert taught.find(scene(random, drawn_print(1), SEEN_PX)[0]) == []
    with pytest.raises(TeachingError, match="no object is known as 'tea'"):
        taught.forget("tea")


def test_what_cannot_be_told_apart_is_refused_with_a_reason(random: np.random.Generator) -> None:
    recognizer = ObjectRecognizer()
    picture, box = scene(random, drawn_print(1), TAUGHT_PX)
    with pytest.raises(TeachingError, match="features are in the box, and 20 are needed"):
        recognizer.teach("wall", plain_grey(), Box(10, 10, 200, 200))
    with pytest.raises(TeachingError, match="smaller than 16 x 16 pixels"):
        recognizer.teach("cup", picture, Box(box.left, box.top, 300.0, 15.0))
    with pytest.raises(TeachingError, match="smaller than 16 x 16 pixels"):
        recognizer.teach("cup", picture, Box(-500.0, 0.0, 400.0, 300.0))
    with pytest.raises(TeachingError, match="not finite"):
        recognizer.teach("cup", picture, Box(float("nan"), 0.0, 400.0, 300.0))
    for name in ("", "  ", "a" * 65, "a\nb"):
        with pytest.raises(TeachingError, match="a name has 1 to 64 printable characters"):
            recognizer.teach(name, picture, box)
    assert recognizer.examples() == {}


def test_examples_and_names_are_bounded(random: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    recognizer = ObjectRecognizer()
    monkeypatch.setattr(recognizer, "_example", lambda picture: picture)
    picture, box = scene(random, drawn_print(1), TAUGHT_PX)
    for _ in range(MAX_EXAMPLES + 1):
        recognizer.teach("tea", picture, box)
    assert recognizer.examples() == {"tea": MAX_EXAMPLES}
    for number in range(MAX_NAMES - 1):
        recognizer.teach(f"thing {number}", picture, box)
    with pytest.raises(TeachingError, match="32 names are known already: forget one first"):
        recognizer.teach("one too many", picture, box)


def test_what_was_taught_is_found_after_it_was_saved(
    taught: ObjectRecognizer, random: np.random.Generator, tmp_path: Path
) -> None:
    file = tmp_path / "taught.json"
    file.write_bytes(as_json("objects", taught.plain()))
    restored = ObjectRecognizer()
    restored.restore(read_taught(file, "objects"))
    assert [one.name for one in restored.find(scene(random, drawn_print(1), SEEN_PX)[0])] == ["tea"]


def png_of(pixels: int) -> str:
    """A PNG whose header says how many pixels it has in each direction, and that has none of them."""
    size = pixels.to_bytes(4, "big")
    return base64.b64encode(b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + size + size + bytes(50)).decode()


@pytest.mark.parametrize(
    ("example", "why"),
    [
        (3, "PNG in base64"),
        ("no base64!", "PNG in base64"),
        (base64.b64encode(b"GIF89a").decode(), "PNG pictures of at most 320 pixels"),
        (png_of(60_000), "PNG pictures of at most 320 pixels"),
        (png_of(64), "a picture is damaged"),
    ],
)
def test_damaged_pictures_are_refused(example: object, why: str) -> None:
    with pytest.raises(TeachingError, match=why):
        ObjectRecognizer().restore({"tea": [example]})


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(object_recognition, "import_module", missing)
    with pytest.raises(ObjectsMissing, match="install opencv-python-headless \\(extra 'vision'\\)"):
        ObjectRecognizer()


@pytest.mark.slow
def test_trial_finds_most_and_invents_nothing() -> None:
    figures = trial(objects=6, repeats=1)
    assert figures.recall[0] >= 0.8
    assert figures.recall[45] >= 0.6
    assert (figures.wrong_names, figures.false_scenes) == (0, 0)
    assert json.dumps(figures.recall)
