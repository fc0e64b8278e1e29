"""Boards are found as quadrangles, and shown as seen from straight ahead."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from robbie_robots.workers.numbers import quadrangles
from robbie_robots.workers.numbers.quadrangles import Quadrangle, QuadrangleFinder, QuadranglesMissing

BOARD = [(60.0, 40.0), (140.0, 52.0), (140.0, 118.0), (60.0, 130.0)]


def picture(corners: list[tuple[float, float]], ground: int = 90, frame: int = 30) -> NDArray[np.uint8]:
    """A board of light paper with a dark frame."""
    image = Image.new("L", (240, 160), ground)
    ImageDraw.Draw(image).polygon(corners, fill=240, outline=frame, width=4)
    return np.array(image)


def test_board_seen_at_a_slant_is_found_at_its_corners() -> None:
    found = QuadrangleFinder().find(picture(BOARD))
    assert found
    assert max(np.abs(one.corners_px - np.array(BOARD)).max() for one in found) < 6


def test_middle_is_where_the_diagonals_meet_and_not_the_mean_of_the_corners() -> None:
    slanted = Quadrangle(np.array([(0, 0), (60, 20), (60, 60), (0, 80)], np.float32))
    x, y = slanted.middle_px
    # The diagonals are y = x and y = 80 - x.
    assert (x, y) == pytest.approx((40.0, 40.0), abs=1e-4) or math.isclose(y, 40.0, abs_tol=1e-4)
    assert x > slanted.corners_px[:, 0].mean()


def test_board_half_in_a_shadow_is_found() -> None:
    image = picture(BOARD)
    image[90:] = image[90:] * 0.45
    found = QuadrangleFinder().find(image)
    assert min(np.abs(one.corners_px - np.array(BOARD)).max() for one in found) < 6


def test_light_board_without_a_frame_is_found_on_a_dark_ground() -> None:
    assert QuadrangleFinder().find(picture(BOARD, frame=240))


def test_small_boards_and_circles_are_no_quadrangles() -> None:
    image = Image.new("L", (240, 160), 90)
    draw = ImageDraw.Draw(image)
    draw.rectangle((20, 20, 30, 30), fill=240, outline=30)
    draw.ellipse((60, 30, 160, 130), fill=240, outline=30, width=4)
    assert QuadrangleFinder().find(np.array(image)) == []


def test_view_shows_a_slanted_board_from_straight_ahead() -> None:
    image = picture(BOARD)
    image[40:130, 60:100][image[40:130, 60:100] > 200] = 170
    corners = np.array(BOARD, np.float32)
    seen = QuadrangleFinder().view(image, Quadrangle(corners), 100, 100)
    left, right = seen[20:80, 10:40], seen[20:80, 70:90]
    assert np.median(left) == 170
    assert np.median(right) == 240


def test_missing_opencv_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(f"No module named {name!r}")

    monkeypatch.setattr(quadrangles, "import_module", missing)
    with pytest.raises(QuadranglesMissing, match="extra 'digits'"):
        QuadrangleFinder()
