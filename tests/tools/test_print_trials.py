"""Names are judged by where the objects truly are."""

import numpy as np

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena_contents import StandingObject
from robbie_robots.hw.simulation.solid import pose_at
from robbie_robots.modules.manipulation.robot_shapes import on_floor
from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.table_view import TableView
from tools.trials.recognition.prints import STANDS, Count, Figures, Look, judge

BOX = (0.06, 0.04, 0.12)
LEFT, RIGHT = (0.4, 0.1), (0.4, -0.1)
"""Places of objects, base's frame."""


def judged(left: str, right: str) -> tuple[Count, Figures]:
    """Judge these names of a tea that stands to the left, and a mint that stands to the right."""
    look = Look(np.zeros((1, 1), np.uint16), np.zeros((1, 1, 3), np.uint8), np.eye(4), on_floor(STANDS))
    objects = []
    for name, place in (("tea", LEFT), ("mint", RIGHT)):
        at = STANDS.plus(Pose(*place, 0.0))
        objects.append(StandingObject(name, BOX, False, at.x_m, at.y_m, 0.4))
    named = {left: LEFT, right: RIGHT}
    shapes = [Shape(name, BOX, pose_at((*place, 0.46), np.pi + 0.1)) for name, place in named.items()]
    table = Shape("table", (1.0, 1.0, 0.4), pose_at((0.5, 0.0, 0.2)))
    figures, count = Figures(), Count()
    judge(figures, count, look, objects, ["tea", "mint"], TableView(0.0, table, tuple(shapes)))
    return count, figures


def test_only_the_own_name_is_right_and_a_swap_is_wrong() -> None:
    assert judged("tea", "mint")[0] == Count(right=2, rooms_right=1)
    assert judged("mint", "tea")[0] == Count(wrong=2)
    assert judged("tea", "unknown 1")[0] == Count(right=1, unnamed=1)


def test_heading_counts_by_the_edges_of_a_box() -> None:
    assert 0.09 < judged("tea", "mint")[1].worst_heading_rad < 0.11


def test_what_is_not_seen_is_unnamed() -> None:
    look = Look(np.zeros((1, 1), np.uint16), np.zeros((1, 1, 3), np.uint8), np.eye(4), on_floor(STANDS))
    figures, count = Figures(), Count()
    there = STANDS.plus(Pose(*LEFT, 0.0))
    judge(figures, count, look, [StandingObject("tea", BOX, False, *there[:2], 0.4)], ["tea"], None)
    assert (count, figures.unseen) == (Count(unnamed=1), 1)
