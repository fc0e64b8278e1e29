"""Reads digits on boards in pictures of the simulated camera, and says how many were right.

    python -m tools.trials digits --first 1 --boards 600 [--signs 200]

Each board shows a digit in one of seven fonts, has one of three sizes, and stands in light, in half light or
partly in a shadow, 1.5 to 5 m away and turned by up to 60°. A second row of boards shows letters and figures:
none of them should be read as a digit. Boards that the picture cuts off do not count.

With `--signs`, a robot looks at further boards from several places, as in its task, and the tool says what it
believes in the end: it needs views from two places that agree.
"""

import argparse
import math
import string
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from robbie_robots.hw.camera import CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import POST_RADIUS_M, BoardFont, Figure, NumberSign
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.camera import SimulatedCamera
from robbie_robots.hw.simulation.number_board import GLYPH_SHARE, is_installed
from robbie_robots.workers.numbers.board_reader import BoardReader
from robbie_robots.workers.numbers.sign_map import SignMap
from tools.trials.harness import Case, TrialSubject

GEOMETRY = CameraGeometry(640, 360, math.radians(60))
EYE = Pose(5.0, 5.0, 0.0)
EDGES_M = (0.3, 0.45, 0.6)
SLANTS_DEG = (0, 15, 30, 45, 60)
HEIGHTS_PX = (0, 30, 40, 60, 1000)
BOARD_HEIGHT_M = 0.6
SIGN_GEOMETRY = CameraGeometry(640, 400, math.radians(60))
PLACES, IMAGES = 3, 2
LOOK_M, LOOK_RAD = (1.7, 3.2), math.radians(50)
"""Number of places from which a robot looks at a sign and of images from each; how far away, and how far
beside its front."""
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
        signs: what the robot believed of signs that it looked at from several places: right, wrong, or
            not sure, for digits and for others.
        signs_as: those that were wrong: what they show, and what it believed.
    """

    digits: dict[str, Counter[str]] = field(default_factory=dict)
    others_as: Counter[str] = field(default_factory=Counter)
    others: int = 0
    read_s: list[float] = field(default_factory=list)
    signs: Counter[str] = field(default_factory=Counter)
    signs_as: Counter[str] = field(default_factory=Counter)

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


def random_sign(random: np.random.Generator, texts: list[str]) -> NumberSign:
    """Return a random board that faces along the x axis."""
    return NumberSign(
        text=str(random.choice(texts)),
        x_m=8.0,
        y_m=6.0,
        facing_rad=0.0,
        height_m=BOARD_HEIGHT_M,
        edge_m=float(random.choice(EDGES_M)),
        font=BoardFont(str(random.choice(list(BoardFont)))),
        light=float(random.uniform(0.5, 1.0)),
        shadow=float(random.choice([0.0, random.uniform(0.2, 0.8)])),
    )


def believed(sign: NumberSign, reader: BoardReader, random: np.random.Generator) -> str | None:
    """Look at a sign from several places; return what `SignMap` makes of it."""
    post = (sign.x_m, sign.y_m)
    arena = _arena(sign)
    signs = SignMap()
    for _ in range(PLACES):
        direction_rad, away_m = random.uniform(-LOOK_RAD, LOOK_RAD), random.uniform(*LOOK_M)
        eye = Pose(
            sign.x_m + away_m * math.cos(direction_rad),
            sign.y_m + away_m * math.sin(direction_rad),
            direction_rad + math.pi + random.uniform(-0.1, 0.1),
        )
        camera = SimulatedCamera(arena, SIGN_GEOMETRY, seed=int(random.integers(1 << 30)))
        x_m, y_m, _ = SIGN_GEOMETRY.mount_m
        camera.place(eye.plus(Pose(-x_m, -y_m, 0.0)), 0.0)
        for _ in range(IMAGES):
            for one in reader.read(camera.capture().pixels.astype(np.uint8)):
                quadrangle = one.quadrangle
                if one.text and not one.is_sheet:
                    signs.see(one.text, post, 0.0, eye[:2], quadrangle.height_px)
                elif not one.is_sheet:
                    width = quadrangle.width_px / quadrangle.height_px
                    signs.see_other(post, eye[:2], quadrangle.height_px, width)
    return signs.signs[0].text if signs.signs else None


def run_signs(count: int, seed: int, figures: Figures) -> None:
    """Look at signs with digits, and at as many others, from several places."""
    random, reader = np.random.default_rng((seed, 3)), BoardReader()
    for _ in range(count):
        for kind, texts in (("digits", list(string.digits)), ("others", OTHERS)):
            sign = random_sign(random, texts)
            right = sign.text if sign.digit is not None else ""
            text = believed(sign, reader, random)
            result = "not sure" if text is None else "right" if text == right else "wrong"
            figures.signs[f"{kind}: {result}"] += 1
            if result == "wrong":
                figures.signs_as[f"{sign.text} as {text or 'no digit'}"] += 1


def _arena(sign: NumberSign) -> Arena:
    walls = box_segments(np.array([[0.0, 0.0, 16.0, 12.0]]))
    post = np.array([[sign.x_m, sign.y_m, POST_RADIUS_M]])
    return Arena(walls, post, EYE, 16.0, 12.0, 1.0, numbers=(sign,))


def read(trial: Trial, reader: BoardReader, figures: Figures, seed: int) -> list[str]:
    """Take a picture of a board and return the digits that were read in it."""
    sign = trial.sign
    camera = SimulatedCamera(_arena(sign), GEOMETRY, seed=seed)
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
        "read_ms_mean": round(1e3 * float(np.mean(figures.read_s)), 1) if figures.read_s else None,
        "signs": dict(sorted(figures.signs.items())),
        "signs_as": dict(figures.signs_as),
        "fonts_missing": [font.name for font in BoardFont if not is_installed(font)],
    }


def play(case: Case) -> dict[str, Any]:
    """Read the boards and the signs of a seed."""
    figures = run_trials(case.options.boards, case.seed)
    run_signs(case.options.signs, case.seed, figures)
    return summary(figures)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of boards."""
    parser.add_argument("--boards", type=int, default=600, help="boards with digits, and as many others")
    parser.add_argument("--signs", type=int, default=0, help="signs with digits seen from several places")


SUBJECT = TrialSubject(play=play, options=options, seeds=1, seed_makes="boards")
