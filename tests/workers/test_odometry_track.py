"""A sweep finds its place in odometry by stamp, also with clocks that jitter."""

import numpy as np
import pytest

from robbie_robots.workers.mapping.corrected_track import corrected
from robbie_robots.workers.odometry_track import OdometryTrack
from tests._support.present import present


def track(*entries: tuple[float, float, float, float], most: int = 1000) -> OdometryTrack:
    result = OdometryTrack(most)
    for stamp, *pose in entries:
        result.add(stamp, pose)
    return result


def test_stamp_between_two_entries_is_interpolated() -> None:
    place = present(track((1.0, 0, 0, 0), (2.0, 1, 0, 0), (3.0, 2, 0, 1)).at(2.25))
    assert place.position == pytest.approx(1.25)
    assert place.pose == pytest.approx([1.25, 0, 0.25])


def test_headings_are_interpolated_the_short_way_round() -> None:
    assert present(track((1.0, 0, 0, 3.1), (2.0, 0, 0, -3.1)).at(1.5)).pose[2] == pytest.approx(-np.pi)


def test_stamp_after_the_newest_entry_has_no_place_yet() -> None:
    assert track((1.0, 0, 0, 0)).at(1.5) is None
    assert track((1.0, 0, 0, 0)).at(0.5) is None
    assert track().at(0.5) is None


def test_newest_entry_with_the_same_stamp_counts() -> None:
    place = present(track((1.0, 0, 0, 0), (5.0, 7, 0, 0), (1.0, 2, 0, 0), (4.0, 3, 0, 0)).at(1.0))
    assert (place.position, place.pose[0]) == (2, 2)


def test_order_of_recording_counts_when_stamps_jump_back() -> None:
    place = present(track((1.0, 0, 0, 0), (2.0, 1, 0, 0), (1.2, 2, 0, 0), (1.8, 3, 0, 0)).at(1.5))
    assert place.position == pytest.approx(2.5)


def test_numbers_of_entries_stay_when_old_entries_are_dropped() -> None:
    result = track(*((float(n), n, 0, 0) for n in range(25)), most=10)
    assert len(result.log) <= 10
    assert present(result.at(24.0)).position == 24
    assert result.numbered(22).pose[0] == 22
    assert result.numbered(0).pose[0] == result.log.forgotten


def test_error_between_two_corrections_is_spread_over_the_motion() -> None:
    odometry = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0], [4, 0, 0], [5, 0, 0]], float)
    anchors = np.array([0, 3])
    poses = corrected(odometry, anchors, odometry[anchors], np.array([[0, 0, 0], [4.4, 0.8, 0]]))
    assert poses[:, 0] == pytest.approx([0, 1.1, 1.1, 4.4, 5.4], abs=1e-6)
    assert poses[:, 1] == pytest.approx([0, 0.2, 0.2, 0.8, 0.8], abs=1e-6)


@pytest.mark.parametrize(
    ("pause_s", "moved_m", "period_s", "coasted_m"),
    [(1.0, 0.05, 0.1, 0.5), (1.0, 0.5, 0.1, 0.0), (1.0, 0.0, 1.0, 0.0), (0.4, 0.0, 0.1, 0.0)],
    ids=["stopped", "drove on", "always rare", "short"],
)
def test_pause_in_which_a_driving_robot_stopped_is_told(
    pause_s: float, moved_m: float, period_s: float, coasted_m: float
) -> None:
    entries = [(number * period_s, 0.5 * number * period_s, 0, 0) for number in range(20)]
    stamp_s, x_m, *_ = entries[-1]
    result = track(*entries, (stamp_s + pause_s, x_m + moved_m, 0, 0))
    assert result.longest_pause(18.0, 20.0) == pytest.approx((pause_s, coasted_m))


def test_sweep_that_comes_very_late_is_placed_where_it_was_taken() -> None:
    result = track(*((n / 100, n, 0, 0) for n in range(3_000)), most=10_000)
    assert present(result.at(5.005)).pose[0] == pytest.approx(500.5)
    assert present(result.at(5.0)).position == 500
    assert result.at(-1.0) is None
