"""Pictures for the page: made from the newest message on request, in a thread beside the event loop."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from nicegui import app
from starlette.responses import Response

from robbie_mp.attached.views.image_pixels import NoPicture, encoded_again, jpeg
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.latest import Latest

JPEG_QUALITY = 80
MAX_PIXELS = 1280
"""Maximum length of a picture's longer side. Larger pictures are scaled down."""
T = TypeVar("T")
MEDIA_TYPES = {b"\xff\xd8\xff": "image/jpeg", b"\x89PN": "image/png"}


@dataclass(frozen=True)
class Picture:
    """A picture in a form that browsers can show."""

    data: bytes
    media_type: str
    headers: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Grade:
    """How a picture is encoded."""

    pixels: int
    """Maximum length of its longer side."""
    quality: int
    """Of JPEG, 1 to 95."""
    typical: float
    """Its size, beside other grades of the same picture."""


@dataclass(frozen=True)
class GradedPicture:
    """A camera's picture in one grade, or why there is none."""

    data: bytes
    about: Mapping[str, object]
    """For the page: `type` of media, or `reason`; when it was taken on the robot's clock, `born_s`; more."""


class NewestPicture:
    """The newest image of a camera, encoded in each grade once for all pages.

    Args:
        latest: holder of the newest image.
        births: tells when it was taken; None: the answer does not.
        about: returns what else a page needs to know of an image.
    """

    def __init__(
        self,
        latest: Latest[Image | CompressedImage],
        births: Births | None = None,
        about: Callable[[Image | CompressedImage], Mapping[str, object]] | None = None,
    ):
        self._births = births
        self._about = about or (lambda _image: {})
        self._latest = latest
        self._lock = threading.Lock()
        self._encoded: dict[Grade, tuple[int, GradedPicture]] = {}

    @property
    def count(self) -> int:
        """Number of the images so far."""
        return self._latest.count

    def encoded(self, grade: Grade) -> GradedPicture:
        """Return the newest image in a grade. It may take long, so call it in a thread."""
        with self._lock:
            count, message = self._latest.count, self._latest.message
            known = self._encoded.get(grade)
            if known is None or known[0] != count:
                born_s = self._births.of(self._latest) if self._births else None
                more = {} if message is None else self._about(message)
                known = self._encoded[grade] = (count, graded(message, grade, {"born_s": born_s, **more}))
            return known[1]

    def listen(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Call a function with each new image, in the module's thread. Return what ends that."""

        def look(_image: object) -> None:
            wake()

        self._latest.listen(look)
        return lambda: self._latest.ignore(look)


def graded(
    message: Image | CompressedImage | None, grade: Grade, about: Mapping[str, object]
) -> GradedPicture:
    """Return an image in a grade, or the reason why there is none, with what else is known about it."""
    try:
        if message is None:
            raise NoPicture("there is none yet")
        picture = encode_image(message, grade.pixels, grade.quality)
    except NoPicture as error:
        return GradedPicture(b"", {"reason": str(error), **about})
    return GradedPicture(picture.data, {"type": picture.media_type, **about})


def answer_with(draw: Callable[[T], Picture], message: T) -> Response:
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


def encode_image(
    message: Image | CompressedImage, max_pixels: int = MAX_PIXELS, quality: int = JPEG_QUALITY
) -> Picture:
    """Return a camera's image as JPEG. JPEG and PNG images are changed only if that makes them smaller.

    Args:
        message: the image.
        max_pixels: maximum length of the picture's longer side.
        quality: from 1 to 95.

    Raises:
        NoPicture: it has another encoding, or is damaged.
    """
    if isinstance(message, Image):
        return Picture(jpeg(message, quality, max_pixels), "image/jpeg")
    data = message.data.tobytes()
    media_type = MEDIA_TYPES.get(data[:3])
    if media_type is None:
        raise NoPicture(f"the format {message.format!r} is neither jpeg nor png")
    smaller = b"" if quality >= JPEG_QUALITY else encoded_again(data, quality, max_pixels)
    return Picture(smaller, "image/jpeg") if 0 < len(smaller) < len(data) else Picture(data, media_type)
