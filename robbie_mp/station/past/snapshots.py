"""Pictures that operators keep: a file for each camera, with the time when it was taken. Needs Pillow."""

from __future__ import annotations

import calendar
import contextlib
import io
import re
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from PIL import Image as PillowImage
from PIL import ImageDraw, ImageFont

from robbie_mp.attached.views.image_pixels import NoPicture, opened, pixels_of
from robbie_mp.base.linux.private_files import make_private_folder, write_private
from robbie_mp.base.utc import file_stamp, time_text
from robbie_mp.messages import CompressedImage, Image

if TYPE_CHECKING:
    from pathlib import Path

    from robbie_mp.station.watch.births import Births
    from robbie_mp.station.watch.cameras import Cameras, CameraTopic

SNAPSHOTS = "snapshots"
"""The folder in the results of the run."""
NAME = re.compile(r"(\d{8}T\d{6})\.(\d{3})Z-([\w.-]+)\.jpg", re.ASCII)
MAX_SNAPSHOTS = 1000
QUALITY = 95
CAPTION_PIXELS, TEXT_PIXELS = 20, 14
"""Height of the line below the picture, and of its letters."""
NO_LETTER = re.compile(r"[^\w.-]+", re.ASCII)
DESCRIPTION, EXIF_PART, TAKEN, TAKEN_ZONE, TAKEN_FRACTION = 0x010E, 0x8769, 0x9003, 0x9011, 0x9291
"""Tags of Exif 2.32: what a picture shows, and when it was taken."""


@dataclass(frozen=True)
class SavedSnapshot:
    """A picture on the disk."""

    name: str
    camera: str
    time_s: float
    """When it was taken, seconds since 1970."""
    bytes: int


class Snapshots:
    """Keeps the newest picture of each camera. Any thread may call it.

    Args:
        output_directory: the results of the run, which keep the pictures.
        cameras: those of the robot.
        births: tells when their pictures were taken.
    """

    def __init__(self, output_directory: Path, cameras: Cameras, births: Births):
        self._output_directory = output_directory
        self._cameras, self._births = cameras, births
        self._lock = threading.Lock()

    def take(self) -> tuple[list[str], list[str]]:
        """Keep the picture of each camera that has one. This may take a while.

        Returns:
            The cameras whose pictures were kept, and why others were not.
        """
        kept: list[str] = []
        problems: list[str] = []
        with self._lock:
            room = MAX_SNAPSHOTS - len(saved_snapshots(self._output_directory))
            for camera, topic in sorted(self._cameras.found.items()):
                try:
                    if len(kept) >= room:
                        raise OSError(f"{MAX_SNAPSHOTS} snapshots are kept; remove some")
                    self._keep(camera, topic)
                    kept.append(camera)
                except (NoPicture, OSError) as error:
                    problems.append(f"{camera}: {error}")
        return kept, problems

    def _keep(self, camera: str, topic: CameraTopic) -> None:
        message, arrived_s = topic.latest.message, topic.latest.arrived_s
        if message is None:
            raise NoPicture("it has sent no picture")
        age_s = max(0.0, self._births.now_s() - self._births.of_message(message, arrived_s))
        taken_s = time.time() - age_s
        folder = self._output_directory / SNAPSHOTS
        make_private_folder(folder)
        write_private(folder / name_of(camera, taken_s), stamped(message, camera, taken_s))


def name_of(camera: str, taken_s: float) -> str:
    """Return the name of a snapshot's file."""
    stamp = f"{file_stamp(taken_s)[:-1]}.{milliseconds(taken_s):03d}Z"
    return f"{stamp}-{NO_LETTER.sub('-', camera)[:60]}.jpg"


def milliseconds(time_s: float) -> int:
    """Return the milliseconds of a time, as `time_text` shows them."""
    return int(time_s % 1 * 1000)


def stamped(message: Image | CompressedImage, camera: str, taken_s: float) -> bytes:
    """Return a picture as a JPEG file, with camera and time below it, and in its Exif data.

    Raises:
        NoPicture: it cannot be shown, or is damaged.
    """
    picture = _opened(message)
    text = f"{camera}  {time_text(taken_s)}"
    font = ImageFont.load_default(TEXT_PIXELS)
    whole = PillowImage.new("RGB", (picture.width, picture.height + CAPTION_PIXELS))
    whole.paste(picture)
    ImageDraw.Draw(whole).text((4, picture.height + 1), text, fill="white", font=font)
    exif = PillowImage.Exif()
    exif[DESCRIPTION] = text
    moment = time.gmtime(taken_s)
    exif.get_ifd(EXIF_PART).update(
        {
            TAKEN: time.strftime("%Y:%m:%d %H:%M:%S", moment),
            TAKEN_ZONE: "+00:00",
            TAKEN_FRACTION: f"{milliseconds(taken_s):03d}",
        }
    )
    encoded = io.BytesIO()
    whole.save(encoded, "JPEG", quality=QUALITY, subsampling=0, exif=exif)
    return encoded.getvalue()


def _opened(message: Image | CompressedImage) -> PillowImage.Image:
    if isinstance(message, Image):
        return PillowImage.fromarray(pixels_of(message)).convert("RGB")
    try:
        return opened(message.data.tobytes(), ("JPEG", "PNG")).convert("RGB")
    except NoPicture:
        raise
    except (OSError, SyntaxError, ValueError) as error:
        raise NoPicture(f"the picture cannot be read: {error}") from None


def saved_snapshots(output_directory: Path) -> list[SavedSnapshot]:
    """Return the snapshots of a run, the oldest first. Somebody may remove them meanwhile."""
    saved: list[SavedSnapshot] = []
    with contextlib.suppress(FileNotFoundError):
        for path in sorted((output_directory / SNAPSHOTS).iterdir()):
            if found := NAME.fullmatch(path.name):
                with contextlib.suppress(FileNotFoundError):
                    saved.append(SavedSnapshot(path.name, found[3], _taken_s(found), path.stat().st_size))
    return saved


def _taken_s(found: re.Match[str]) -> float:
    return calendar.timegm(time.strptime(found[1], "%Y%m%dT%H%M%S")) + int(found[2]) / 1000
