"""Measures how well taught faces are recognized in real pictures.

    python -m tools.trials faces --faces FOLDER

The part of a file's name before the first `_` is the person. Each picture is also changed as a camera would
change it: smaller, darker, lighter, noisier, turned a little, mirrored. Every person is taught from each of
their original pictures in turn, and compared with all other pictures, their own changed ones included.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from robbie_robots.workers.faces.face_recognition import MAX_DISTANCE, Description, FaceRecognizer
from robbie_robots.workers.taught import Pixels
from tools.trials.harness import CannotTry, Case, TrialSubject


@dataclass
class Figures:
    """What was measured.

    Attributes:
        persons: Number of persons.
        pictures: Number of original pictures.
        no_face: Changed pictures in which no face was found.
        false_accepts: Pairs of two persons that were taken for one, of `strangers` pairs.
        strangers: Number of pairs of pictures of two persons.
        false_rejects: Pairs of one person that were taken for two, of `same` pairs.
        same: Number of pairs of one person: an original picture, and a changed or another one.
        nearest_strangers: Least distance of two persons.
    """

    persons: int
    pictures: int
    no_face: int
    false_accepts: int
    strangers: int
    false_rejects: int
    same: int
    nearest_strangers: float


def changed(picture: Pixels, seed: int = 0) -> Iterator[tuple[str, Pixels]]:
    """Yield a picture as other cameras, places and lights would show it, each with what was changed."""
    cv2: Any = import_module("cv2")
    random = np.random.default_rng(seed)
    height, width = picture.shape[:2]
    yield "as it is", picture
    yield "two thirds as large", cv2.resize(picture, None, fx=2 / 3, fy=2 / 3, interpolation=cv2.INTER_AREA)
    yield "dark", (picture * 0.45).astype(np.uint8)
    yield "light", np.clip(picture * 1.4 + 20.0, 0, 255).astype(np.uint8)
    yield "noisy", np.clip(picture + random.normal(0.0, 15.0, picture.shape), 0, 255).astype(np.uint8)
    yield "blurred", cv2.GaussianBlur(picture, (0, 0), 2.0)
    for degrees in (-12, 12):
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
        yield f"turned by {degrees} degrees", cv2.warpAffine(picture, turn, (width, height))
    yield "mirrored", np.ascontiguousarray(picture[:, ::-1])


def trial(files: list[Path], max_distance: float = MAX_DISTANCE, seed: int = 0) -> Figures:
    """Compare the faces in pictures.

    Args:
        files: The pictures.
        max_distance: Maximum distance of two descriptions of one person.
        seed: of the noise.
    """
    cv2: Any = import_module("cv2")
    recognizer = FaceRecognizer(max_distance)
    described: list[tuple[str, str, str, Description]] = []
    no_face = 0
    for file in files:
        picture = cv2.cvtColor(cv2.imread(str(file)), cv2.COLOR_BGR2RGB)
        for how, seen in changed(picture, seed):
            faces = recognizer.describe(seen)
            if not faces:
                no_face += 1
            else:
                described.append((file.stem.split("_")[0], file.name, how, faces[0]))
    same: list[float] = []
    strangers: list[float] = []
    for person, name, how, taught in described:
        if how != "as it is":
            continue
        for other_person, other_name, other_how, other in described:
            if (name, how) == (other_name, other_how):
                continue
            distance = float(np.linalg.norm(taught - other))
            (same if person == other_person else strangers).append(distance)
    return Figures(
        persons=len({person for person, *_ in described}),
        pictures=len(files),
        no_face=no_face,
        false_accepts=sum(one <= max_distance for one in strangers),
        strangers=len(strangers),
        false_rejects=sum(one > max_distance for one in same),
        same=len(same),
        nearest_strangers=round(min(strangers, default=np.inf), 3),
    )


def play(case: Case) -> Figures:
    """Compare the faces of a folder.

    Raises:
        CannotTry: it has no pictures.
    """
    files = sorted(case.options.faces.glob("*.jpg"))
    if not files:
        raise CannotTry(f"{case.options.faces}: there are no .jpg files")
    return trial(files, case.options.max_distance, case.seed)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of faces."""
    faces = "folder with pictures PERSON_NUMBER.jpg, one face in each"
    parser.add_argument("--faces", type=Path, required=True, metavar="FOLDER", help=faces)
    parser.add_argument("--max-distance", type=float, default=MAX_DISTANCE, help=f"({MAX_DISTANCE})")


SUBJECT = TrialSubject(play=play, options=options, seeds=1, seed_makes="other noise")
