"""Pictures inside the report: scaled, as data in addresses, and all together bounded. Needs Pillow."""

import base64
import io
import math
import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from robbie_mp.attached.views.image_pixels import NoPicture, jpeg, opened
from robbie_mp.base.linux.regular_file import open_regular
from robbie_mp.messages import CompressedImage, Image, OccupancyGrid

if TYPE_CHECKING:
    pass

MAX_FILE_BYTES = 64 << 20
MAX_SIDE, MAX_MAP_SIDE = 560, 1400
QUALITY = 80
MAX_RESOLUTION_M = 1e3
MAX_BYTES = 12 << 20
"""Of all pictures of a report, encoded."""
FORMATS = ("JPEG", "PNG", "WEBP", "GIF")
"""Those that are read, whatever a file is called: Pillow starts other programs for some further ones."""
DAMAGED = (NoPicture, ImportError, OSError, ValueError, SyntaxError, EOFError, struct.error, zlib.error)
"""What Pillow raises of a picture that is damaged, or if it is missing itself."""
UNKNOWN, FREE, OCCUPIED = (214, 220, 226), (255, 255, 255), (28, 38, 48)


@dataclass(frozen=True)
class MapPicture:
    """A map as a picture, the largest y at the top."""

    address: str
    width: int
    height: int
    metres_per_pixel: float
    origin: tuple[float, float, float]
    """x, y (m) and yaw (rad) of the lower left corner of the picture in the map's frame."""

    def place(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return where a place of the map is in the picture, in pixels from its upper left corner."""
        x0, y0, yaw = self.origin
        dx, dy, cosine, sine = x_m - x0, y_m - y0, math.cos(yaw), math.sin(yaw)
        along, up = cosine * dx + sine * dy, cosine * dy - sine * dx
        return along / self.metres_per_pixel, self.height - up / self.metres_per_pixel


@dataclass
class Pictures:
    """Makes pictures until they need too much space; counts what it leaves out."""

    left_out: dict[str, int] = field(default_factory=dict)
    """Number of pictures that are missing, by reason."""
    size: int = 0
    """Bytes of all pictures so far."""

    def of_message(self, message: Image | CompressedImage) -> str:
        """Return the address of an image; '' if it is left out."""
        try:
            if message.type_name == Image.type_name:
                data = jpeg(message, QUALITY, MAX_SIDE)  # type: ignore[arg-type]
            else:
                data = _scaled(opened(np.asarray(message.data).tobytes(), FORMATS))
        except DAMAGED as error:
            return self._without(_why(error))
        return self._address(data, "jpeg")

    def of_file(self, path: Path) -> str:
        """Return the address of a picture in a file; '' if it is left out."""
        try:
            with open_regular(path) as file:
                data = _scaled(opened(file.read(MAX_FILE_BYTES), FORMATS))
        except DAMAGED as error:
            return self._without(_why(error))
        return self._address(data, "jpeg")

    def of_map(self, grid: OccupancyGrid) -> MapPicture | None:
        """Return the known part of a map; None if it is left out."""
        try:
            from PIL import Image as PillowModule  # noqa: PLC0415 - an extra
        except ImportError as error:
            self._without(_why(error))
            return None
        info = grid.info
        cells = np.asarray(grid.data, np.int8).reshape(info.height, info.width)
        known = cells >= 0
        rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
        if not len(rows) or not 0 < info.resolution < MAX_RESOLUTION_M:
            return None
        top, left = max(0, rows[0] - 3), max(0, columns[0] - 3)
        cut = cells[top : rows[-1] + 4, left : columns[-1] + 4][::-1]
        height, width = cut.shape
        stride = max(1, max(height, width) // (4 * MAX_MAP_SIDE))
        picture = PillowModule.fromarray(_shades()[cut[::stride, ::stride].view(np.uint8)])
        picture.thumbnail((MAX_MAP_SIDE, MAX_MAP_SIDE))
        encoded = io.BytesIO()
        picture.quantize(32).save(encoded, "PNG", optimize=True)
        x_m, y_m = float(left) * info.resolution, float(top) * info.resolution
        position, yaw = info.origin.position, info.origin.orientation.yaw
        origin = (
            position.x + math.cos(yaw) * x_m - math.sin(yaw) * y_m,
            position.y + math.sin(yaw) * x_m + math.cos(yaw) * y_m,
            yaw,
        )
        address = self._address(encoded.getvalue(), "png")
        return MapPicture(address, width, height, info.resolution, origin) if address else None

    def _address(self, data: bytes, kind: str) -> str:
        if self.size + len(data) > MAX_BYTES:
            return self._without(f"all pictures together have at most {MAX_BYTES >> 20} MB")
        self.size += len(data)
        return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"

    def _without(self, reason: str) -> str:
        self.left_out[reason] = self.left_out.get(reason, 0) + 1
        return ""


def _shades() -> NDArray[np.uint8]:
    """Return the colour of each value of a cell, taken as a number without sign: (256, 3)."""
    share = np.minimum(np.arange(128), 100)[:, None] / 100.0
    known = np.round((1 - share) * np.array(FREE) + share * np.array(OCCUPIED)).astype(np.uint8)
    return np.concatenate([known, np.tile(np.array(UNKNOWN, np.uint8), (128, 1))])


def _scaled(picture: Any) -> bytes:
    with suppress(AttributeError):
        picture.draft("RGB", (MAX_SIDE, MAX_SIDE))
    if picture.mode in ("RGBA", "LA", "P", "PA"):
        picture = picture.convert("RGBA")
        white = picture.copy()
        white.paste((255, 255, 255, 255), (0, 0, *picture.size))
        white.alpha_composite(picture)
        picture = white
    picture = picture.convert("RGB")
    picture.thumbnail((MAX_SIDE, MAX_SIDE))
    encoded = io.BytesIO()
    picture.save(encoded, "JPEG", quality=QUALITY)
    return encoded.getvalue()


def _why(error: Exception) -> str:
    if isinstance(error, ImportError):
        return "pictures need Pillow: pip install pillow"
    return str(error) if isinstance(error, NoPicture) else "they are damaged, or of an unknown format"
