"""`robbie export --png`: images with the right colours and values, as another library reads them."""

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from robbie_mp import Header, Time
from robbie_mp.cli import main
from robbie_mp.logs.recording import png
from robbie_mp.messages import CompressedImage, Image
from tests.logs.recording._support.logs import START_NS, LogFile, scan

cv2 = pytest.importorskip("cv2")

HEIGHT, WIDTH = 4, 6
RGB = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint8).reshape(HEIGHT, WIDTH, 3)
DEPTH_MM = (np.arange(HEIGHT * WIDTH, dtype=np.uint16) * 2600).reshape(HEIGHT, WIDTH)


def image(encoding: str, pixels: Any, *, sec: int = 5, padding: int = 0, big: bool = False) -> Image:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(pixels.shape[0], -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return Image(
        header=Header(stamp=Time(sec=sec)),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big),
        step=rows.shape[1],
        data=rows.ravel(),
    )


def read(path: Path) -> np.ndarray[Any, Any]:
    with PIL.Image.open(path) as found:
        assert found.format == "PNG"
        return np.asarray(found)


def exported(tmp_path: Path, *messages: Image | CompressedImage, code: int = 0) -> list[Path]:
    with LogFile(tmp_path / "log.mcap") as log:
        for number, one in enumerate(messages):
            log.add(one, "front/camera", time_ns=START_NS + number)
        log.add(scan(1), "laser")
    assert main(["export", str(tmp_path / "log.mcap"), str(tmp_path / "out"), "--png"]) == code
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"front_camera"}
    return sorted((tmp_path / "out" / "front_camera").iterdir())


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", RGB, RGB),
        ("bgr8", RGB[:, :, ::-1], RGB),
        ("8UC3", RGB[:, :, ::-1], RGB),
        ("rgba8", np.dstack([RGB, RGB[:, :, 0]]), np.dstack([RGB, RGB[:, :, 0]])),
        ("bgra8", np.dstack([RGB[:, :, ::-1], RGB[:, :, 0]]), np.dstack([RGB, RGB[:, :, 0]])),
        ("mono8", RGB[:, :, 1], RGB[:, :, 1]),
        ("mono16", DEPTH_MM, DEPTH_MM),
        ("16UC1", DEPTH_MM, DEPTH_MM),
        ("32FC1", (DEPTH_MM / 1000).astype(np.float32), DEPTH_MM),
    ],
)
@pytest.mark.parametrize("padding", [0, 4])
def test_pixels_have_their_values(
    encoding: str, pixels: Any, expected: Any, padding: int, tmp_path: Path
) -> None:
    (path,) = exported(tmp_path, image(encoding, pixels, padding=padding))
    assert path.name == "0000000005.000000000.png"
    np.testing.assert_array_equal(read(path), expected)


def test_big_endian_values_are_swapped(tmp_path: Path) -> None:
    (path,) = exported(tmp_path, image("mono16", DEPTH_MM.astype(">u2"), big=True))
    np.testing.assert_array_equal(read(path), DEPTH_MM)


def test_depth_that_does_not_fit_is_none(tmp_path: Path) -> None:
    depths = np.array([[np.nan, np.inf, -1.0, 65.535, 65.537, 0.0004]], np.float32)
    (path,) = exported(tmp_path, image("32FC1", depths))
    assert read(path).tolist() == [[0, 0, 0, 65535, 0, 0]]


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_pattern_becomes_its_colour(pattern: str, tmp_path: Path) -> None:
    colour = {"r": 200, "g": 100, "b": 30}
    mosaic = np.empty((8, 8), np.uint8)
    for place, letter in enumerate(pattern):
        mosaic[place // 2 :: 2, place % 2 :: 2] = colour[letter]
    wide = mosaic.astype(np.uint16) * 257
    eight, sixteen = exported(
        tmp_path, image(f"bayer_{pattern}8", mosaic), image(f"bayer_{pattern}16", wide, sec=6)
    )
    assert np.unique(read(eight).reshape(-1, 3), axis=0).tolist() == [[200, 100, 30]]
    assert sixteen.read_bytes()[24:26] == bytes([16, 2]), "16 bits, colour"
    found = cv2.imread(str(sixteen), cv2.IMREAD_UNCHANGED)
    assert np.unique(found.reshape(-1, 3), axis=0).tolist() == [[30 * 257, 100 * 257, 200 * 257]]


def test_compressed_images_are_decoded_and_same_stamps_are_told_apart(tmp_path: Path) -> None:
    buffer = BytesIO()
    PIL.Image.fromarray(RGB).save(buffer, "BMP")
    data = np.frombuffer(buffer.getvalue(), np.uint8)
    stamped = CompressedImage(header=Header(stamp=Time(sec=9)), format="bmp", data=data)
    unstamped = CompressedImage(format="bmp", data=data)
    paths = exported(tmp_path, stamped, stamped, unstamped)
    assert [path.name for path in paths] == [
        "0000000009.000000000-2.png", "0000000009.000000000.png", "1700000000.000000002.png",
    ]  # fmt: skip
    for path in paths:
        np.testing.assert_array_equal(read(path), RGB)


def test_what_is_no_image_is_left_out_with_its_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = image("rgb8", RGB)
    short = Image(height=4, width=99, encoding="rgb8", step=short.step, data=short.data)
    junk = CompressedImage(format="jpeg", data=np.frombuffer(b"no jpeg at all", np.uint8))
    assert exported(tmp_path, image("rgb9", RGB), short, code=1) == []
    said = capsys.readouterr().err
    assert "left out 1: messages of 'front/camera': encoding 'rgb9' is not known" in said
    assert "are no image of 99 x 4 pixels of rgb8" in said
    (tmp_path / "junk").mkdir()
    assert exported(tmp_path / "junk", junk, code=1) == []
    assert "its 14 bytes are no image (jpeg)" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "log.mcap"), str(tmp_path / "out"), "--png"]) == 2
    assert "cannot be written: File exists" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "log.mcap"), "x", "--png", "--topics", "laser"]) == 1
    assert "has no images on these topics" in capsys.readouterr().err


def test_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cv2", None)
    with pytest.raises(png.NotPng, match="pip install opencv-python-headless"):
        png.PngMaker()
