"""Find victims in camera images by the tags on their chests, and measure the tags' poses from the camera.

The tags are ArUco markers, dictionary 4x4_50 (Garrido-Jurado et al., "Automatic generation and detection of
highly reliable fiducial markers under occlusion", Pattern Recognition 2014). OpenCV detects them. Their known
size gives their pose (Collins and Bartoli, "Infinitesimal plane-based pose estimation", IJCV 2014).
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

AROUND = 2.0  # size of the image patch, as a multiple of the tag's size


class VisionMissing(ImportError):
    """OpenCV is not installed."""


@dataclass(frozen=True)
class Projection:
    """The projection of a camera without distortion.

    Attributes:
        focal_px: focal length in columns and rows.
        centre_px: column and row of the optical axis.
    """

    focal_px: tuple[float, float]
    centre_px: tuple[float, float]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Return the camera matrix (3, 3)."""
        (fx, fy), (cx, cy) = self.focal_px, self.centre_px
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class TagSighting:
    """A tag in one image.

    Attributes:
        tag: its number.
        position_m: (3,), its middle in the camera's optical frame: x right, y down, z ahead.
        normal: (3,), unit vector out of its front, optical frame.
        edge_px: mean length of its edges in the image.
        corners_px: (4, 2), columns and rows of its corners in the image.
        patch: (rows, columns, 3) uint8, the part of the image around it.
    """

    tag: int
    position_m: NDArray[np.float64]
    normal: NDArray[np.float64]
    edge_px: float
    corners_px: NDArray[np.float32]
    patch: NDArray[np.uint8]


class VictimDetector:
    """Finds tags in images.

    Args:
        tag_edge_m: edge of a tag, including its black border.
        min_edge_px: the detector ignores smaller tags.

    Raises:
        VisionMissing: OpenCV is not installed.
    """

    def __init__(self, tag_edge_m: float = 0.25, min_edge_px: float = 12.0) -> None:
        try:
            cv2: Any = import_module("cv2")  # only needed for victim detection
        except ImportError as error:
            raise VisionMissing(
                "victim detection needs OpenCV: install opencv-python-headless (extra 'vision')"
            ) from error
        cv2.setNumThreads(1)  # leave the robot's other processor cores free
        self._cv2 = cv2
        parameters = cv2.aruco.DetectorParameters()
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        parameters.cornerRefinementWinSize = 3
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        self._detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        self._min_edge_px = min_edge_px
        half = tag_edge_m / 2
        # Clockwise from the upper left, seen from the front: the detector's order.
        self._corners_m = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])

    def detect(self, pixels: NDArray[np.uint8], projection: Projection) -> list[TagSighting]:
        """Return the tags in an image.

        Args:
            pixels: (height, width, 3) uint8, red, green, blue.
            projection: the camera's projection.
        """
        grey = self._cv2.cvtColor(pixels, self._cv2.COLOR_RGB2GRAY)
        found, tags, _ = self._detector.detectMarkers(grey)
        if tags is None:
            return []
        sightings = []
        for corners, tag in zip(found, np.ravel(tags).tolist(), strict=True):
            sighting = self._locate(int(tag), corners.reshape(4, 2), pixels, projection.matrix)
            if sighting is not None:
                sightings.append(sighting)
        return sightings

    def _locate(
        self,
        tag: int,
        corners_px: NDArray[np.float32],
        pixels: NDArray[np.uint8],
        matrix: NDArray[np.float64],
    ) -> TagSighting | None:
        edge_px = float(np.hypot(*(corners_px - np.roll(corners_px, 1, axis=0)).T).mean())
        if edge_px < self._min_edge_px:
            return None
        solved, turn, position = self._cv2.solvePnP(
            self._corners_m, corners_px.astype(float), matrix, None, flags=self._cv2.SOLVEPNP_IPPE_SQUARE
        )
        if not solved:
            return None
        normal = self._cv2.Rodrigues(turn)[0][:, 2]
        return TagSighting(tag, position.ravel(), normal, edge_px, corners_px, _patch(pixels, corners_px))


def _patch(pixels: NDArray[np.uint8], corners_px: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Cut the surroundings of a tag out of the image."""
    middle = corners_px.mean(axis=0)
    half = np.abs(corners_px - middle).max() * AROUND
    height, width = pixels.shape[:2]
    left, top = np.clip((middle - half).astype(int), 0, [width - 1, height - 1])
    right, bottom = np.clip((middle + half).astype(int) + 1, 1, [width, height])
    return pixels[top:bottom, left:right].copy()
