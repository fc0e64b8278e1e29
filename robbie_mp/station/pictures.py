"""Pictures for the page: made from the newest message on request, in a thread beside the event loop.

The station notifies the page of a newer picture, and the page fetches it when it has received the last one. A
page with a slow link misses some pictures, and none queue up here.
"""

import io
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic

import numpy as np
from nicegui import app
from numpy.typing import NDArray
from PIL import Image as PillowImage
from starlette.responses import Response

from robbie_mp.errors import RobbieError
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.module.envelope import MessageType
from robbie_mp.station.latest import Latest

JPEG_QUALITY = 80
MAX_PIXELS = 1280
"""Maximum length of a picture's longer side. Larger pictures are scaled down."""
BYTES = {"mono8": 1, "8UC1": 1, "mono16": 2, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
"""Bytes per pixel of each supported encoding."""
MEDIA_TYPES = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


class NoPicture(RobbieError, ValueError):
    """A message cannot be shown.

    Example scenarios:
      - an image has an encoding that browsers cannot show, such as 16UC1
      - an image has too few bytes for its rows and columns
    """


@dataclass(frozen=True)
class Picture:
    """A picture in a form that browsers can show."""

    data: bytes
    media_type: str
    headers: Mapping[str, str] = field(default_factory=dict)


class NewestPicture(Generic[MessageType]):
    """Makes a picture from the newest message, once for all pages.

    Args:
        latest: holder of the newest message.
        draw: makes the picture, or raises NoPicture.
    """

    def __init__(self, latest: Latest[MessageType], draw: Callable[[MessageType], Picture]):
        self._latest = latest
        self._draw = draw
        self._lock = threading.Lock()
        self._drawn = 0
        self._answer = no_picture("there is none yet")

    def answer(self) -> Response:
        """Answer a request. Runs in a separate thread, and may block."""
        with self._lock:
            count, message = self._latest.count, self._latest.message
            if message is not None and count != self._drawn:
                self._drawn, self._answer = count, answer_with(self._draw, message)
            return self._answer


def answer_with(draw: Callable[[MessageType], Picture], message: MessageType) -> Response:
    """Return an answer with a message's picture, or with the reason why there is none."""
    try:
        picture = draw(message)
    except NoPicture as error:
        return no_picture(str(error))
    headers = {"Cache-Control": "no-store", **picture.headers}
    return Response(picture.data, media_type=picture.media_type, headers=headers)


def no_picture(reason: str) -> Response:
    """Return the answer that there is no picture, with a status that browsers do not report as an error."""
    return Response(status_code=204, headers={"X-Robbie-Reason": reason.encode("ascii", "replace").decode()})


def serve_pictures(path: str, answer: Callable[..., Response]) -> None:
    """Answer requests for a path in threads. Parts of the path in braces are arguments of `answer`."""
    app.add_api_route(path, answer, include_in_schema=False, response_class=Response)


def encode_image(message: Image | CompressedImage) -> Picture:
    """Return a camera's image as JPEG. JPEG and PNG images are not changed.

    Raises:
        NoPicture: it has another encoding, or is damaged.
    """
    if isinstance(message, CompressedImage):
        data = message.data.tobytes()
        media_type = MEDIA_TYPES.get(data[:3])
        if media_type is None:
            raise NoPicture(f"the format {message.format!r} is neither jpeg nor png")
        return Picture(data, media_type)
    picture = PillowImage.fromarray(pixels_of(message))
    picture.thumbnail((MAX_PIXELS, MAX_PIXELS), reducing_gap=1.0)
    encoded = io.BytesIO()
    picture.save(encoded, "JPEG", quality=JPEG_QUALITY)
    return Picture(encoded.getvalue(), "image/jpeg")


def pixels_of(message: Image) -> NDArray[np.uint8]:
    """Return an image as `(rows, columns)` of grey or `(rows, columns, 3)` of red, green, blue; uint8.

    In images of 16 bits, the darkest pixel becomes black and the brightest one white.

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
    if size == 1:
        return np.ascontiguousarray(pixels)
    pixels = pixels.reshape(rows, columns, size)[:, :, :3]
    return np.ascontiguousarray(pixels[:, :, ::-1] if message.encoding.startswith("bgr") else pixels)


def _stretched(values: NDArray[np.uint16]) -> NDArray[np.uint8]:
    low, high = int(values.min()), int(values.max())
    return ((values - low) * (255.0 / max(1, high - low))).astype(np.uint8)
