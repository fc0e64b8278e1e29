"""Maps of every mode, depth and type of pixels are read as a map_server reads them, cell by cell."""

import io
from fractions import Fraction
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from robbie_robots.workers.maps.map_file import read_map, write_map
from tests.workers._support.map_images import CHANNELS, Png, Pnm, Samples
from tests.workers._support.map_server import Pixel, Rules, allowed_values

PNG_TYPES = [(0, 1), (0, 2), (0, 4), (0, 8), (0, 16), (2, 8), (2, 16), (3, 1), (3, 2), (3, 4), (3, 8)]
PNG_TYPES += [(4, 8), (4, 16), (6, 8), (6, 16)]
THRESHOLDS = [
    ("0.65", "0.196"),
    ("0.65", "0.25"),
    ("6.5e-1", "2e-1"),
    ("0.6", ".2"),
    ("1", "0"),
    ("0.51", "0.5"),
]
SHADES = [0, 1, 5, 50, 51, 89, 90, 99, 100, 101, 102, 128, 200, 204, 205, 206, 254, 255]


def samples_of(channels: int, largest: int) -> st.SearchStrategy[Samples]:
    """Draw pixels; many of them have values near to the thresholds."""
    return st.builds(
        lambda width, height, random: [
            [random_pixel(channels, largest, random) for _ in range(width)] for _ in range(height)
        ],
        st.integers(1, 19),
        st.integers(1, 9),
        st.integers(0, 2**32).map(Random),
    )


def random_pixel(channels: int, largest: int, random: Random) -> tuple[int, ...]:
    """Return a pixel that is grey, or grey and opaque, or anything."""
    near = [round(random.choice(SHADES) * largest / 255) for _ in range(channels)]
    grey, opaque = near[:1] * channels, near[:1] * (channels - 1) + [largest]
    return tuple(random.choice([near, grey, opaque, [random.randint(0, largest) for _ in near]]))


def random_colour(random: Random) -> tuple[int, int, int]:
    """Return a colour, often grey."""
    red, green, blue = random.choices(SHADES, k=3)
    return random.choice([(red, green, blue), (red, red, red)])


@st.composite
def pngs(draw: st.DrawFn) -> Png:
    colour, depth = draw(st.sampled_from(PNG_TYPES))
    samples = draw(samples_of(CHANNELS[colour], 2**depth - 1))
    filters = draw(st.lists(st.integers(0, 4), min_size=9, max_size=9))
    png = Png(colour, depth, samples, is_interlaced=draw(st.booleans()), filter_of=lambda row: filters[row])
    if colour == 3:
        random = Random(draw(st.integers(0, 2**32)))
        png.palette = [random_colour(random) for _ in range(2**depth)]
        png.transparency = tuple(random.choices([0, 254, 255], k=random.randint(0, 2**depth)))
    elif colour in (0, 2) and draw(st.booleans()):
        png.transparency = draw(st.sampled_from([one for row in samples for one in row]))
    return png


@st.composite
def pnms(draw: st.DrawFn) -> Pnm:
    number = draw(st.integers(1, 6))
    largest = 1 if number in (1, 4) else draw(st.sampled_from([1, 2, 100, 254, 255, 256, 1000, 65535]))
    samples = draw(samples_of(3 if number in (3, 6) else 1, largest))
    return Pnm(number, largest, samples, draw(st.sampled_from(["", "CREATOR: map_saver.cpp 0.050 m/pix"])))


def write_yaml(folder: Path, rules: Rules, image: bytes, name: str = "image", more: str = "") -> Path:
    (folder / name).write_bytes(image)
    path = folder / "map.yaml"
    path.write_text(
        f"image: {name}\nmode: {rules.mode}\nresolution: 5e-2\norigin: [-1, 2.5e0, 0]\n"
        f"negate: {int(rules.negate)}\noccupied_thresh: {rules.occupied_thresh}\n"
        f"free_thresh: {rules.free_thresh}\n{more}"
    )
    return path


def differences(
    cells: np.ndarray[Any, np.dtype[np.int8]], rules: Rules, pixels: list[list[Pixel]]
) -> list[str]:
    """Return the cells that differ from what a map_server makes of the pixels."""
    assert cells.shape == (len(pixels), len(pixels[0]))
    found = []
    for row, (values, shown) in enumerate(zip(cells[::-1].tolist(), pixels, strict=True)):
        for column, (value, pixel) in enumerate(zip(values, shown, strict=True)):
            if value not in (right := allowed_values(rules, pixel)):
                found.append(f"row {row}, column {column}: {value} instead of {right} for {pixel}")
    return found


ALL_RULES = st.builds(
    lambda mode, negate, thresholds: Rules(mode, negate, *thresholds),
    st.sampled_from(["trinary", "scale", "raw"]),
    st.booleans(),
    st.sampled_from(THRESHOLDS),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for the files of all examples."""
    return tmp_path_factory.mktemp("maps")


@given(pngs() | pnms(), ALL_RULES)
def test_every_pixel_is_read_as_nav2_reads_it(folder: Path, image: Png | Pnm, rules: Rules) -> None:
    path = write_yaml(folder, rules, image.to_bytes())
    made = read_map(path)
    assert differences(made.cells, rules, image.pixels()) == []
    assert (made.resolution_m, made.corner_xy_m.tolist()) == (0.05, [-1.0, 2.5])


@given(pngs().filter(lambda png: png.depth == 8))
def test_images_of_these_tests_are_what_another_library_reads(png: Png) -> None:
    shown = np.asarray(Image.open(io.BytesIO(png.to_bytes())).convert("RGBA"))
    sums = [[round(pixel.shade * 3 * 255) for pixel in row] for row in png.pixels()]
    if png.colour in (0, 4):
        assert (shown[..., :3].sum(axis=2) == np.array(sums)).all()
    opaque = [[pixel.is_opaque for pixel in row] for row in png.pixels()]
    assert ((shown[..., 3] == 255) == np.array(opaque)).all()


GREYS = np.array([[0, 254, 205], [100, 255, 89]], np.uint8)


@given(st.lists(st.lists(st.integers(-1, 100), min_size=7, max_size=7), min_size=1, max_size=9))
def test_a_map_that_we_write_has_the_same_cells_in_nav2(folder: Path, cells: list[list[int]]) -> None:
    percent = np.array(cells, np.int8)
    write_map(folder / "own.yaml", percent, 0.05, (0, 0))
    written = yaml.safe_load((folder / "own.yaml").read_text())
    thresholds = str(written["occupied_thresh"]), str(written["free_thresh"])
    with Image.open(folder / written["image"]) as image:
        shown = [[Pixel(Fraction(value, 255)) for value in row] for row in np.asarray(image).tolist()]
    meant = np.where(percent < 0, -1, np.where(percent >= 50, 100, 0)).astype(np.int8)
    assert differences(meant, Rules(written["mode"], bool(written["negate"]), *thresholds), shown) == []


@pytest.mark.parametrize(
    ("kind", "mode"), [("BMP", "L"), ("GIF", "L"), ("TIFF", "L"), ("BMP", "RGB"), ("TIFF", "RGBA")]
)
def test_other_formats_are_read(tmp_path: Path, kind: str, mode: str) -> None:
    file = io.BytesIO()
    Image.fromarray(GREYS).convert(mode).save(file, kind)
    path = write_yaml(tmp_path, Rules("trinary", False, "0.65", "0.196"), file.getvalue())
    assert read_map(path).cells[::-1].tolist() == [[100, 0, -1], [-1, 0, 100]]


def test_jpeg_is_read(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.fromarray(np.repeat([[0], [255]], 8, axis=0).repeat(16, axis=1).astype(np.uint8)).save(file, "JPEG")
    path = write_yaml(tmp_path, Rules("trinary", False, "0.65", "0.196"), file.getvalue())
    assert read_map(path).cells[:, 0].tolist() == [0] * 8 + [100] * 8


def test_tiff_of_16_bits_keeps_its_bits(tmp_path: Path) -> None:
    file = io.BytesIO()
    Image.fromarray(GREYS.astype(np.uint16) * 257).save(file, "TIFF")
    path = write_yaml(tmp_path, Rules("trinary", False, "0.65", "0.196"), file.getvalue())
    assert read_map(path).cells[::-1].tolist() == [[100, 0, -1], [-1, 0, 100]]
