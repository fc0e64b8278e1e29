"""Images in forms that browsers can show, and images that cannot be shown."""

import io
import time

import numpy as np
import pytest
from PIL import Image as PillowImage

from robbie_mp.attached.views.image_pixels import NoPicture, pixels_of
from robbie_mp.messages import CompressedImage, Header, Image, Time
from robbie_mp.module.clock import ManualClock
from robbie_mp.station.live.video import GRADES
from robbie_mp.station.watch.births import Births
from robbie_mp.station.watch.latest import Latest
from robbie_mp.station.watch.pictures import MAX_PIXELS, NewestPicture, Picture, encode_image

COLOURS = np.array([[[1, 2, 3], [4, 5, 6]]], np.uint8)


@pytest.mark.parametrize(
    ("encoding", "stored"),
    [
        ("rgb8", COLOURS),
        ("bgr8", COLOURS[:, :, ::-1]),
        ("rgba8", np.pad(COLOURS, ((0, 0), (0, 0), (0, 1)))),
        ("bgra8", np.pad(COLOURS[:, :, ::-1], ((0, 0), (0, 0), (0, 1)))),
    ],
)
def test_colours_are_correct_for_every_order_and_padding(
    encoding: str, stored: "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]"
) -> None:
    row = np.append(stored.ravel(), [77, 77]).astype(np.uint8)
    image = Image(height=1, width=2, encoding=encoding, step=len(row), data=row)
    assert np.array_equal(pixels_of(image), COLOURS)


@pytest.mark.parametrize("big", [False, True])
def test_images_of_16_bits_are_scaled_from_black_to_white(big: bool) -> None:
    row = np.array([29_000, 30_000, 31_000], ">u2" if big else "<u2").view(np.uint8)
    image = Image(height=1, width=3, encoding="mono16", step=8, is_bigendian=big, data=np.append(row, [7, 7]))
    assert pixels_of(image).tolist() == [[0, 127, 255]]


@pytest.mark.parametrize(
    ("encoding", "kind", "depths"),
    [
        ("16UC1", "<u2", [500, 0, 1000, 2000]),  # mm
        ("16UC1", ">u2", [500, 0, 1000, 2000]),
        ("32FC1", "<f4", [0.5, np.nan, 1.0, 2.0]),  # m
        ("32FC1", "<f4", [0.5, np.inf, 1.0, 2.0]),
    ],
)
def test_depths_are_brighter_the_nearer_and_black_without_a_measurement(
    encoding: str, kind: str, depths: list[float]
) -> None:
    row = np.array(depths, kind).view(np.uint8)
    big = kind.startswith(">")
    image = Image(height=1, width=4, encoding=encoding, step=len(row), is_bigendian=big, data=row)
    (shown,) = pixels_of(image).tolist()
    nearest, unmeasured, middle, farthest = shown
    assert nearest == 255
    assert unmeasured == 0
    assert 30 < farthest < middle < nearest
    assert PillowImage.open(io.BytesIO(encode_image(image).data)).size == (4, 1)


@pytest.mark.parametrize("depth", [0, 700])
def test_depths_that_are_all_alike_are_shown(depth: int) -> None:
    row = np.full(4, depth, "<u2").view(np.uint8)
    image = Image(height=1, width=4, encoding="16UC1", step=8, data=row)
    assert pixels_of(image).tolist() == [[255 if depth else 0] * 4]


def test_large_images_are_scaled_down() -> None:
    size = 2 * MAX_PIXELS
    data = np.full(4 * size, 200, np.uint8)
    picture = encode_image(Image(height=4, width=size, encoding="mono8", step=size, data=data))
    shown = PillowImage.open(io.BytesIO(picture.data))
    assert (picture.media_type, shown.size) == ("image/jpeg", (MAX_PIXELS, 2))
    assert shown.getpixel((5, 1)) == pytest.approx(200, abs=3)


@pytest.mark.parametrize(
    "image",
    [
        Image(height=1, width=1, encoding="bayer_rggb8", step=1, data=np.zeros(1, np.uint8)),
        Image(height=2, width=2, encoding="mono8", step=2, data=np.zeros(3, np.uint8)),
        Image(height=1, width=4, encoding="rgb8", step=4, data=np.zeros(4, np.uint8)),
        Image(encoding="mono8"),
        CompressedImage(format="jpeg", data=np.zeros(9, np.uint8)),
    ],
)
def test_image_that_browsers_cannot_show_has_no_picture(image: Image | CompressedImage) -> None:
    with pytest.raises(NoPicture):
        encode_image(image)


def test_compressed_images_are_passed_on_unchanged() -> None:
    data = b"\xff\xd8\xff and so on"
    message = CompressedImage(format="jpeg", data=np.frombuffer(data, np.uint8))
    assert encode_image(message) == Picture(data, "image/jpeg")


def test_compressed_images_become_smaller_for_slow_networks() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (480, 640, 3), np.uint8)
    data = io.BytesIO()
    PillowImage.fromarray(noise).save(data, "JPEG", quality=90)
    message = CompressedImage(format="jpeg", data=np.frombuffer(data.getvalue(), np.uint8))
    picture = encode_image(message, 320, 40)
    assert len(picture.data) < len(data.getvalue()) / 10
    assert PillowImage.open(io.BytesIO(picture.data)).size == (320, 240)


def grey(value: int) -> Image:
    return Image(height=1, width=1, encoding="mono8", step=1, data=np.full(1, value, np.uint8))


@pytest.mark.parametrize("side", [8000, 14_000])
def test_small_file_of_a_huge_picture_is_not_decoded(side: int) -> None:
    huge = io.BytesIO()
    PillowImage.new("1", (side, side)).save(huge, "PNG")
    image = CompressedImage(format="png", data=np.frombuffer(huge.getvalue(), np.uint8))
    with pytest.raises(NoPicture, match="pixels"):
        encode_image(image, 320, 45)


def test_picture_is_encoded_once_for_all_pages_in_each_grade_and_again_for_a_newer_message() -> None:
    latest: Latest[Image | CompressedImage] = Latest()
    picture = NewestPicture(latest)
    fine, coarse = GRADES[0], GRADES[-1]
    assert picture.encoded(fine).about["reason"] == "there is none yet"
    latest.put(grey(3))
    first = picture.encoded(fine)
    assert picture.encoded(fine) is first
    assert picture.encoded(coarse) is not first
    latest.put(Image(width=3))
    assert "are not shown" in str(picture.encoded(fine).about["reason"])


@pytest.mark.parametrize(("stamp_ns", "age_s"), [(9_000_000_000, 1.0), (11_000_000_000, 0.0), (0, 0.0)])
def test_picture_says_when_its_picture_was_taken(stamp_ns: int, age_s: float) -> None:
    """A stamp of the future, or of long ago, is not believed: then it counts as taken when it arrived."""
    base_ns = 0 if stamp_ns else 10_000_000_000_000
    births = Births(ManualClock(base_ns + 10_000_000_000), is_real=True)
    latest: Latest[Image | CompressedImage] = Latest()
    picture = NewestPicture(latest, births)
    header = Header(stamp=Time.from_nanoseconds(base_ns + stamp_ns if base_ns == 0 else 0))
    latest.put(Image(header=header, height=1, width=1, encoding="mono8", step=1, data=np.zeros(1, np.uint8)))
    born_s = picture.encoded(GRADES[0]).about["born_s"]
    assert isinstance(born_s, float)
    assert time.monotonic() - born_s == pytest.approx(age_s, abs=0.5)


def test_messages_of_a_simulated_time_count_from_their_arrival() -> None:
    latest = Latest[Image]()
    latest.put(Image())
    assert Births(ManualClock(5_000_000_000), is_real=False).of(latest) == latest.arrived_s
