"""Images of maps: PNG and PNM band by band, and small ones of other formats as Pillow decodes them."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from PIL import Image

from robbie_robots.workers.maps.image_band import (
    BAND_BYTES,
    Band,
    MapImage,
    MapImageError,
    check_size,
    sum_of,
)
from robbie_robots.workers.maps.png_image import SIGNATURE, png_image
from robbie_robots.workers.maps.pnm_image import KINDS, pnm_image

OTHER_FORMATS = ("BMP", "GIF", "JPEG", "TIFF")
"""Of Pillow's formats those that need no other program, as EPS does."""


@contextmanager
def map_image(path: Path) -> Iterator[MapImage]:
    """Open the image of a map.

    Raises:
        MapImageError: It cannot be read. The bands raise it, too.
        OSError: As opening and reading files raise it.
    """
    if not path.is_file():  # a pipe would block
        raise MapImageError("there is no such file" if not path.exists() else "it is no file")
    with path.open("rb") as file:
        magic = file.read(len(SIGNATURE))
        file.seek(0)
        if magic == SIGNATURE:
            yield png_image(file)
        elif magic[:2] in KINDS:
            yield pnm_image(file)
        else:
            yield _other_image(file)


def _other_image(file: BinaryIO) -> MapImage:
    kind, picture = _decoded(file)
    white = {"L": 255, "RGBA": 3 * 255}.get(picture.mode, 65_535)
    return MapImage(kind, *picture.size, white, _bands(picture))


def _decoded(file: BinaryIO) -> tuple[str, Image.Image]:
    """Return the kind of an image, and its pixels: greys, colours with alpha, or greys of 16 bits."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            picture: Image.Image = Image.open(file, formats=OTHER_FORMATS)
            check_size(*picture.size)
            kind = f"{picture.format}, {picture.mode}"
            if picture.mode in ("I", "F"):
                raise MapImageError(f"{kind} does not say which value is white")
            if not picture.mode.startswith("I;16"):
                is_grey = picture.mode in ("1", "L") and "transparency" not in picture.info
                picture = picture.convert("L" if is_grey else "RGBA")
            picture.load()
            return kind, picture
    except MapImageError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        limit = f"{Image.MAX_IMAGE_PIXELS:,}"
        raise MapImageError(
            f"it has more than {limit} pixels; save it as PNG, for its format is decoded as a whole"
        ) from error
    except Exception as error:  # damaged images raise nearly all there is, struct.error and KeyError too
        known = ", ".join(("PNG", "PBM, PGM, PPM", *OTHER_FORMATS))
        raise MapImageError(f"it is damaged, or none of {known}: {error}") from error


def _bands(picture: Image.Image) -> Iterator[Band]:
    at_once = max(1, BAND_BYTES // (4 * picture.width))
    for top in range(0, picture.height, at_once):
        rows = slice(top, min(top + at_once, picture.height))
        pixels = np.asarray(picture.crop((0, rows.start, picture.width, rows.stop)))
        if pixels.ndim == 2:
            yield Band(rows, slice(None), pixels)
        else:
            yield Band(rows, slice(None), sum_of(pixels[..., :3]), pixels[..., 3] == 255)
