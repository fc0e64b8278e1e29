"""Digits on boards are read in pictures of the simulated camera; other boards are not taken for digits."""

import math
import string
from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import BoardFont, Figure, NumberSign, Sheet, WallSpot
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.workers.numbers import digit_reader
from robbie_robots.workers.numbers.board_reader import BoardReader, BoardSighting
from robbie_robots.workers.numbers.digit_reader import LineReader, ReaderMissing, Reading

needs_reader = pytest.mark.skipif(
    find_spec("rapidocr") is None,
    reason="rapidocr, which reads digits, is not installed (extra 'digits')",
)
GEOMETRY = CameraGeometry(640, 360, math.radians(60))
WALLS = box_segments(np.array([[0.0, 0.0, 12.0, 8.0]]))
AT = Pose(1.9, 4.0, 0.0)


@cache
def reader() -> BoardReader:
    return BoardReader()


def sightings(arena: Arena) -> list[BoardSighting]:
    camera = SimulatedCamera(arena, GEOMETRY)
    camera.place(AT, 0.0)
    return reader().read(camera.capture().pixels.astype(np.uint8))


def ground(*signs: NumberSign, sheet: Sheet | None = None) -> Arena:
    return Arena(WALLS, np.empty((0, 3)), AT, 12.0, 8.0, 1.0, numbers=signs, sheet=sheet)


def in_a_row(texts: str | list[str], font: BoardFont, **more: float) -> list[NumberSign]:
    """Boards 3.5 m ahead of the camera, from left to right."""
    return [
        NumberSign(text, 5.5, 5.4 - 0.7 * place, math.pi, 0.6, 0.5, font, **more)
        for place, text in enumerate(texts)
    ]


def texts_of(found: list[BoardSighting]) -> str:
    """What was read, from left to right."""
    return "".join(one.text for one in sorted(found, key=lambda one: one.quadrangle.middle_px[0]))


@needs_reader
@pytest.mark.parametrize("font", [BoardFont.SANS, BoardFont.ROMAN_BOLD, BoardFont.PILLOW])
def test_all_digits_are_read_in_several_fonts(font: BoardFont) -> None:
    for digits in (string.digits[:5], string.digits[5:]):
        assert texts_of(sightings(ground(*in_a_row(digits, font)))) == digits


@needs_reader
def test_digits_are_read_in_half_light_and_shadow_and_at_a_slant() -> None:
    for text, turn_rad in (("4", 0.5), ("6", -0.5), ("9", 0.5)):
        sign = NumberSign(text, 5.0, 4.0, math.pi + turn_rad, 0.6, 0.45, light=0.6, shadow=0.5)
        assert texts_of(sightings(ground(sign))) == text


@needs_reader
@pytest.mark.parametrize("shadow", [0.1, 0.17, 0.23, 0.3, 0.4])
def test_digit_is_read_whose_foot_stands_in_the_corner_of_a_shadow(shadow: float) -> None:
    sign = NumberSign("2", 4.4, 4.0, math.pi, 0.6, 0.45, BoardFont.SANS, shadow=shadow)
    assert texts_of(sightings(ground(sign))) == "2"


@needs_reader
def test_figures_and_letters_are_boards_without_a_digit() -> None:
    figures = [str(figure) for figure in Figure]
    for texts in (figures[:5], figures[5:], list("AKMWH")):
        found = sightings(ground(*in_a_row(texts, BoardFont.SANS)))
        assert len(found) >= len(texts) - 1
        assert texts_of(found) == ""


@needs_reader
def test_sheet_is_read_as_one_row_of_digits_until_the_robot_drives() -> None:
    sheet = Sheet("4719380265", WallSpot(3.3, 4.0, 0.4, math.pi))
    camera = SimulatedCamera(ground(sheet=sheet), GEOMETRY)
    camera.place(AT, 0.0)
    [seen] = [one for one in reader().read(camera.capture().pixels.astype(np.uint8)) if one.text]
    assert (seen.text, seen.is_sheet) == ("4719380265", True)
    camera.place(AT.plus(Pose(0.0, 0.4, 0.0)), 1.0)
    assert texts_of(reader().read(camera.capture().pixels.astype(np.uint8))) == ""


def test_reading_of_something_else_is_no_number() -> None:
    assert Reading("417", 0.9).is_number
    assert not Reading("4l7", 0.9).is_number
    assert not Reading("", 0.0).is_number


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(digit_reader, "find_spec", lambda _name: None)
    with pytest.raises(ReaderMissing, match="install it \\(extra 'digits'\\)"):
        LineReader()
