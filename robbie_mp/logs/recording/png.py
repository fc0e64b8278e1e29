"""Images of logs as PNG files, made by the library OpenCV."""

import os
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from robbie_mp.logs.recording.errors import LogError
from robbie_mp.messages import CompressedImage, Image, Message

if TYPE_CHECKING:
    from numpy.typing import NDArray

IMAGE_TYPES = (Image.type_name, CompressedImage.type_name)
MAX_PIXELS = 1 << 26
"""Most pixels of a compressed image: a small file may expand to a huge image."""
MILLIMETRES = 1000


class NotPng(LogError, ValueError):
    """A message cannot be written as a PNG file; the text says why.

    Example scenarios:
      - its encoding is not known
      - its data are shorter than its size and encoding say
      - OpenCV is not installed
    """


class _Encoding(NamedTuple):
    """How a pixel is encoded, and how OpenCV converts it for a PNG file."""

    kind: str
    """The numpy type of a value, little-endian."""
    values: int
    """Values of a pixel."""
    conversion: str = ""
    """Name of OpenCV's conversion; '': none is needed."""


def _encodings() -> dict[str, _Encoding]:
    """Return the encodings of ROS (sensor_msgs/image_encodings.hpp)."""
    found = {
        "yuv422": _Encoding("u1", 2, "COLOR_YUV2BGR_UYVY"),
        "uyvy": _Encoding("u1", 2, "COLOR_YUV2BGR_UYVY"),
        "yuv422_yuy2": _Encoding("u1", 2, "COLOR_YUV2BGR_YUY2"),
        "yuyv": _Encoding("u1", 2, "COLOR_YUV2BGR_YUY2"),
        "32FC1": _Encoding("<f4", 1),
    }
    # OpenCV names a Bayer pattern after the second row and the second and third column.
    bayer = {"rggb": "BG", "bggr": "RG", "gbrg": "GR", "grbg": "GB"}
    for bits, kind in ((8, "u1"), (16, "<u2")):
        found |= {
            f"mono{bits}": _Encoding(kind, 1),
            f"bgr{bits}": _Encoding(kind, 3),
            f"rgb{bits}": _Encoding(kind, 3, "COLOR_RGB2BGR"),
            f"bgra{bits}": _Encoding(kind, 4),
            f"rgba{bits}": _Encoding(kind, 4, "COLOR_RGBA2BGRA"),
            f"{bits}UC1": _Encoding(kind, 1),
            f"{bits}UC3": _Encoding(kind, 3),
            f"{bits}UC4": _Encoding(kind, 4),
        }
        for pattern, name in bayer.items():
            found[f"bayer_{pattern}{bits}"] = _Encoding(kind, 1, f"COLOR_Bayer{name}2BGR")
    return found


ENCODINGS = _encodings()


class PngMaker:
    """Makes the content of PNG files.

    Raises:
        NoPicture: OpenCV is not installed.
    """

    def __init__(self) -> None:
        # OpenCV reads it when it is imported; nothing else limits what a compressed image expands to.
        os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MAX_PIXELS))
        try:
            import cv2  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise NotPng("PNG files need OpenCV: pip install opencv-python-headless") from error
        self._cv2: Any = cv2

    def make(self, message: Message) -> bytes:
        """Return the PNG file of an `Image` or `CompressedImage`, of whichever version.

        Values of 8 and 16 bits are kept, Bayer patterns become colours, and depths in metres (32FC1) become
        whole millimetres in 16 bits as in ROS's 16UC1, where 0 says that there is no depth.

        Raises:
            NoPicture: the message is no complete image, or of an unknown encoding.
        """
        if message.type_name == CompressedImage.type_name:
            return self._png(self._decompressed(cast(CompressedImage, message)))
        return self._png(self._pixels(cast(Image, message)))

    def _decompressed(self, image: CompressedImage) -> "NDArray[Any]":
        try:
            found = self._cv2.imdecode(np.asarray(image.data), self._cv2.IMREAD_UNCHANGED)
        except self._cv2.error:  # also beyond MAX_PIXELS
            found = None
        if found is None:
            raise NotPng(f"its {len(image.data)} bytes are no image ({image.format or 'without a format'})")
        return cast("NDArray[Any]", found)

    def _pixels(self, image: Image) -> "NDArray[Any]":
        encoding = ENCODINGS.get(image.encoding)
        if encoding is None:
            raise NotPng(f"encoding {image.encoding!r} is not known")
        kind = np.dtype(encoding.kind).newbyteorder(">" if image.is_bigendian else "<")
        row_bytes = image.width * encoding.values * kind.itemsize
        step = image.step or row_bytes
        data = np.asarray(image.data)
        if not row_bytes or not image.height or step < row_bytes or len(data) < image.height * step:
            raise NotPng(
                f"{len(data)} bytes in rows of {step} are no image of {image.width} x {image.height} pixels "
                f"of {image.encoding}"
            )
        rows = data[: image.height * step].reshape(image.height, step)[:, :row_bytes]
        values = np.ascontiguousarray(rows).view(kind).astype(kind.newbyteorder("="))
        pixels = values.reshape(image.height, image.width, encoding.values)
        if kind.kind == "f":
            return _millimetres(pixels)
        if encoding.conversion:
            try:
                pixels = self._cv2.cvtColor(pixels, getattr(self._cv2, encoding.conversion))
            except self._cv2.error as error:  # such as a Bayer image of one row
                raise NotPng(f"{image.encoding}, {image.width} x {image.height}: {error.err}") from error
        return pixels

    def _png(self, pixels: "NDArray[Any]") -> bytes:
        is_made, data = self._cv2.imencode(".png", pixels)
        if not is_made:
            raise NotPng(f"an array of shape {pixels.shape} cannot be a PNG file")
        return bytes(data)


def _millimetres(metres: "NDArray[Any]") -> "NDArray[Any]":
    """Return depths in whole millimetres; 0 where there is none, or none that fits into 16 bits."""
    depths = np.nan_to_num(metres * MILLIMETRES, nan=0, posinf=0, neginf=0).round()
    return np.where((depths >= 0) & (depths <= 0xFFFF), depths, 0).astype(np.uint16)
