"""Pictures for the page: made from the newest message on request, in a thread beside the event loop."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

from nicegui import app
from starlette.responses import Response

from robbie_mp.attached.views.image_pixels import JPEG_ENCODINGS, NoPicture, encoded_again, jpeg
from robbie_mp.messages import CompressedImage, Image
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.latest import Latest

JPEG_QUALITY = 80
MAX_PIXELS = 1280
"""Maximum length of a picture's longer side. Larger pictures are scaled down."""
T = TypeVar("T")
Encode = Callable[[Image | CompressedImage], tuple[bytes, Mapping[str, object]]]
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
            count = self._latest.count
            known = self._encoded.get(grade)
            if known is None or known[0] != count:
                found = self.encode(lambda message: _as_file(message, grade))
                known = self._encoded[grade] = (count, found)
            return known[1]

    @property
    def can_be_video(self) -> bool:
        """Whether the newest image is of colours or brightness, and not of depths or the like."""
        message = self._latest.message
        return isinstance(message, CompressedImage) or (
            message is not None and message.encoding in JPEG_ENCODINGS
        )

    def encode(self, encode: Encode) -> GradedPicture:
        """Return the newest image as a function encodes it. It may take long, so call it in a thread.

        Args:
            encode: returns the data of an image, and what the page must know of them; or raises `NoPicture`.
        """
        message = self._latest.message
        if message is None:
            return GradedPicture(b"", {"reason": "there is none yet", "born_s": None})
        born_s = self._births.of_message(message, self._latest.arrived_s) if self._births else None
        about = {"born_s": born_s, **self._about(message)}
        try:
            data, more = encode(message)
        except NoPicture as error:
            return GradedPicture(b"", {"reason": str(error), **about})
        return GradedPicture(data, {**more, **about})

    def listen(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Call a function with each new image, in the module's thread. Return what ends that."""

        def look(_image: object) -> None:
            wake()

        self._latest.listen(look)
        return lambda: self._latest.ignore(look)


def _as_file(message: Image | CompressedImage, grade: Grade) -> tuple[bytes, Mapping[str, object]]:
    picture = encode_image(message, grade.pixels, grade.quality)
    return picture.data, {"type": picture.media_type}


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
