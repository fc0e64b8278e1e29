"""The pixels of camera images, and images as JPEG."""

import io
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.base.errors import RobbieError
from robbie_mp.messages import Image

if TYPE_CHECKING:
    from PIL import Image as PillowImage

BYTES = {
    "mono8": 1,
    "8UC1": 1,
    "mono16": 2,
    "rgb8": 3,
    "bgr8": 3,
    "8UC3": 3,
    "rgba8": 4,
    "bgra8": 4,
    "16UC1": 2,
    "32FC1": 4,
}
"""Bytes per pixel of each supported encoding."""
DEPTHS = {"16UC1": "u2", "32FC1": "f4"}
"""Encodings of depths, in mm and in m (REP 118), and the type of a pixel."""
FARTHEST, NEAREST = 40, 255
"""Brightness of the farthest and the nearest depth; black is where there is none."""
MAX_FILE_PIXELS = 50_000_000
"""Of a file that is decoded: a small file may hold a huge picture."""
JPEG_ENCODINGS = frozenset({"mono8", "rgb8", "bgr8", "rgba8", "bgra8"})
"""Encodings that JPEG keeps, but for its losses. Others may be depths or numbers of classes."""


class NoPicture(RobbieError, ValueError):
    """A message cannot be shown.

    Example scenarios:
      - an image has an encoding that nobody knows how to show, such as bayer_rggb8
      - an image has too few bytes for its rows and columns
    """


def jpeg(message: Image, quality: int, max_pixels: int = 0) -> bytes:
    """Return an image as a JPEG file. This needs Pillow.

    Args:
        message: the image.
        quality: from 1 to 95.
        max_pixels: larger images are scaled down to this length of their longer side; 0: none is.

    Raises:
        NoPicture: it has another encoding, or is damaged.
    """
    from PIL import Image as PillowImage  # noqa: PLC0415 - an extra

    return _encoded(PillowImage.fromarray(pixels_of(message)), quality, max_pixels)


def encoded_again(data: bytes, quality: int, max_pixels: int) -> bytes:
    """Return a JPEG or PNG file as a JPEG file of another size and quality. This needs Pillow.

    Raises:
        NoPicture: the file is damaged, or its picture is too large.
    """
    return _encoded(_decoded(data, max_pixels), quality, max_pixels)


def pixels_of_file(data: bytes, max_pixels: int) -> NDArray[np.uint8]:
    """Return a JPEG or PNG file as `(rows, columns, 3)` of red, green, blue; uint8. This needs Pillow.

    Args:
        data: the file.
        max_pixels: a JPEG may be decoded in a smaller size, but not below this length of its longer side.

    Raises:
        NoPicture: the file is damaged, or its picture is too large.
    """
    return np.asarray(_decoded(data, max_pixels))


def _decoded(data: bytes, max_pixels: int) -> "PillowImage.Image":
    try:
        with opened(data, ("JPEG", "PNG")) as picture:
            picture.draft("RGB", (max_pixels, max_pixels))  # decodes a JPEG in a smaller size
            return picture.convert("RGB")
    except NoPicture:
        raise
    except (OSError, SyntaxError, ValueError) as error:
        raise NoPicture(f"the picture is damaged: {error}") from None


def opened(data: bytes, formats: tuple[str, ...]) -> "PillowImage.Image":
    """Open a picture's file without reading its pixels yet. This needs Pillow.

    Args:
        data: the file.
        formats: those that it may have, as Pillow names them.

    Raises:
        NoPicture: the picture has more than `MAX_FILE_PIXELS`.
        OSError: it has another format.
    """
    from PIL import Image as PillowImage  # noqa: PLC0415 - an extra

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PillowImage.DecompressionBombWarning)  # the limit here is lower
            picture = PillowImage.open(io.BytesIO(data), formats=formats)
    except PillowImage.DecompressionBombError as error:
        raise NoPicture(str(error)) from None
    if picture.width * picture.height > MAX_FILE_PIXELS:
        raise NoPicture(f"{picture.width} x {picture.height} pixels are too many")
    return picture


def _encoded(picture: "PillowImage.Image", quality: int, max_pixels: int) -> bytes:
    if max_pixels:
        picture.thumbnail((max_pixels, max_pixels), reducing_gap=1.0)
    encoded = io.BytesIO()
    picture.save(encoded, "JPEG", quality=quality)
    return encoded.getvalue()


def pixels_of(message: Image) -> NDArray[np.uint8]:
    """Return an image as `(rows, columns)` of grey or `(rows, columns, 3)` of red, green, blue; uint8.

    In images of 16 bits, the darkest pixel becomes black and the brightest one white. Of depths, the nearest
    is the brightest; black is where none was measured.

    Raises:
        NoPicture: it has another encoding, or is damaged.
    """
    size = BYTES.get(message.encoding)
    if size is None:
        known = ", ".join(BYTES)
        raise NoPicture(f"images encoded as {message.encoding!r} are not shown; expected one of {known}")
    rows, columns, step = message.height, message.width, message.step
    if not rows or not columns or step < columns * size or len(message.data) != rows * step:
        raise NoPicture(f"{columns} x {rows} pixels in rows of {step} do not fit {len(message.data)} bytes")
    pixels = message.data.reshape(rows, step)[:, : columns * size]
    if message.encoding == "mono16":
        return _stretched(np.ascontiguousarray(pixels).view(">u2" if message.is_bigendian else "<u2"))
    if message.encoding in DEPTHS:
        order = ">" if message.is_bigendian else "<"
        return _as_brightness(np.ascontiguousarray(pixels).view(f"{order}{DEPTHS[message.encoding]}"))
    if size == 1:
        return np.ascontiguousarray(pixels)
    pixels = pixels.reshape(rows, columns, size)[:, :, :3]
    return np.ascontiguousarray(pixels[:, :, ::-1] if message.encoding.startswith("bgr") else pixels)


def _stretched(values: NDArray[np.uint16]) -> NDArray[np.uint8]:
    low, high = int(values.min()), int(values.max())
    return ((values - low) * (255.0 / max(1, high - low))).astype(np.uint8)


def _as_brightness(depths: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the brightness of each depth, by its inverse: half of the picture is for what is near."""
    is_measured = np.isfinite(depths) & (depths > 0)
    shown = np.zeros(depths.shape, np.uint8)
    if is_measured.any():
        inverse = 1.0 / depths[is_measured].astype(np.float64)
        low, high = float(inverse.min()), float(inverse.max())
        share = (inverse - low) / (high - low) if high > low else np.ones_like(inverse)
        shown[is_measured] = np.rint(FARTHEST + share * (NEAREST - FARTHEST))
    return shown
