"""A camera's calibration, as ROS's camera_calibration writes it (YAML)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.base.problem import ProfileError
from robbie_mp.base.yaml_reader import read_file

MAX_EDGE_PX = 65_535


class CalibrationError(ValueError):
    """The file is no camera calibration."""


@dataclass(frozen=True)
class Calibration:
    """How a camera projects.

    Attributes:
        width: columns of the images that it holds for.
        height: rows.
        model: of the distortion, as in "plumb_bob".
        distortion: (N,).
        matrix: (3, 3), pixels; all 0: unknown.
        rectification: (3, 3).
        projection: (3, 4).
    """

    width: int
    height: int
    model: str
    distortion: NDArray[np.float64]
    matrix: NDArray[np.float64]
    rectification: NDArray[np.float64]
    projection: NDArray[np.float64]


def unknown(width: int, height: int) -> Calibration:
    """Return a calibration that says nothing."""
    empty = np.zeros((3, 4))
    return Calibration(width, height, "", np.zeros(0), empty[:, :3], np.eye(3), empty)


def ideal(width: int, height: int, field_of_view_rad: float) -> Calibration:
    """Return the calibration of a camera without distortion, from its horizontal field of view."""
    focal = width / 2 / math.tan(field_of_view_rad / 2)
    matrix = np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Calibration(
        width, height, "plumb_bob", np.zeros(5), matrix, np.eye(3), np.hstack([matrix, np.zeros((3, 1))])
    )


def read_calibration(file: Path) -> Calibration:
    """Read a calibration.

    Raises:
        CalibrationError: the file cannot be read, is no calibration, or something is missing in it.

    Example:
        calibration = read_calibration(Path("front.yaml"))
    """
    try:
        told = read_file(file).plain()
    except ProfileError as error:
        raise CalibrationError(str(error)) from error
    if not isinstance(told, dict):
        raise CalibrationError(f"{file} is no camera calibration: it has no entries")
    try:
        return Calibration(
            _edge(told, "image_width"),
            _edge(told, "image_height"),
            str(told["distortion_model"]),
            _numbers(told, "distortion_coefficients"),
            _camera_matrix(told),
            _numbers(told, "rectification_matrix", (3, 3)),
            _numbers(told, "projection_matrix", (3, 4)),
        )
    except KeyError as error:
        raise CalibrationError(f"{file} is no camera calibration: {error.args[0]} is missing") from error
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{file} is no camera calibration: {error}") from error


def _edge(told: dict[str, Any], name: str) -> int:
    value = told[name]
    if type(value) is not int or not 0 < value <= MAX_EDGE_PX:
        raise ValueError(f"{name} must be a whole number from 1 to {MAX_EDGE_PX}, not {value!r:.40}")
    return value


def _camera_matrix(told: dict[str, Any]) -> NDArray[np.float64]:
    """Return the camera's matrix; one that is transposed, or of no camera, would be believed silently."""
    matrix = _numbers(told, "camera_matrix", (3, 3))
    is_camera = matrix[0, 0] > 0 and matrix[1, 1] > 0 and matrix[1, 0] == 0
    if matrix.any() and not (is_camera and matrix[2].tolist() == [0, 0, 1]):
        raise ValueError("camera_matrix must be fx 0 cx, 0 fy cy, 0 0 1 in pixels, fx and fy greater than 0")
    return matrix


def _numbers(told: dict[str, Any], name: str, shape: tuple[int, ...] = (-1,)) -> NDArray[np.float64]:
    try:
        numbers = np.array(told[name]["data"], np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from error
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} has numbers that are not finite")
    return numbers
