"""The appearance of boards with digits and other things, and of the sheet that shows an order."""

import math
from functools import cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from robbie_robots.hw.simulation.arena_contents import BoardFont, Figure
from robbie_robots.hw.simulation.texture import Texture

Values = NDArray[np.uint8]

BOARD_TEXELS = 200
SHEET_TEXELS = 160
FRAME_SHARE = 0.035
GLYPH_SHARE = 0.66
"""Height of a digit, as a share of the board's edge."""
PAPER, INK, FRAME, BACK = (244, 244, 240), (18, 18, 22), (40, 40, 44), (126, 130, 128)
IN_SHADOW = 0.45
"""Brightness in the shadow, as a share of that in the sun."""

Points = list[tuple[float, float]]


def is_installed(font: BoardFont) -> bool:
    """Return whether a font is there; otherwise Pillow's own takes its place."""
    return font is BoardFont.PILLOW or _loaded(font, 12) is not _loaded(BoardFont.PILLOW, 12)


def board_texture(
    text: str, edge_m: float, font: BoardFont = BoardFont.SANS, light: float = 1.0, shadow: float = 0.0
) -> Texture:
    """Return a square board, red, green, blue.

    Args:
        text: one character, or the value of a `Figure`.
        edge_m: edge of the board.
        font: font of the character.
        light: brightness, 1 in full light.
        shadow: share of the board on which a shadow falls, 0 … 1.
    """
    picture = Image.new("L", (BOARD_TEXELS, BOARD_TEXELS), 0)
    if text in list(Figure):
        _draw_figure(ImageDraw.Draw(picture), Figure(text))
    else:
        _write(picture, text, font)
    return Texture(_coloured(np.asarray(picture), light, shadow), *_whole(picture, edge_m / BOARD_TEXELS))


def sheet_texture(text: str, height_m: float, font: BoardFont = BoardFont.SANS) -> Texture:
    """Return a sheet with a row of characters; it is as wide as they need."""
    width = round(SHEET_TEXELS * (0.5 + 0.55 * len(text)))
    picture = Image.new("L", (width, SHEET_TEXELS), 0)
    _write(picture, text, font)
    return Texture(_coloured(np.asarray(picture), 1.0, 0.0), *_whole(picture, height_m / SHEET_TEXELS))


def back_texture(edge_m: float, light: float = 1.0) -> Texture:
    """Return the back of a board."""
    picture = Image.new("L", (8, 8), 0)
    values = np.full((8, 8, 3), np.array(BACK) * min(light, 1.0), np.uint8)
    return Texture(values, *_whole(picture, edge_m / 8))


def _whole(picture: Image.Image, texel_m: float) -> tuple[NDArray[np.bool_], float, float]:
    """Return mask, size of a texel, and middle row of a picture without transparent places."""
    return np.ones((picture.height, picture.width), np.bool_), texel_m, picture.height / 2


@cache
def _loaded(font: BoardFont, size: int) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    if font is not BoardFont.PILLOW:
        try:
            return ImageFont.truetype(f"{font}.ttf", size)
        except OSError:
            return _loaded(BoardFont.PILLOW, size)
    return ImageFont.load_default(size)


def _write(picture: Image.Image, text: str, font: BoardFont) -> None:
    """Write characters into the middle, so that they are as high as a digit on a board."""
    height = picture.height * GLYPH_SHARE
    _, top, _, bottom = _loaded(font, 100).getbbox("0")
    loaded = _loaded(font, round(100 * height / (bottom - top)))
    left, top, right, bottom = loaded.getbbox(text)
    place = ((picture.width - left - right) / 2, (picture.height - top - bottom) / 2)
    ImageDraw.Draw(picture).text(place, text, font=loaded, fill=255)


def _draw_figure(draw: ImageDraw.ImageDraw, figure: Figure) -> None:
    if figure is Figure.RING:
        box = [(0.2 * BOARD_TEXELS, 0.2 * BOARD_TEXELS), (0.8 * BOARD_TEXELS, 0.8 * BOARD_TEXELS)]
        draw.ellipse(box, outline=255, width=BOARD_TEXELS // 10)
    else:
        for shape in _shapes(figure):
            draw.polygon([(BOARD_TEXELS * x, BOARD_TEXELS * y) for x, y in shape], fill=255)


def _shapes(figure: Figure) -> list[Points]:
    """Return polygons in a square of edge 1, y down."""
    arrow = [(0.15, 0.5), (0.45, 0.2), (0.45, 0.4), (0.85, 0.4), (0.85, 0.6), (0.45, 0.6), (0.45, 0.8)]
    if figure is Figure.ARROW_LEFT:
        return [arrow]
    if figure is Figure.ARROW_RIGHT:
        return [[(1 - x, y) for x, y in arrow]]
    if figure is Figure.ARROW_UP:
        return [[(y, x) for x, y in arrow]]
    if figure is Figure.TRIANGLE:
        return [[(0.5, 0.18), (0.86, 0.8), (0.14, 0.8)]]
    if figure is Figure.CROSS:
        bar = [(0.18, 0.28), (0.28, 0.18), (0.82, 0.72), (0.72, 0.82)]
        return [bar, [(1 - x, y) for x, y in bar]]
    corners = [(0.36 - 0.21 * (turn % 2), math.pi * (turn / 5 - 0.5)) for turn in range(10)]
    return [[(0.5 + radius * math.cos(angle), 0.52 + radius * math.sin(angle)) for radius, angle in corners]]


def _coloured(ink: Values, light: float, shadow: float) -> Values:
    """Return a board of paper with ink and a frame, lit."""
    rows, columns = ink.shape
    share = (ink / 255.0)[:, :, None]
    values = np.array(PAPER) * (1 - share) + np.array(INK) * share
    row, column = np.mgrid[:rows, :columns]
    frame = round(FRAME_SHARE * rows)
    inner = (row >= frame) & (row < rows - frame) & (column >= frame) & (column < columns - frame)
    values[~inner] = FRAME
    if shadow > 0:
        # The shadow's border crosses the board at an angle.
        values[0.7 * row / rows + 0.3 * column / columns > 1 - shadow] *= IN_SHADOW
    return np.clip(values * light, 0, 255).astype(np.uint8)
