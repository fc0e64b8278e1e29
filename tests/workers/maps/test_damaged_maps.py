"""Damaged and malicious map files end in an error that says so, at once and in little memory."""

import struct
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robbie_robots.workers.maps.map_file import MapFileError, describe_map, read_map
from tests.workers._support.map_images import Png, Pnm, Samples

PIXELS: Samples = [[(0,), (3,), (1,)], [(2,), (3,), (0,)]]
IMAGES = [
    Png(0, 2, PIXELS, is_interlaced=True).to_bytes(),
    Png(0, 16, PIXELS, transparency=(3,)).to_bytes(),
    Png(
        3, 2, PIXELS, palette=[(0, 0, 0), (1, 2, 3), (205, 205, 205), (255, 255, 255)], transparency=(0,)
    ).to_bytes(),
    Png(6, 8, [[one * 4 for one in row] for row in PIXELS]).to_bytes(),
    *(Pnm(number, 3, PIXELS, "a map").to_bytes() for number in (2, 5)),
    Pnm(1, 1, [[(0,), (1,)]], "bits").to_bytes(),
    Pnm(4, 1, [[(0,), (1,)]]).to_bytes(),
    Pnm(6, 300, [[one * 3 for one in row] for row in PIXELS]).to_bytes(),
]
YAML = b"""image: image
mode: scale
resolution: 0.05
origin: [0, 0, 0.3]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for the files of all examples."""
    return tmp_path_factory.mktemp("maps")


def changes(length: int) -> st.SearchStrategy[list[tuple[int, int, bytes]]]:
    """Draw changes: where, how many bytes go, and which come instead."""
    piece = st.binary(max_size=6) | st.sampled_from(
        [b"#", b"\n", b"&a [*a]", b"1e400", b"-1", b"\xff\xff\xff\xff"]
    )
    return st.lists(st.tuples(st.integers(0, length), st.integers(0, 8), piece), min_size=1, max_size=4)


def damaged(whole: bytes, damage: list[tuple[int, int, bytes]]) -> bytes:
    for place, gone, come in damage:
        whole = whole[:place] + come + whole[place + gone :]
    return whole


def with_checksums(png: bytes) -> bytes:
    """Return a PNG whose chunks have right checksums again, so that what they hold is read."""
    out, at = png[:8], 8
    while at + 12 <= len(png):
        (length,) = struct.unpack(">I", png[at : at + 4])
        body = png[at + 4 : at + 8 + length]
        out += png[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return out + png[at:]


@given(st.data())
def test_damaged_maps_are_read_or_refused(folder: Path, data: st.DataObject) -> None:
    image = data.draw(st.sampled_from(IMAGES))
    description = YAML
    if data.draw(st.booleans()):
        image = damaged(image, data.draw(changes(len(image))))
        image = with_checksums(image) if data.draw(st.booleans()) and image[:4] == b"\x89PNG" else image
    else:
        description = damaged(YAML, data.draw(changes(len(YAML))))
    (folder / "image").write_bytes(image)
    (folder / "map.yaml").write_bytes(description)
    try:
        assert read_map(folder / "map.yaml").cells.ndim == 2
    except MapFileError as error:
        assert len(str(error)) < 1_000


@given(
    st.binary(max_size=60),
    st.sampled_from([b"", b"BM", b"GIF89a", b"\xff\xd8\xff", b"II*\0", b"P5\n", b"\x89PNG\r\n\x1a\n"]),
)
def test_any_bytes_are_read_or_refused(folder: Path, rest: bytes, magic: bytes) -> None:
    (folder / "image").write_bytes(magic + rest)
    (folder / "map.yaml").write_bytes(YAML)
    try:
        read_map(folder / "map.yaml")
    except MapFileError as error:
        assert len(str(error)) < 1_000


def chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png_of(width: int, height: int, data: bytes) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def bmp_of(edge: int) -> bytes:
    return b"BM" + struct.pack("<IHHIIiiHHIIiiII", 54, 0, 0, 54, 40, edge, edge, 1, 24, 0, 0, 0, 0, 0, 0)


BOMBS = {
    "bmp": (bmp_of(10_000), "more than 89,478,485 pixels; save it as PNG"),
    "huge bmp": (bmp_of(30_000), "more than 89,478,485 pixels; save it as PNG"),
    "long bmp": (bmp_of(200_000), "more than"),
    "huge": (png_of(2**31 - 1, 2**31 - 1, b""), "more than"),
    "long": (png_of(2**31 - 1, 1, b""), "more than"),
    "nothing": (png_of(0, 5, b""), "no image"),
    "short": (png_of(30_000, 30_000, zlib.compress(bytes(100))), "too early"),
    "inflating": (png_of(4, 4, zlib.compress(bytes(200_000_000))), ""),
    "pgm": (b"P5\n30000 30000\n255\n" + bytes(60_000), "ends after 2 of 30000 rows"),
    "plain": (b"P2\n30000 30000\n255\n1 2 3", "ends after 0"),
    "digits": (b"P2\n3 3\n255\n" + b"1" * 3_000_000, "text where a number"),
    "words": (b"P2\n3 3\n255\n1 2 3 " + b"1" * 900_000 + b" 1" * 50_000, "text where a number"),
    "over": (b"P5\n2 1\n100\n\x64\x65", "holds the value 101"),
    "bits": (b"P1\n2 1\n1 2", "something else than 0 and 1"),
    "maximum": (b"P5\n2 1\n65536\n\0\0\0\0", "1 to 65535"),
    "header": (b"P5\n# " + b"#" * 200_000, "header is damaged"),
    "pam": (b"P7\nWIDTH 1\n", "none of PNG"),
    "filter": (png_of(1, 1, zlib.compress(b"\5\0")), "no filter 5"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_bombs_do_not_go_off(tmp_path: Path, name: str) -> None:
    image, complaint = BOMBS[name]
    (tmp_path / "image").write_bytes(image)
    (tmp_path / "map.yaml").write_bytes(YAML.replace(b"0.3", b"0"))
    tracemalloc.start()
    try:
        if complaint:
            with pytest.raises(MapFileError, match=complaint):
                describe_map(tmp_path / "map.yaml")
        else:
            describe_map(tmp_path / "map.yaml")
        assert tracemalloc.get_traced_memory()[1] < 60e6
    finally:
        tracemalloc.stop()


def test_deep_yaml_is_refused_at_once(tmp_path: Path) -> None:
    for deep in (b"[" * 10_000, b"? " * 5_000, b"- " * 5_000, b"{a: " * 3_000):
        (tmp_path / "map.yaml").write_bytes(YAML + b"a:\n " + deep)
        with pytest.raises(MapFileError, match="YAML"):
            read_map(tmp_path / "map.yaml")


def test_aliases_are_not_expanded(tmp_path: Path) -> None:
    lines = [
        "a: &a [x, x]",
        *(f"{b}: &{b} [{', '.join(['*' + a] * 9)}]" for a, b in zip("abcdefgh", "bcdefghi", strict=True)),
    ]
    (tmp_path / "image").write_bytes(IMAGES[0])
    (tmp_path / "map.yaml").write_bytes(YAML + "\n".join(lines).encode())
    assert "unknown keys: a, b" in describe_map(tmp_path / "map.yaml")["left out"]
    assert np.sum(read_map(tmp_path / "map.yaml").cells >= 0)
    (tmp_path / "map.yaml").write_bytes(YAML + "\n".join([*lines, "? *i\n: 1"]).encode())
    with pytest.raises(MapFileError, match="a key is no text"):
        read_map(tmp_path / "map.yaml")
