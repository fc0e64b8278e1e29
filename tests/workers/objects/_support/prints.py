"""Drawn prints in scenes, from in front and from the side, and how well they are recognized.

Letters are of a few fonts, so different prints have equal parts.
"""

import math
import time
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.objects.object_recognition import ObjectRecognizer
from robbie_robots.workers.taught import Box, Pixels

PRINT_PX = 320
WIDTH_PX, HEIGHT_PX = 640, 480
TAUGHT_PX, SEEN_PX = 260.0, 220.0
ANGLES_DEG = (0, 25, 45, 60)
MAX_ROLL_RAD = 0.3
DISTANCE = 3.0  # from the camera, in heights of the print
SHAPES, WORDS = 14, 5
NOISE = 4.0


@dataclass
class Figures:
    """What was measured.

    Attributes:
        recall: Share of scenes in which the object was found, by the angle in degrees.
        scenes: Number of scenes for each angle.
        wrong_names: Sightings of another object than the one in the scene.
        false_scenes: Scenes with an unknown print in which something was seen.
        unknown_scenes: Number of scenes with an unknown print.
        mean_ms: Mean time for a scene.
    """

    recall: dict[int, float]
    scenes: int
    wrong_names: int
    false_scenes: int
    unknown_scenes: int
    mean_ms: float


def drawn_print(seed: int) -> Pixels:
    """Return a print of simple shapes and words, (320, 320, 3)."""
    cv2: Any = import_module("cv2")
    random = np.random.default_rng(seed)

    def colour() -> tuple[int, ...]:
        return tuple(random.integers(0, 256, 3).tolist())

    picture = np.full((PRINT_PX, PRINT_PX, 3), random.integers(120, 256, 3), np.uint8)
    for _ in range(SHAPES):
        x, y, wide, high = (
            int(one) for one in (*random.integers(0, PRINT_PX, 2), *random.integers(20, 110, 2))
        )
        match int(random.integers(3)):
            case 0:
                cv2.rectangle(picture, (x, y), (x + wide, y + high), colour(), -1)
            case 1:
                cv2.circle(picture, (x, y), wide // 2, colour(), -1)
            case _:
                corners = random.integers(-50, 50, (3, 2)) + np.array([x, y])
                cv2.fillPoly(picture, [corners.astype(np.int32)], colour())
    for _ in range(WORDS):
        word = "".join(chr(random.integers(65, 91)) for _ in range(random.integers(3, 8)))
        x, y = random.integers(10, PRINT_PX - 40, 2).tolist()
        font, size, thick = (
            int(random.integers(0, 8)),
            float(random.uniform(0.7, 1.8)),
            int(random.integers(1, 4)),
        )
        cv2.putText(picture, word, (x, y), font, size, colour(), thick, cv2.LINE_AA)
    return picture


def scene(
    random: np.random.Generator, shown: Pixels, height_px: float, angle_deg: float = 0.0
) -> tuple[Pixels, Box]:
    """Return a picture of 640 x 480 pixels with a print in it, and the box around that.

    Args:
        random: Gives the place, the light and the noise.
        shown: The print.
        height_px: Its height at its middle.
        angle_deg: By how much it is turned about its upright axis.
    """
    cv2: Any = import_module("cv2")
    behind = random.integers(60, 200, (12, 16, 3)).astype(np.uint8)
    behind = cv2.resize(behind, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_CUBIC)
    corners = _corners(random, height_px, math.radians(angle_deg))
    edge = shown.shape[0]
    flat = np.array([[0, 0], [edge, 0], [edge, edge], [0, edge]], np.float32)
    perspective = cv2.getPerspectiveTransform(flat, corners.astype(np.float32))
    smooth = cv2.GaussianBlur(shown, (0, 0), max(0.01, 0.4 * edge / height_px))
    size = (WIDTH_PX, HEIGHT_PX)
    warped = cv2.warpPerspective(smooth, perspective, size)
    mask = cv2.warpPerspective(np.full((edge, edge), 255, np.uint8), perspective, size)
    picture = np.where(mask[:, :, None] > 127, warped, behind) * random.uniform(0.6, 1.2)
    picture = np.clip(picture + random.normal(0.0, NOISE, picture.shape), 0, 255).astype(np.uint8)
    low, high = corners.min(axis=0), corners.max(axis=0)
    return picture, Box(*low.tolist(), *(high - low).tolist())


def _corners(random: np.random.Generator, height_px: float, angle_rad: float) -> NDArray[np.float64]:
    """Return where the corners of a turned print are in the picture, (4, 2)."""
    flat = height_px * np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    depth = 1.0 + flat[:, 0] * math.sin(angle_rad) / (DISTANCE * height_px)
    seen = np.column_stack([flat[:, 0] * math.cos(angle_rad), flat[:, 1]]) / depth[:, None]
    roll_rad = random.uniform(-MAX_ROLL_RAD, MAX_ROLL_RAD)
    turn = np.array([[math.cos(roll_rad), -math.sin(roll_rad)], [math.sin(roll_rad), math.cos(roll_rad)]])
    room = 0.6 * height_px
    middle = [random.uniform(room, WIDTH_PX - room), random.uniform(room, HEIGHT_PX - room)]
    return np.asarray(seen @ turn.T + middle)


def trial(objects: int, repeats: int, seed: int = 0) -> Figures:
    """Teach the first half of the prints, and search scenes with all of them.

    Args:
        objects: Number of taught prints; as many are not taught.
        repeats: Scenes of each print and angle.
        seed: Seed of the scenes.
    """
    random = np.random.default_rng(seed)
    recognizer = ObjectRecognizer()
    prints = [drawn_print(number) for number in range(2 * objects)]
    for number in range(objects):
        recognizer.teach(f"print {number}", *scene(random, prints[number], TAUGHT_PX))
    hits = dict.fromkeys(ANGLES_DEG, 0)
    wrong_names = false_scenes = 0
    begun_s = time.monotonic()
    for angle_deg in ANGLES_DEG:
        for number, shown in enumerate(prints):
            for repeat in range(repeats):
                side = angle_deg * (-1) ** repeat
                names = {one.name for one in recognizer.find(scene(random, shown, SEEN_PX, side)[0])}
                if number < objects:
                    hits[angle_deg] += f"print {number}" in names
                    wrong_names += len(names - {f"print {number}"})
                else:
                    false_scenes += bool(names)
    scenes = objects * repeats
    total = 2 * scenes * len(ANGLES_DEG)
    return Figures(
        recall={angle: round(hit / scenes, 3) for angle, hit in hits.items()},
        scenes=scenes,
        wrong_names=wrong_names,
        false_scenes=false_scenes,
        unknown_scenes=scenes * len(ANGLES_DEG),
        mean_ms=round(1000 * (time.monotonic() - begun_s) / total),
    )
