"""What the operator of the drive over slow networks sees on the page, and how its drive is judged."""

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("playwright", reason="the operator's drive needs a browser")

from tools.operator.drive import LANE_M, PLACES, WAY, Sight, judge

SHOWN = {
    "map": "185 x 125 cells of 0.05 m; robot at -1.50 m, 2.00 m, 270°; path of 3 points",
    "speed": "0.35 m/s, -0.10 rad/s",
    "ring": {"ahead": 1.25, "left": 0.3},
    "age_s": 0.2,
    "touches": "",
    "why": "you drive",
}
STEP_M = 0.01


def true_path() -> NDArray[np.float64]:
    """A path in the middle of all lanes, with a pose each second."""
    corners = np.array([(0, 0), *WAY]) * LANE_M
    legs = [
        np.linspace(one, other, round(math.dist(one, other) / STEP_M))
        for one, other in itertools.pairwise(corners)
    ]
    places = np.concatenate(legs)
    return np.column_stack([np.arange(len(places)), places, np.zeros(len(places))])


def test_operator_reads_the_page() -> None:
    sight = Sight.of(SHOWN)
    assert sight is not None
    assert (sight.pose[:2], sight.speed, sight.ahead_m, sight.touches) == (
        (-1.5, 2.0),
        (0.35, -0.1),
        1.25,
        False,
    )
    assert not sight.stands
    assert sight.towards((-1.5, 1.0)) == pytest.approx((1.0, 0.0))
    assert sight.towards((-0.5, 2.0)) == pytest.approx((1.0, math.pi / 2))


@pytest.mark.parametrize("lacks", ["map", "speed"])
def test_page_that_does_not_show_where_the_robot_is_shows_nothing(lacks: str) -> None:
    assert Sight.of({**SHOWN, lacks: "no map yet"}) is None


def test_drive_is_judged_by_the_true_path() -> None:
    truth = true_path()
    places = [(LANE_M * x, LANE_M * y) for x, y in PLACES]
    times = [float(np.hypot(*(truth[:, 1:3] - place).T).argmin()) for place in places]
    good = judge([*zip(times, places, strict=True)], truth)
    assert good["reached"] == len(PLACES)
    assert good["greatest error, m"] < 2 * STEP_M
    assert good["way, m"] == pytest.approx(19.5, abs=0.1)
    assert good["least free distance, m"] == pytest.approx(
        0.425, abs=0.02
    )  # lanes of 1.25 m, and a robot of 0.4 m
    # The page has shown the last place too early, and the robot was half a metre away.
    late = judge([*zip([*times[:-1], times[-1] - 0.5 / STEP_M], places, strict=True)], truth)
    assert late["reached"] == len(PLACES) - 1
    assert late["greatest error, m"] == pytest.approx(0.5, abs=0.05)


def test_drive_that_touches_a_wall_has_no_free_distance() -> None:
    truth = true_path()
    truth[100, 1] = 0.43
    assert judge([], truth)["least free distance, m"] == pytest.approx(-0.005, abs=0.01)
