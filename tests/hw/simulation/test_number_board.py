"""Boards show digits of the wanted size and light; arena files describe them."""

import math
from pathlib import Path

import numpy as np
import pytest

from robbie_robots.hw.simulation.arena_contents import BoardFont, Figure, NumberSign, Sheet, WallSpot
from robbie_robots.hw.simulation.arena_file import ArenaError, read_arena
from robbie_robots.hw.simulation.number_board import (
    GLYPH_SHARE,
    IN_SHADOW,
    board_texture,
    is_installed,
    sheet_texture,
)

GROUND = """\
cell_m: 1.0
drawing: |
  ######
  #....#
  #R...#
  ######
"""


def test_digits_are_as_high_as_said_in_every_font() -> None:
    for font in BoardFont:
        values = board_texture("8", 0.5, font).values[20:-20, 20:-20].mean(axis=2)
        rows = np.flatnonzero((values < 100).any(axis=1))
        assert (rows[-1] - rows[0]) / 200 == pytest.approx(GLYPH_SHARE, abs=0.06)


def test_every_figure_and_digit_looks_different() -> None:
    texts = [*map(str, range(10)), *map(str, Figure)]
    pictures = {board_texture(text, 0.5).values.tobytes() for text in texts}
    assert len(pictures) == len(texts)


def test_shadow_darkens_a_part_of_the_board() -> None:
    lit, shadowed = board_texture("1", 0.5).values, board_texture("1", 0.5, shadow=0.5).values
    ratio = shadowed.astype(float).sum(axis=2) / lit.astype(float).sum(axis=2)
    assert ratio[10, 10] == 1.0
    assert ratio[-10, -10] == pytest.approx(IN_SHADOW, abs=0.02)


def test_sheet_is_as_wide_as_its_digits_need() -> None:
    long, short = sheet_texture("0123456789", 0.2), sheet_texture("01", 0.2)
    assert long.values.shape[1] > 3 * short.values.shape[1]
    assert long.texel_m * long.values.shape[0] == pytest.approx(0.2)


def test_font_of_pillow_is_always_there() -> None:
    assert is_installed(BoardFont.PILLOW)


def test_arena_file_describes_boards_and_sheet(tmp_path: Path) -> None:
    file = tmp_path / "ground.yaml"
    file.write_text(
        GROUND
        + "numbers:\n"
        + "  - {text: 7, x_m: 3.0, y_m: 1.5, facing_rad: 3.0, font: DejaVuSerif, light: 0.7, shadow: 0.4}\n"
        + "  - {text: arrow_left, x_m: 4.0, y_m: 2.5, facing_rad: 0.0}\n"
        + 'sheet: {text: "0351", x_m: 2.9, y_m: 1.5, facing_rad: 3.1416}\n'
    )
    arena = read_arena(file)
    first, second = arena.numbers
    assert first == NumberSign("7", 3.0, 1.5, 3.0, font=BoardFont.SERIF, light=0.7, shadow=0.4)
    assert (first.digit, second.digit) == (7, None)
    # Lasers and bodies meet the posts.
    np.testing.assert_allclose(arena.circles, [[3.0, 1.5, 0.05], [4.0, 2.5, 0.05]])
    assert arena.sheet == Sheet("0351", WallSpot(2.9, 1.5, 0.35, 3.1416))
    assert math.isclose(first.back.facing_rad - first.front.facing_rad, math.pi)


@pytest.mark.parametrize(
    ("line", "match"),
    [
        ("numbers: [{text: seven, x_m: 3, y_m: 1.5, facing_rad: 3}]", ":7: text must be one character"),
        ("numbers: [{text: 7, x_m: 3, y_m: 1.5, facing_rad: 3, shadow: 2}]", ":7: shadow must be from 0"),
        ("numbers: [{text: 7, x_m: 3, y_m: 1.5, facing_rad: 3, light: 3}]", ":7: light must be from 0"),
        ("numbers: [{text: [7], x_m: 3, y_m: 1.5, facing_rad: 3}]", ":7: text must be a text"),
        ('sheet: {text: "11", x_m: 3, y_m: 1.5, facing_rad: 3}', ":7: text must be digits"),
    ],
)
def test_mistakes_in_boards_are_named(tmp_path: Path, line: str, match: str) -> None:
    file = tmp_path / "ground.yaml"
    file.write_text(GROUND + line + "\n")
    with pytest.raises(ArenaError, match=match):
        read_arena(file)
