"""Recognizes flat and boxy objects by what is printed on them, after one picture of each.

Features are SIFT (Lowe, "Distinctive image features from scale-invariant keypoints", IJCV 2004) with the
square roots of their normalized histograms (Arandjelović and Zisserman, "Three things everyone should know
to improve object retrieval", CVPR 2012). Each taught picture is also described as it would look from four
sides (Morel and Yu, "ASIFT", 2009), because SIFT by itself stands only some 40° of a turn. Matches pass
Lowe's ratio test; a homography, or with few matches an affine map, must explain enough of them (RANSAC;
Fischler and Bolles, CACM 1981).
"""

import base64
import binascii
import math
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
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

MAX_EDGE_PX = 320
"""Larger taught pictures are scaled down to this length of their longer edge."""
MAX_FEATURES = 1200  # of an image
MAX_VIEW_FEATURES = 250  # of one view of a taught picture
MIN_FEATURES = 20
"""Minimum number of features of a taught picture; with fewer, the object could not be told from others."""
TILT = 2.0
"""An object turned by 60° looks narrower by this factor. Views are made with this tilt to four sides."""
RATIO = 0.8
"""A match is used if the next best feature is at least 1 / RATIO as far away."""
TOLERANCE_PX = 4.0
MIN_INLIERS = 12
MIN_INLIERS_AFFINE = 10
MIN_SHARE = 0.3
"""Minimum share of an object's matches that the map from its picture to the image must explain."""
MAX_TRIES = 700
"""Maximum number of samples of matches. With this share, 650 find four right ones with probability 0.995."""
MIN_SPREAD = 0.15
"""Minimum share of the taught picture on which these matches lie: one equal letter is not enough."""
MIN_AREA_PX = 300.0
MAX_STRETCH = 5.0
"""Maximum ratio of the lengths of opposite sides, and of the scales of both directions."""

Places = NDArray[np.float32]
"""(N, 2), columns and rows."""
Features = tuple[Places, NDArray[np.float32]]
"""Places, and descriptors (N, 128) of length 1."""
Fit = tuple[NDArray[np.float64] | None, NDArray[np.bool_]]
"""The map (3, 3) from a taught picture to an image, and which matches agree with it."""


class ObjectsMissing(ImportError):
    """OpenCV is not installed."""


@dataclass(frozen=True)
class _Example:
    """A taught picture.

    Attributes:
        png: The picture.
        size_px: Its width and height.
        places: (N, 2), of the features of all its views, in the picture.
        descriptors: (N, 128).
    """

    png: bytes
    size_px: tuple[int, int]
    places: Places
    descriptors: NDArray[np.float32]


class ObjectRecognizer:
    """Finds objects in images.

    Raises:
        ObjectsMissing: OpenCV is not installed.
    """

    def __init__(self) -> None:
        try:
            self._cv2: Any = import_module("cv2")
        except ImportError as error:
            raise ObjectsMissing(
                "recognition of objects needs OpenCV: install opencv-python-headless (extra 'vision')"
            ) from error
        self._cv2.setNumThreads(1)  # leave the robot's other processor cores free
        self._sift = self._cv2.SIFT_create(nfeatures=MAX_FEATURES)
        self._view_sift = self._cv2.SIFT_create(nfeatures=MAX_VIEW_FEATURES)
        self._known: dict[str, list[_Example]] = {}

    def examples(self) -> dict[str, int]:
        """Return the number of pictures of each object."""
        return {name: len(examples) for name, examples in self._known.items()}

    def teach(self, name: str, pixels: Pixels, box: Box) -> None:
        """Learn one more picture of an object.

        Raises:
            TeachingError: The name or box cannot be used, or too few features are in the box.
        """
        name = checked_name(name)
        room_for(name, self._known)
        example = self._example(cut_out(pixels, box))
        self._known[name] = [*self._known.get(name, []), example][-MAX_EXAMPLES:]

    def forget(self, name: str) -> None:
        """Forget an object.

        Raises:
            TeachingError: No object has this name.
        """
        if self._known.pop(name, None) is None:
            raise TeachingError(f"no object is known as {name!r:.80}")

    def find(self, pixels: Pixels) -> list[Sighting]:
        """Return each known object that is seen in an image, once; the surest first."""
        if not self._known:
            return []
        seen = self._features(self._sift, self._grey(pixels))
        if len(seen[0]) < MIN_INLIERS_AFFINE:
            return []
        found = []
        for name, examples in self._known.items():
            sightings = [self._sighting(name, one, seen, pixels.shape[:2]) for one in examples]
            best = max((one for one in sightings if one), key=lambda one: one.confidence, default=None)
            if best is not None:
                found.append(best)
        return sorted(found, key=lambda one: -one.confidence)

    def plain(self) -> dict[str, list[Any]]:
        """Return the pictures of each object, as PNG in base64."""
        return {
            name: [base64.b64encode(one.png).decode() for one in examples]
            for name, examples in self._known.items()
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take over what `plain` returned.

        Raises:
            TeachingError: It is not what `plain` returns.
        """
        if len(plain) > MAX_NAMES:
            raise TeachingError(f"expected at most {MAX_NAMES} objects")
        self._known = {
            checked_name(name): [self._example(self._decoded(name, one)) for one in examples[-MAX_EXAMPLES:]]
            for name, examples in plain.items()
        }

    def _decoded(self, name: str, text: Any) -> Pixels:
        try:
            data = base64.b64decode(text, validate=True)
        except (TypeError, ValueError, binascii.Error) as error:
            raise TeachingError(f"{name!r:.80}: expected pictures as PNG in base64") from error
        # The size is in the header of a PNG. Without this look, a small file could ask for gigabytes.
        width, height = (int.from_bytes(data[at : at + 4], "big") for at in (16, 20))
        if not data.startswith(b"\x89PNG") or not 0 < max(width, height) <= MAX_EDGE_PX:
            raise TeachingError(f"{name!r:.80}: expected PNG pictures of at most {MAX_EDGE_PX} pixels")
        pixels = self._cv2.imdecode(np.frombuffer(data, np.uint8), self._cv2.IMREAD_GRAYSCALE)
        if pixels is None:
            raise TeachingError(f"{name!r:.80}: a picture is damaged")
        return np.asarray(pixels, np.uint8)

    def _grey(self, pixels: Pixels) -> Pixels:
        if pixels.ndim == 2:
            return np.ascontiguousarray(pixels)
        return np.asarray(self._cv2.cvtColor(np.ascontiguousarray(pixels), self._cv2.COLOR_RGB2GRAY))

    def _example(self, pixels: Pixels) -> _Example:
        grey = self._grey(pixels)
        scale = MAX_EDGE_PX / max(grey.shape)
        if scale < 1.0:
            grey = self._cv2.resize(grey, None, fx=scale, fy=scale, interpolation=self._cv2.INTER_AREA)
        height, width = grey.shape
        places, descriptors = zip(*(self._features_of_view(grey, *view) for view in VIEWS), strict=True)
        if len(places[0]) < MIN_FEATURES:
            raise TeachingError(
                f"only {len(places[0])} features are in the box, and {MIN_FEATURES} are needed: show a side "
                "with print or pattern, from closer, or draw the box around more of it"
            )
        _, png = self._cv2.imencode(".png", grey)
        return _Example(png.tobytes(), (width, height), np.concatenate(places), np.concatenate(descriptors))

    def _features_of_view(self, grey: Pixels, tilt: float, direction_rad: float) -> Features:
        """Return the features of a picture as seen from a side, at their places in the picture itself."""
        if tilt == 1.0:
            return self._features(self._view_sift, grey)
        height, width = grey.shape
        along, across = math.cos(direction_rad), math.sin(direction_rad)
        turn = np.array([[along, across], [-across, along]])
        # What gets narrow is smoothed first, as a camera does.
        spread = 0.8 * math.sqrt(tilt * tilt - 1.0)
        smooth = self._cv2.GaussianBlur(
            grey, (0, 0), spread * abs(along) + 0.01, None, spread * abs(across) + 0.01
        )
        map_2x2 = np.diag([1.0 / tilt, 1.0]) @ turn
        corners = map_2x2 @ np.array([[0, width, width, 0], [0, 0, height, height]], float)
        low, high = corners.min(axis=1), corners.max(axis=1)
        affine = np.column_stack([map_2x2, -low])
        size = tuple(int(one) + 1 for one in high - low)
        seen = self._cv2.warpAffine(smooth, affine, size, borderMode=self._cv2.BORDER_REPLICATE)
        mask = self._cv2.warpAffine(np.full_like(grey, 255), affine, size)
        mask = self._cv2.erode(mask, np.ones((9, 9), np.uint8))
        places, descriptors = self._features(self._view_sift, seen, mask)
        back = np.linalg.inv(map_2x2)
        return ((places + low) @ back.T).astype(np.float32), descriptors

    def _features(self, sift: Any, grey: Pixels, mask: Pixels | None = None) -> Features:
        keypoints, descriptors = sift.detectAndCompute(grey, mask)
        if descriptors is None:
            return np.empty((0, 2), np.float32), np.empty((0, 128), np.float32)
        places = np.array([one.pt for one in keypoints], np.float32).reshape(-1, 2)
        rooted = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
        return places, np.asarray(rooted, np.float32)

    def _sighting(
        self, name: str, example: _Example, seen: Features, size: tuple[int, ...]
    ) -> Sighting | None:
        taught, places = _matches(example, seen)
        if len(taught) < MIN_INLIERS_AFFINE:
            return None
        for fit, needed in ((self._homography, MIN_INLIERS), (self._affine, MIN_INLIERS_AFFINE)):
            if len(taught) < needed:
                continue
            found, agrees = fit(taught, places)
            inliers = int(agrees.sum())
            if found is None or inliers < max(needed, MIN_SHARE * len(taught)):
                continue
            area_px = self._cv2.contourArea(self._cv2.convexHull(taught[agrees]))
            if area_px < MIN_SPREAD * example.size_px[0] * example.size_px[1]:
                continue
            corners = _corners(found, example.size_px)
            if corners is not None and _is_possible(corners, example.size_px):
                return Sighting(name, confidence_of(inliers), _box(corners, size))
        return None

    def _homography(self, taught: Places, places: Places) -> Fit:
        found, mask = self._cv2.findHomography(
            taught, places, self._cv2.USAC_PROSAC, TOLERANCE_PX, maxIters=MAX_TRIES
        )
        return found, _agreeing(mask, len(taught))

    def _affine(self, taught: Places, places: Places) -> Fit:
        found, mask = self._cv2.estimateAffine2D(
            taught, places, method=self._cv2.RANSAC, ransacReprojThreshold=TOLERANCE_PX, maxIters=MAX_TRIES
        )
        whole = None if found is None else np.vstack([found, [0.0, 0.0, 1.0]])
        return whole, _agreeing(mask, len(taught))


VIEWS = ((1.0, 0.0), *((TILT, math.radians(degrees)) for degrees in (0.0, 45.0, 90.0, 135.0)))
"""Tilt and direction (rad) of each view of a taught picture; the first one is the picture itself."""


def confidence_of(inliers: int) -> float:
    """Return how sure a sighting is by the number of features that agree: 0.63 for 10, 0.86 for 20."""
    return 1.0 - math.exp(-inliers / 10.0)


def _agreeing(mask: Any, count: int) -> NDArray[np.bool_]:
    """Return which matches agree, (M,), from OpenCV's mask; none without a mask."""
    return np.zeros(count, bool) if mask is None else np.asarray(mask.ravel() > 0)


def _matches(example: _Example, seen: Features) -> tuple[Places, Places]:
    """Return the places of matched features in the taught picture and in the image, (M, 2) each."""
    places, descriptors = seen
    likeness = example.descriptors @ descriptors.T
    best = likeness.argmax(axis=1)
    rows = np.arange(len(best))
    nearest = likeness[rows, best]
    likeness[rows, best] = -1.0
    second = likeness.max(axis=1)
    distance, next_distance = 2.0 - 2.0 * nearest, 2.0 - 2.0 * second
    good = np.flatnonzero(distance < RATIO**2 * next_distance)
    # Several views may match one place of the image: the best of them counts.
    order = good[np.argsort(distance[good], kind="stable")]
    _, first = np.unique(best[order], return_index=True)
    kept = order[np.sort(first)]
    return example.places[kept], places[best[kept]]


def _corners(found: NDArray[np.float64], size_px: tuple[int, int]) -> NDArray[np.float64] | None:
    """Return the corners of a taught picture in the image, (4, 2), or None if one lies behind the camera."""
    width, height = size_px
    corners = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], float) @ found.T
    if not np.isfinite(corners).all() or (corners[:, 2] * corners[0, 2] <= 1e-9).any():
        return None
    return np.asarray(corners[:, :2] / corners[:, 2:])


def _is_possible(corners: NDArray[np.float64], size_px: tuple[int, int]) -> bool:
    """Return whether a flat thing can look like this: convex, not mirrored, not too small or narrow."""
    edges = np.roll(corners, -1, axis=0) - corners
    following = np.roll(edges, -1, axis=0)
    turns = edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]
    lengths = np.linalg.norm(edges, axis=1)
    if (turns <= 0).any() or lengths.min() < 1.0 or turns.sum() / 4 < MIN_AREA_PX:
        return False
    ends = [max(one, other) / min(one, other) for one, other in zip(lengths[:2], lengths[2:], strict=True)]
    across, down = lengths[0] / size_px[0], lengths[1] / size_px[1]
    return bool(max(*ends, across / down, down / across) <= MAX_STRETCH)


def _box(corners: NDArray[np.float64], size: tuple[int, ...]) -> Box:
    """Return the rectangle around corners, within an image of `size` rows and columns."""
    limits = np.array([size[1], size[0]], float)
    low, high = np.clip(corners.min(axis=0), 0, limits), np.clip(corners.max(axis=0), 0, limits)
    left, top = low.tolist()
    width, height = (high - low).tolist()
    return Box(left, top, width, height)
