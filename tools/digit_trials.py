"""Reads digits on boards in pictures of the simulated camera, and says how many were right.

    python -m tools.digit_trials --boards 600 --seed 1 [--json FILE]

Each board shows a digit in one of seven fonts, has one of three sizes, and stands in light, in half light or
partly in a shadow, 1.5 to 5 m away and turned by up to 60°. A second row of boards shows letters and figures:
none of them should be read as a digit. Boards that the picture cuts off do not count.
"""

import argparse
import json
import math
import string
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hw.camera import CameraGeometry
from hw.pose import Pose
from hw.simulation.arena import Arena
from hw.simulation.arena_contents import POST_RADIUS_M, BoardFont, Figure, NumberSign
from hw.simulation.box_segments import box_segments
from hw.simulation.camera import SimulatedCamera
from hw.simulation.number_board import GLYPH_SHARE, is_installed
from workers.numbers.board_reader import BoardReader

GEOMETRY = CameraGeometry(640, 360, math.radians(60))
EYE = Pose(5.0, 5.0, 0.0)
EDGES_M = (0.3, 0.45, 0.6)
SLANTS_DEG = (0, 15, 30, 45, 60)
HEIGHTS_PX = (0, 30, 40, 60, 1000)
BOARD_HEIGHT_M = 0.6
# These look like a 0 or a 1 in some font, so that nobody could tell them from it.
LIKE_DIGITS = "IOl"
OTHERS = [*(letter for letter in string.ascii_letters if letter not in LIKE_DIGITS), *map(str, Figure)]


@dataclass(frozen=True)
class Trial:
    """One board in front of the camera.

    Attributes:
        sign: the board.
        slant_deg: angle between its front and the direction to the camera.
        height_px: height of a digit on it in the picture, if seen from straight ahead.
    """

    sign: NumberSign
    slant_deg: int
    height_px: float


@dataclass
class Figures:
    """The results.

    Attributes:
        digits: for each slant and range of heights, how many boards were read right, wrong, and not at all.
        others_as: what other boards were taken for: what they show, and the digit.
        others: number of other boards.
        read_s: time to find and read the boards of a picture, for each picture.
    """

    digits: dict[str, Counter[str]] = field(default_factory=dict)
    others_as: Counter[str] = field(default_factory=Counter)
    others: int = 0
    read_s: list[float] = field(default_factory=list)

    def ratio(self, min_height_px: int, max_slant_deg: int) -> float:
        """Return the ratio of the boards read right, from a height on and up to a slant; NaN for none."""
        chosen: Counter[str] = Counter()
        for key, counted in self.digits.items():
            slant, height = key.split()
            if int(slant.removesuffix("°")) <= max_slant_deg and int(height.split("-")[0]) >= min_height_px:
                chosen += counted
        return chosen["right"] / chosen.total() if chosen else math.nan


def random_trial(random: np.random.Generator, texts: list[str]) -> Trial | None:
    """Put a random board in front of the camera; return None if the picture would cut it off."""
    edge_m, distance_m = float(random.choice(EDGES_M)), float(random.uniform(1.5, 5.0))
    slant_deg = int(random.choice(SLANTS_DEG))
    bearing_rad = float(random.uniform(-0.35, 0.35))
    sign = NumberSign(
        text=str(random.choice(texts)),
        x_m=EYE.x_m + distance_m * math.cos(bearing_rad),
        y_m=EYE.y_m + distance_m * math.sin(bearing_rad),
        facing_rad=math.pi + bearing_rad + math.radians(slant_deg) * float(random.choice([-1, 1])),
        height_m=BOARD_HEIGHT_M,
        edge_m=edge_m,
        font=BoardFont(str(random.choice(list(BoardFont)))),
        light=float(random.uniform(0.5, 1.0)),
        shadow=float(random.choice([0.0, random.uniform(0.2, 0.8)])),
    )
    near_m = distance_m - edge_m / 2
    above_px = (BOARD_HEIGHT_M + edge_m / 2 - GEOMETRY.mount_m[2]) / near_m * GEOMETRY.focal_length_px
    if above_px > GEOMETRY.height / 2 - 5:
        return None
    return Trial(sign, slant_deg, GEOMETRY.focal_length_px * edge_m * GLYPH_SHARE / distance_m)


def read(trial: Trial, reader: BoardReader, figures: Figures, seed: int) -> list[str]:
    """Take a picture of a board and return the digits that were read in it."""
    sign = trial.sign
    walls = box_segments(np.array([[0.0, 0.0, 16.0, 12.0]]))
    post = np.array([[sign.x_m, sign.y_m, POST_RADIUS_M]])
    camera = SimulatedCamera(Arena(walls, post, EYE, 16.0, 12.0, 1.0, numbers=(sign,)), GEOMETRY, seed=seed)
    x_m, y_m, _ = GEOMETRY.mount_m
    camera.place(EYE.plus(Pose(-x_m, -y_m, 0.0)), 0.0)
    pixels = camera.capture().pixels
    assert pixels.dtype == np.uint8
    began_s = time.perf_counter()
    sightings = reader.read(pixels.astype(np.uint8))
    figures.read_s.append(time.perf_counter() - began_s)
    return [one.text for one in sightings if one.text and not one.is_sheet]


def run_trials(boards: int, seed: int) -> Figures:
    """Read boards with digits, and as many others."""
    random, reader, figures = np.random.default_rng(seed), BoardReader(), Figures()
    for number in range(boards):
        trial = random_trial(random, list(string.digits))
        if trial is not None:
            texts = read(trial, reader, figures, seed + number)
            result = "right" if texts == [trial.sign.text] else "wrong" if texts else "none"
            place = int(np.searchsorted(HEIGHTS_PX, trial.height_px)) - 1
            key = f"{trial.slant_deg:2d}° {HEIGHTS_PX[place]}-{HEIGHTS_PX[place + 1]}px"
            figures.digits.setdefault(key, Counter())[result] += 1
        other = random_trial(random, OTHERS)
        if other is not None:
            figures.others += 1
            for text in read(other, reader, figures, seed + number):
                figures.others_as[f"{other.sign.text} as {text}"] += 1
    return figures


def summary(figures: Figures) -> dict[str, Any]:
    """Return the results as plain data."""
    total: Counter[str] = sum(figures.digits.values(), Counter())
    return {
        "digits": {key: dict(figures.digits[key]) for key in sorted(figures.digits)},
        "boards": total.total(),
        "wrong": total["wrong"],
        "right_from_40_px_to_30_deg": round(figures.ratio(40, 30), 4),
        "right_from_40_px_to_45_deg": round(figures.ratio(40, 45), 4),
        "others": figures.others,
        "others_as_digits": dict(figures.others_as),
        "read_ms_mean": round(1e3 * float(np.mean(figures.read_s)), 1),
        "fonts_missing": [font.name for font in BoardFont if not is_installed(font)],
    }


def main(words: list[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.digit_trials", description=__doc__)
    parser.add_argument("--boards", type=int, default=600, help="boards with digits, and as many others")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures to this file")
    options = parser.parse_args(words)
    text = json.dumps(summary(run_trials(options.boards, options.seed)), indent=2, ensure_ascii=False)
    print(text)
    if options.json:
        options.json.write_text(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
