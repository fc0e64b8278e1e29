"""The pictures of a camera as H.264 for one page: each is the change since the one before (PyAV).

A picture is encoded only when the network has room for it, and the connection loses none. So each one builds
on the picture that the page has shown before it.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from robbie_mp.attached.views.image_pixels import pixels_of, pixels_of_file
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.extras import how_to_install
from robbie_mp.messages import CompressedImage, Image

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext
    from numpy.typing import NDArray

RATE_HZ = 10
"""Pictures a second for which the encoder counts its bits: each gets its share, however late it is."""
KEY_PERIOD = 50
"""Maximum number of pictures from one that stands alone to the next."""
BURST = 2
"""A picture may be as large as this number of average ones."""
FINEST = 18
"""The lowest quantizer: below it, a still scene would fill the network with what nobody sees."""
SD_VIDEO = {"colorspace": 6, "color_range": 1, "color_primaries": 6, "color_trc": 6}
"""The colours of the conversion from RGB, by the numbers of ITU-T H.273; browsers would guess others."""
MAX_STREAMS = 4
"""Maximum number of streams at once, because each is encoded for one page only. Further pages get JPEG."""
MAX_REASON = 200


class VideoFailed(RobbieError, RuntimeError):
    """A picture cannot be encoded as H.264.

    Example scenarios:
      - a picture is a million times as wide as it is high
      - memory is short
    """


class NoEncoder(VideoFailed):
    """The robot cannot encode H.264 at all.

    Example scenarios:
      - PyAV is not installed
      - PyAV was built without libx264
    """


@dataclass(frozen=True)
class VideoGrade:
    """How a stream is encoded."""

    pixels: int
    """Maximum length of a picture's longer side."""
    typical: float
    """Maximum size of a picture on average, kB."""


VIDEO_GRADES = (
    VideoGrade(1280, 40.0),
    VideoGrade(960, 26.0),
    VideoGrade(640, 17.0),
    VideoGrade(640, 12.0),
    VideoGrade(640, 8.0),
    VideoGrade(640, 5.5),
    VideoGrade(480, 3.7),
    VideoGrade(480, 2.5),
    VideoGrade(320, 1.7),
)
"""From the best to the coarsest that one can drive by."""


class VideoStream:
    """Encodes one picture after the other. The first one stands alone, as does one of another size or grade.

    Args:
        camera: name of the camera.
        decoder: the page's number of the decoder, so that no other one gets these pictures.
    """

    def __init__(self, camera: str, decoder: int):
        self.camera, self.decoder = camera, decoder
        self._encoder: VideoCodecContext | None = None
        self._made_for: tuple[VideoGrade, int, int] | None = None
        self._count = 0

    def encode(self, image: Image | CompressedImage, grade: VideoGrade) -> tuple[bytes, Mapping[str, object]]:
        """Encode the next picture. It takes some milliseconds, so call it in a thread.

        Returns:
            The picture (Annex B), and what the page's decoder must know of it.

        Raises:
            NoPicture: the image has another encoding, or is damaged.
            VideoFailed: it cannot be encoded.
            NoEncoder: nothing can.
        """
        try:
            import av  # noqa: PLC0415 - an extra
        except ImportError:
            raise NoEncoder(f"PyAV is missing: {how_to_install('video')}") from None
        if isinstance(image, Image):
            pixels = pixels_of(image)
        else:
            pixels = pixels_of_file(image.data.tobytes(), grade.pixels)
        rows, columns = pixels.shape[:2]
        share = min(1.0, grade.pixels / max(rows, columns))
        width, height = _even(share * columns), _even(share * rows)
        pixels = _reduced(pixels, int(1.0 / share))
        try:
            if self._encoder is None or self._made_for != (grade, width, height):
                self._encoder, self._made_for = _encoder(grade, width, height), (grade, width, height)
            frame = av.VideoFrame.from_ndarray(pixels, "gray" if pixels.ndim == 2 else "rgb24")
            frame = frame.reformat(width, height, "yuv420p", interpolation="AREA", threads=1)
            frame.pts = self._count
            (packet,) = self._encoder.encode(frame)
        except (av.FFmpegError, ValueError) as error:
            raise VideoFailed(f"{width} x {height} pixels cannot be encoded: {error}") from error
        video = {"decoder": self.decoder, "number": self._count, "is_key": packet.is_keyframe}
        self._count += 1
        return bytes(packet), {"video": video}


class VideoStreams:
    """The streams of all pages: few at once. The page server's thread uses it.

    Args:
        log: gets why pages get JPEG; its rate should be limited.

    Attributes:
        failures: number of decoders of pages, and of encoders, that failed.
    """

    def __init__(self, log: logging.Logger):
        self._log = log
        self._open: set[VideoStream] = set()
        self._can_encode = True
        self.failures = 0

    def open(self, camera: str, decoder: int) -> VideoStream | None:
        """Begin a stream; None: the page must do with JPEG."""
        if not self._can_encode or len(self._open) >= MAX_STREAMS:
            return None
        stream = VideoStream(camera, decoder)
        self._open.add(stream)
        return stream

    def close(self, stream: VideoStream) -> None:
        """End a stream."""
        self._open.discard(stream)

    @property
    def why_not(self) -> str:
        """What a page without a stream should say; '' if there is room, or the robot has no video."""
        is_full = self._can_encode and len(self._open) >= MAX_STREAMS
        return f"JPEG: {MAX_STREAMS} other pages have the video" if is_full else ""

    def failed(self, error: VideoFailed) -> None:
        """Count an encoder that failed; if there is none, begin no more streams, and say so once."""
        if not isinstance(error, NoEncoder):
            self.failures += 1
            self._log.warning("a page shows JPEG, because its video cannot be encoded: %s", error)
        elif self._can_encode:
            self._can_encode = False
            self._log.info("the page's video is JPEG: %s", error)

    def page_failed(self, reason: str) -> None:
        """Count a decoder of a page that failed."""
        self.failures += 1
        self._log.warning("a page shows JPEG, because it cannot decode its video: %.*r", MAX_REASON, reason)


def _reduced(pixels: NDArray[np.uint8], factor: int) -> NDArray[np.uint8]:
    """Return the averages of squares of pixels. PyAV would copy them all under the interpreter's lock."""
    from PIL import Image as PillowImage  # noqa: PLC0415 - an extra

    return pixels if factor < 2 else np.asarray(PillowImage.fromarray(pixels).reduce(factor))


def _even(length: float) -> int:
    return max(2, 2 * round(length / 2))


def _encoder(grade: VideoGrade, width: int, height: int) -> VideoCodecContext:
    import av  # noqa: PLC0415 - an extra

    try:
        made = av.CodecContext.create("libx264", "w")
    except (av.FFmpegError, ValueError) as error:
        raise NoEncoder(f"PyAV has no libx264: {error}") from error
    bit_per_s = round(8000 * grade.typical * RATE_HZ)
    made.width, made.height, made.pix_fmt = width, height, "yuv420p"
    made.time_base, made.framerate = Fraction(1, RATE_HZ), Fraction(RATE_HZ)
    made.bit_rate, made.qmin, made.gop_size = bit_per_s, FINEST, KEY_PERIOD
    made.max_b_frames, made.thread_count = 0, 1
    for name, value in SD_VIDEO.items():
        setattr(made, name, value)
    made.options = {
        "preset": "ultrafast",
        "tune": "zerolatency",
        "profile": "baseline",
        "maxrate": str(bit_per_s),
        "bufsize": str(BURST * bit_per_s // RATE_HZ),
    }
    return made
