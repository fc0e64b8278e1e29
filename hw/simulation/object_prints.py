"""What is printed on simulated boxes and cans; drawn by a program, each seed another print."""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from robbie_robots.hw.simulation.solid import Floats, Solid

Colours = NDArray[np.uint8]

TEXEL_M = 0.0004
PLAIN = (206, 200, 188)
"""Colour of a solid without a print, and of the lid of a can."""
SHAPES_PER_M2, WORDS_PER_M2 = 4000.0, 1500.0
SHAPE_M, WORD_M = (0.004, 0.022), (0.005, 0.014)
"""Least and greatest size of a shape, and height of a word."""
FACES = ((0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1))
"""Axis and direction of each face of a box."""
LIGHT_FROM = np.array([-0.45, 0.25, 0.86])
"""Direction of the light, arena frame; length 1 within rounding."""


class ObjectPrint:
    """The printed surface of a box or a can: each face of a box shows something else.

    Args:
        solid: the shape.
        seed: the same seed and shape have the same print; None: it is plain.
    """

    def __init__(self, solid: Solid, seed: int | None) -> None:
        self._solid = solid
        x, y, z = solid.size_m
        if seed is None:
            self._faces = [np.full((1, 1, 3), PLAIN, np.uint8)] * len(FACES)
        elif solid.is_round:
            self._faces = [drawn_print(seed, math.pi * x, z), np.full((1, 1, 3), PLAIN, np.uint8)]
        else:
            sizes = ((y, z), (y, z), (x, z), (x, z), (x, y), (x, y))
            self._faces = [drawn_print(seed + 1000 * face, *size) for face, size in enumerate(sizes)]

    def colours(self, points: Floats, turn: Floats) -> Floats:
        """Return what is seen of its surface: (N, 3), red, green, blue, 0 to 255.

        Args:
            points: (N, 3), m, its own frame, on its surface.
            turn: (3, 3), its rotation in the arena; the light comes from one side.
        """
        half = np.array(self._solid.size_m) / 2
        faces, across, down, normals = (
            self._on_can(points, half) if self._solid.is_round else self._on_box(points, half)
        )
        found = np.empty((len(points), 3))
        for face, picture in enumerate(self._faces):
            here = faces == face
            found[here] = _sampled(picture, across[here], down[here])
        light = 0.72 + 0.28 * np.clip(normals @ turn.T @ LIGHT_FROM, -1.0, 1.0)
        return np.asarray(found * light[:, None])

    def _on_box(self, points: Floats, half: Floats) -> tuple[NDArray[np.intp], Floats, Floats, Floats]:
        """Return the face of each point, where on it the point is (0 … 1), and its normal."""
        share = points / half
        towards = np.stack([share[:, axis] * sign for axis, sign in FACES], axis=1)
        faces = towards.argmax(axis=1)
        axes, signs = np.array(FACES).T
        # Seen from outside, the picture's right is along this axis and direction.
        right_axis, right_sign = np.array([1, 1, 0, 0, 0, 0]), np.array([1, -1, -1, 1, 1, 1])
        rows = np.arange(len(points))
        across = 0.5 + 0.5 * share[rows, right_axis[faces]] * right_sign[faces]
        lies = axes[faces] == 2
        down = 0.5 - 0.5 * np.where(lies, share[:, 1], share[:, 2])
        normals = np.zeros_like(points)
        normals[rows, axes[faces]] = signs[faces]
        return faces, across, down, normals

    def _on_can(self, points: Floats, half: Floats) -> tuple[NDArray[np.intp], Floats, Floats, Floats]:
        around = np.arctan2(points[:, 1], points[:, 0])
        # The end is nearer than the side.
        is_end = half[2] - np.abs(points[:, 2]) < half[0] - np.hypot(points[:, 0], points[:, 1])
        side = np.column_stack([np.cos(around), np.sin(around), np.zeros(len(points))])
        end = np.column_stack([np.zeros((len(points), 2)), np.sign(points[:, 2])])
        normals = np.where(is_end[:, None], end, side)
        across, down = around / math.tau + 0.5, 0.5 - points[:, 2] / (2 * half[2])
        return is_end.astype(np.intp), across, down, normals


@lru_cache(maxsize=64)
def drawn_print(seed: int, width_m: float, height_m: float) -> Colours:
    """Return a print of simple shapes and words on a ground of one colour, (rows, columns, 3)."""
    random = np.random.default_rng(seed)
    size = (max(8, round(width_m / TEXEL_M)), max(8, round(height_m / TEXEL_M)))
    picture = Image.new("RGB", size, _colour(random, 110))
    draw = ImageDraw.Draw(picture)
    area_m2 = width_m * height_m
    for _ in range(math.ceil(SHAPES_PER_M2 * area_m2)):
        x, y = (random.random(2) * size).tolist()
        wide, high = (random.uniform(*SHAPE_M, 2) / TEXEL_M).tolist()
        match int(random.integers(3)):
            case 0:
                draw.rectangle([x, y, x + wide, y + high], fill=_colour(random))
            case 1:
                draw.ellipse([x, y, x + wide, y + wide], fill=_colour(random))
            case _:
                corners = random.uniform(-0.5, 0.5, (3, 2)) * max(wide, high) + [x, y]
                draw.polygon([(column, row) for column, row in corners.tolist()], fill=_colour(random))
    for _ in range(math.ceil(WORDS_PER_M2 * area_m2)):
        word = "".join(chr(letter) for letter in random.integers(65, 91, int(random.integers(3, 8))))
        place = (random.uniform(-0.1, 0.6) * size[0], random.uniform(0.0, 0.9) * size[1])
        font = ImageFont.load_default(float(random.uniform(*WORD_M) / TEXEL_M))
        draw.text(place, word, font=font, fill=_colour(random))
    pixels = np.asarray(picture)
    pixels.setflags(write=False)
    return pixels


def _colour(random: np.random.Generator, least: int = 0) -> tuple[int, int, int]:
    red, green, blue = random.integers(least, 256, 3).tolist()
    return red, green, blue


def _sampled(picture: Colours, across: Floats, down: Floats) -> Floats:
    """Return the colours at places of a picture, between its elements: (N, 3)."""
    rows, columns = picture.shape[:2]
    column = np.clip(across * columns - 0.5, 0.0, columns - 1.0)
    row = np.clip(down * rows - 0.5, 0.0, rows - 1.0)
    left, top = column.astype(np.intp), row.astype(np.intp)
    right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    part, low = (column - left)[:, None], (row - top)[:, None]
    upper = picture[top, left] * (1 - part) + picture[top, right] * part
    lower = picture[bottom, left] * (1 - part) + picture[bottom, right] * part
    return np.asarray(upper * (1 - low) + lower * low)
