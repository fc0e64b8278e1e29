"""Recognizes persons by their faces, after one picture of each.

Faces are found by dlib's frontal detector (histograms of oriented gradients; King, "Max-margin object
detection", 2015), aligned by 5 landmarks, and described by 128 numbers of a residual network
(dlib_face_recognition_resnet_model_v1; He et al., "Deep residual learning for image recognition", CVPR 2016),
as A. Geitgey's `face_recognition` does. Two descriptions of one person are closer to each other than those of
two persons.
"""

import math
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.taught import (
    MAX_EXAMPLES,
    MAX_NAMES,
    Box,
    Pixels,
    Sighting,
    TeachingError,
    checked_name,
    cut_out,
    room_for,
)

MAX_DISTANCE = 0.5
"""Maximum distance of two descriptions of the same person."""
NUMBERS = 128
MARGIN = 0.4  # around a taught box: the detector needs the whole head
MIN_FACE_PX = 80
"""A smaller taught picture is enlarged until its shorter side has this length, so that the face is found."""

Description = NDArray[np.float64]


class FacesMissing(ImportError):
    """dlib or its models are not installed."""


class FaceRecognizer:
    """Finds faces, and tells whose they are.

    Args:
        max_distance: Maximum distance of two descriptions of the same person. A smaller one confuses fewer
            persons, and misses more.
        doublings: How often an image is doubled in size before faces are looked for. Without it, faces of 80
            pixels are found; each one halves that, and makes the search take four times as long.

    Raises:
        FacesMissing: dlib or its models are not installed.
    """

    def __init__(self, max_distance: float = MAX_DISTANCE, doublings: int = 0) -> None:
        self._max_distance = max_distance
        self._doublings = doublings
        try:
            dlib: Any = import_module("dlib")
        except ImportError as error:
            raise FacesMissing(
                "recognition of faces needs dlib: install dlib-bin and face-recognition-models "
                "(extra 'faces')"
            ) from error
        self._detector = dlib.get_frontal_face_detector()
        self._landmarks = dlib.shape_predictor(str(_model("shape_predictor_5_face_landmarks.dat")))
        self._describer = dlib.face_recognition_model_v1(
            str(_model("dlib_face_recognition_resnet_model_v1.dat"))
        )
        self._known: dict[str, list[Description]] = {}

    def examples(self) -> dict[str, int]:
        """Return the number of pictures of each person."""
        return {name: len(examples) for name, examples in self._known.items()}

    def teach(self, name: str, pixels: Pixels, box: Box) -> None:
        """Learn one more picture of a person.

        Raises:
            TeachingError: The name or box cannot be used, there is not exactly one face in the box, or the
                face is another person's whose name is known.
        """
        name = checked_name(name)
        room_for(name, self._known)
        picture = _enlarged(cut_out(pixels, box, MARGIN))
        faces = self._detector(np.ascontiguousarray(picture), 1)
        if not faces:
            raise TeachingError(
                "no face is found in the box: it must be seen from the front, upright and in light"
            )
        if len(faces) > 1:
            raise TeachingError(f"{len(faces)} faces are found in the box: draw it around one of them")
        description = self._describe(picture, faces[0])
        whose, distance = self._nearest(description)
        if whose not in ("", name) and distance <= self._max_distance:
            raise TeachingError(f"this face is known as {whose!r}: forget that name first, or use it")
        self._known[name] = [*self._known.get(name, []), description][-MAX_EXAMPLES:]

    def forget(self, name: str) -> None:
        """Forget a person.

        Raises:
            TeachingError: Nobody has this name.
        """
        if self._known.pop(name, None) is None:
            raise TeachingError(f"nobody is known as {name!r:.80}")

    def find(self, pixels: Pixels) -> list[Sighting]:
        """Return all faces in an image; those of unknown persons have the name ''."""
        found = []
        for face in self._detector(np.ascontiguousarray(pixels), self._doublings):
            box = Box(face.left(), face.top(), face.width(), face.height())
            name, distance = self._nearest(self._describe(pixels, face))
            if distance > self._max_distance:
                found.append(Sighting("", 0.0, box))
            else:
                found.append(Sighting(name, confidence_of(distance, self._max_distance), box))
        return found

    def describe(self, pixels: Pixels) -> list[Description]:
        """Return the descriptions of all faces in an image, each (128,)."""
        return [self._describe(pixels, face) for face in self._detector(np.ascontiguousarray(pixels), 1)]

    def plain(self) -> dict[str, list[Any]]:
        """Return the descriptions of each person."""
        return {name: [one.tolist() for one in examples] for name, examples in self._known.items()}

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take over what `plain` returned.

        Raises:
            TeachingError: It is not what `plain` returns.
        """
        if len(plain) > MAX_NAMES:
            raise TeachingError(f"expected at most {MAX_NAMES} persons")
        self._known = {
            checked_name(name): [_checked(name, one) for one in examples[-MAX_EXAMPLES:]]
            for name, examples in plain.items()
        }

    def _describe(self, pixels: Pixels, face: Any) -> Description:
        pixels = np.ascontiguousarray(pixels)
        return np.array(self._describer.compute_face_descriptor(pixels, self._landmarks(pixels, face)))

    def _nearest(self, description: Description) -> tuple[str, float]:
        """Return the person whose face is most alike, and the distance; ('', infinity) if none is known."""
        return min(
            (
                (name, float(np.linalg.norm(one - description)))
                for name, examples in self._known.items()
                for one in examples
            ),
            key=lambda entry: entry[1],
            default=("", math.inf),
        )


def confidence_of(distance: float, max_distance: float) -> float:
    """Return how sure a match is: 1 at distance 0, and 0.5 at the maximum distance."""
    return 1.0 - 0.5 * distance / max_distance


def _model(name: str) -> Path:
    """Return the path of a model. Importing its package would need the removed `pkg_resources`."""
    spec = find_spec("face_recognition_models")
    folders = [] if spec is None else [Path(one) for one in spec.submodule_search_locations or ()]
    file = next((folder / "models" / name for folder in folders if (folder / "models" / name).exists()), None)
    if file is None:
        raise FacesMissing(
            f"recognition of faces needs {name}: install face-recognition-models (extra 'faces')"
        )
    return file


def _enlarged(picture: Pixels) -> Pixels:
    """Return a picture in which a face is large enough for the detector."""
    times = math.ceil(MIN_FACE_PX / min(picture.shape[:2]))
    return np.ascontiguousarray(picture.repeat(times, axis=0).repeat(times, axis=1))


def _checked(name: str, numbers: Any) -> Description:
    try:
        description = np.array(numbers, float)
    except (TypeError, ValueError) as error:
        raise TeachingError(f"{name!r:.80}: expected {NUMBERS} numbers for each picture") from error
    if description.shape != (NUMBERS,) or not np.isfinite(description).all():
        raise TeachingError(f"{name!r:.80}: expected {NUMBERS} finite numbers for each picture")
    return description
