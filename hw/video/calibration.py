"""A camera's calibration, as ROS's camera_calibration writes it (YAML)."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray


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
        CalibrationError: the file is no calibration, or something is missing in it.
        OSError: it cannot be read.

    Example:
        calibration = read_calibration(Path("front.yaml"))
    """
    try:
        told = yaml.safe_load(file.read_text())
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{file} is no YAML: {error}") from error
    if not isinstance(told, dict):
        raise CalibrationError(f"{file} is no camera calibration: it has no entries")
    try:
        return Calibration(
            int(told["image_width"]),
            int(told["image_height"]),
            str(told["distortion_model"]),
            _numbers(told, "distortion_coefficients"),
            _numbers(told, "camera_matrix", (3, 3)),
            _numbers(told, "rectification_matrix", (3, 3)),
            _numbers(told, "projection_matrix", (3, 4)),
        )
    except KeyError as error:
        raise CalibrationError(f"{file} is no camera calibration: {error.args[0]} is missing") from error
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{file} is no camera calibration: {error}") from error


def _numbers(told: dict[str, Any], name: str, shape: tuple[int, ...] = (-1,)) -> NDArray[np.float64]:
    try:
        numbers = np.array(told[name]["data"], np.float64).reshape(shape)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: {error}") from error
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} has numbers that are not finite")
    return numbers
