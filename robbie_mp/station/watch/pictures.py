"""Pictures for the page: made from the newest message on request, in a thread beside the event loop.

The station notifies the page of a newer picture, and the page fetches it when it has received the last one. A
page with a slow link misses some pictures, and none queue up here.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic

from nicegui import app
from starlette.responses import Response

from robbie_mp.attached.views.image_pixels import NoPicture, jpeg
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.module.envelope import MessageType
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.latest import Latest

JPEG_QUALITY = 80
MAX_PIXELS = 1280
"""Maximum length of a picture's longer side. Larger pictures are scaled down."""
BORN = "X-Robbie-Born"
"""Header with the time at which a picture was taken, s, on the robot's monotonic clock."""
MEDIA_TYPES = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


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
        births: tells when it was taken, which the answer says; None: the answer does not.
    """

    def __init__(
        self,
        latest: Latest[MessageType],
        draw: Callable[[MessageType], Picture],
        births: Births | None = None,
    ):
        self._births = births
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
                born_s = self._births.of(self._latest) if self._births else None
                self._drawn, self._answer = count, answer_with(self._draw, message)
                if born_s is not None:
                    self._answer.headers[BORN] = f"{born_s:.3f}"
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
    return Picture(jpeg(message, JPEG_QUALITY, MAX_PIXELS), "image/jpeg")
