"""What all recognizers of taught things have in common: sightings, errors, limits, and their file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

MAX_NAME = 64  # characters
MAX_NAMES = 32
"""Maximum number of things that one recognizer knows."""
MAX_EXAMPLES = 8
"""Maximum number of examples of each; a further one takes the place of the oldest."""
MAX_FILE_BYTES = 64_000_000
MIN_BOX_PX = 16
"""Minimum width and height of a box that is taught."""

Pixels = NDArray[np.uint8]
"""(height, width, 3), red, green, blue."""


class Box(NamedTuple):
    """A rectangle in an image: pixels right of its left edge and below its upper one."""

    left: float
    top: float
    width: float
    height: float


class Sighting(NamedTuple):
    """Something in an image.

    Attributes:
        name: Its name; '' if it is of the right kind, but has not been taught.
        confidence: 0 … 1.
        box: Where it is.
    """

    name: str
    confidence: float
    box: Box


class TeachingError(ValueError):
    """Something cannot be taught or forgotten as asked; the message says why, and what to do."""


class TaughtFileError(ValueError):
    """A file with what was taught is invalid; the message names the file and what was expected."""


class Recognizer(Protocol):
    """Finds things in images that people have taught it."""

    def examples(self) -> dict[str, int]:
        """Return the number of examples of each name."""

    def teach(self, name: str, pixels: Pixels, box: Box) -> None:
        """Learn one more example of a thing.

        Args:
            name: Its name, which may be known already.
            pixels: The image.
            box: Where the thing is in it.

        Raises:
            TeachingError: The name, the box or what is in it cannot be used.
        """

    def forget(self, name: str) -> None:
        """Forget a thing.

        Raises:
            TeachingError: Nothing has this name.
        """

    def find(self, pixels: Pixels) -> list[Sighting]:
        """Return what is seen in an image."""

    def plain(self) -> dict[str, list[Any]]:
        """Return the examples of each name, as JSON has them."""

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take over what `plain` returned, in place of what is known.

        Raises:
            TeachingError: It is not what `plain` returns.
        """


def checked_name(name: object) -> str:
    """Return a name without spaces around it.

    Raises:
        TeachingError: It is no name.
    """
    stripped = name.strip() if isinstance(name, str) else ""
    if not stripped or not stripped.isprintable() or len(stripped) > MAX_NAME:
        raise TeachingError(f"a name has 1 to {MAX_NAME} printable characters, unlike {name!r:.80}")
    return stripped


def cut_out(pixels: Pixels, box: Box, margin: float = 0.0) -> Pixels:
    """Return the part of an image in a box.

    Args:
        pixels: The image.
        box: The box; what lies outside the image is left out.
        margin: Share of the box's size that is added at each side.

    Raises:
        TeachingError: The box is too small, or its numbers are not finite.
    """
    if not np.isfinite(box).all():
        raise TeachingError("the box has numbers that are not finite")
    height, width = pixels.shape[:2]
    right, bottom = box.left + box.width, box.top + box.height
    inside_px = (min(right, width) - max(box.left, 0.0), min(bottom, height) - max(box.top, 0.0))
    if min(inside_px) < MIN_BOX_PX:
        raise TeachingError(
            f"the box is smaller than {MIN_BOX_PX} x {MIN_BOX_PX} pixels in the image of {width} x {height}: "
            "draw a larger one, or move the camera closer"
        )
    beside_px, above_px = margin * box.width, margin * box.height
    left, top = max(0, int(box.left - beside_px)), max(0, int(box.top - above_px))
    return pixels[top : int(np.ceil(bottom + above_px)), left : int(np.ceil(right + beside_px))]


def room_for(name: str, known: Mapping[str, object]) -> None:
    """Check that there is room for a name.

    Raises:
        TeachingError: There is not.
    """
    if name not in known and len(known) >= MAX_NAMES:
        raise TeachingError(f"{MAX_NAMES} names are known already: forget one first")


def as_json(kind: str, plain: Mapping[str, Any]) -> bytes:
    """Return the file's contents, which `read_taught` reads.

    Args:
        kind: What is taught, such as "objects".
        plain: What `Recognizer.plain` returns.
    """
    return json.dumps({"version": 1, "kind": kind, "taught": plain}, indent=1).encode()


def read_taught(path: Path, kind: str) -> dict[str, list[Any]]:
    """Read what was taught; a file that does not exist has nothing.

    Args:
        path: The file.
        kind: What must be in it.

    Returns:
        The examples of each name, for `Recognizer.restore`, which checks them.

    Raises:
        TaughtFileError: The file cannot be read, is too large, or is another one.
    """
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise TaughtFileError(f"{path}: is larger than {MAX_FILE_BYTES // 1_000_000} MB")
        told = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError, ValueError, RecursionError) as error:
        if isinstance(error, TaughtFileError):
            raise
        raise TaughtFileError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(told, dict) or told.get("version") != 1 or told.get("kind") != kind:
        raise TaughtFileError(f"{path}: expected version 1 and kind {kind!r}")
    taught = told.get("taught")
    if not isinstance(taught, dict) or not all(isinstance(one, list) and one for one in taught.values()):
        raise TaughtFileError(f"{path}: 'taught' must map each name to a list of examples")
    if len(taught) > MAX_NAMES or any(len(one) > MAX_EXAMPLES for one in taught.values()):
        raise TaughtFileError(f"{path}: at most {MAX_NAMES} names with {MAX_EXAMPLES} examples each")
    try:
        return {checked_name(name): examples for name, examples in taught.items()}
    except TeachingError as error:
        raise TaughtFileError(f"{path}: {error}") from error
