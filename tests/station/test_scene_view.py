"""Points of the 3-D view."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robbie_mp.messages import LaserScan, PointCloud2, PointField
from robbie_mp.station.map.marks import MarkPicture
from robbie_mp.station.scene_view.drawing import OVER_MARK_M, PICTURE_M, picture_corners
from robbie_mp.station.scene_view.points import cloud_points, packed, scan_points, shades


def cloud(points: np.ndarray, *, padding: int = 4, big: bool = False) -> PointCloud2:
    """A cloud of two rows, with something else beside each point and at the end of each row."""
    step = 12 + padding
    rows = np.zeros((2, len(points) // 2 * step + 3), np.uint8)
    coordinates = points.astype(">f4" if big else "<f4").view(np.uint8).reshape(2, -1, 12)
    rows[:, :-3].reshape(2, -1, step)[:, :, :12] = coordinates
    fields = [PointField(name=name, offset=4 * at, datatype=7, count=1) for at, name in enumerate("xyz")]
    return PointCloud2(
        height=2, width=len(points) // 2, fields=fields, point_step=step, row_step=rows.shape[1],
        data=rows.ravel(), is_bigendian=big,
    )  # fmt: skip


def test_only_rays_that_hit_something_are_points() -> None:
    ranges = np.array([1.0, np.nan, 2.0, np.inf, 0.01, 30.0], np.float32)
    scan = LaserScan(angle_min=0.0, angle_increment=np.pi / 4, range_min=0.1, range_max=30.0, ranges=ranges)
    assert scan_points(scan).places == pytest.approx(np.array([[1, 0, 0], [0, 2, 0]]), abs=1e-6)


@pytest.mark.parametrize("big", [False, True])
def test_points_of_a_cloud_are_found_among_other_fields(big: bool) -> None:
    points = np.arange(24, dtype=np.float64).reshape(8, 3)
    found = cloud_points(cloud(points, big=big), 100)
    assert np.array_equal(found.places, points)
    assert found.intensities is None


@given(st.integers(1, 200), st.integers(1, 50))
@settings(max_examples=30)
def test_cloud_is_thinned_evenly_to_the_limit(pairs: int, limit: int) -> None:
    points = np.arange(6 * pairs, dtype=np.float64).reshape(-1, 3)
    found = cloud_points(cloud(points), limit).places
    assert 0 < len(found) <= limit
    assert len(np.unique(np.diff(found[:, 0]))) <= 1


@given(
    st.integers(0, 4), st.integers(0, 4), st.integers(0, 40), st.integers(0, 80), st.integers(0, 99),
    st.integers(0, 20), st.integers(0, 9),
)  # fmt: skip
@settings(max_examples=60)
def test_invalid_cloud_causes_no_error(
    height: int, width: int, point_step: int, row_step: int, size: int, offset: int, datatype: int
) -> None:
    fields = [PointField(name=name, offset=offset, datatype=datatype, count=1) for name in "xyz"]
    message = PointCloud2(
        height=height, width=width, fields=fields, point_step=point_step, row_step=row_step,
        data=np.zeros(size, np.uint8),
    )  # fmt: skip
    assert len(cloud_points(message, 10).places) <= height * width


def test_points_are_sent_in_steps_of_a_centimetre() -> None:
    sent = packed(np.array([[1.234, -2.0, 1e9]]))
    assert np.frombuffer(sent, "<i2").tolist() == [123, -200, 32767]


def test_intensities_stay_with_their_points() -> None:
    measured = LaserScan(
        angle_increment=0.1, range_min=0.1, range_max=30.0,
        ranges=np.array([1.0, np.inf, 2.0], np.float32), intensities=np.array([7, 8, 9], np.float32),
    )  # fmt: skip
    assert scan_points(measured).intensities == pytest.approx([7.0, 9.0])
    message = cloud(np.arange(12, dtype=np.float64).reshape(4, 3))
    message.fields.append(PointField(name="intensity", offset=8, datatype=7, count=1))  # where z lies
    assert cloud_points(message, 10).intensities == pytest.approx([2.0, 5.0, 8.0, 11.0])


def test_intensities_are_sent_from_the_weakest_to_the_strongest() -> None:
    assert list(shades(np.array([3.0, np.nan, 9.0, 6.0]))) == [85, 0, 255, 170]
    assert list(shades(np.array([4.0, 4.0]))) == [0, 0]
    assert len(shades(np.array([1e308, -np.inf]))) == 2
    assert shades(None) == b""


def test_picture_of_a_mark_is_upright_and_reads_from_left_to_right_for_those_whom_it_faces() -> None:
    # It faces along x, so somebody in front of it looks along -x, and has y at the right.
    upper, lower = picture_corners(MarkPicture("/pictures/victim/1?1", 0.0, 0.5))
    for row, height_m in ((upper, OVER_MARK_M + PICTURE_M / 2), (lower, OVER_MARK_M)):
        assert row[0] == pytest.approx([0.0, -PICTURE_M / 2, height_m])
        assert row[1] == pytest.approx([0.0, PICTURE_M / 2, height_m])
