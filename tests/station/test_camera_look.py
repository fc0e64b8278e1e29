"""Keys, stick and drags become goals of the camera's joints; what a page sends is checked."""

import math
from typing import Any

import pytest

pytest.importorskip("nicegui", reason="the operator's page needs the extra gui")

from robbie_mp.scene import Node, RigidTransform, SceneGraph
from robbie_mp.station.panels.camera_look import AHEAD_RAD, VIEW_RAD, LookWish, checked, direction_of, goal_of

AHEAD = RigidTransform(0.0, 0.0, 0.0, -0.5, 0.5, -0.5, 0.5)
"""Of an optical frame: z is the direction of the view, x is to the right."""
HELD = {"held": True, "begins": False, "sent_s": 1.0}


@pytest.mark.parametrize(
    "sent",
    [
        None,
        "look",
        {},
        {"sent_s": math.inf},
        {**HELD, "turn": 1},
        {**HELD, "turn": [1]},
        {**HELD, "turn": [1, "fast"]},
        {**HELD, "drag": [math.nan, 0]},
        {**HELD, "drag": [1, 2, 3]},
    ],
)
def test_malformed_wishes_are_ignored(sent: Any) -> None:
    assert checked(sent) is None


def test_wishes_are_read_and_bounded() -> None:
    assert checked({**HELD, "turn": [7, -0.5]}) == LookWish(True, False, 1.0, turn=(1.0, -0.5))
    assert checked({**HELD, "centre": True}) == LookWish(True, False, 1.0)


@pytest.mark.parametrize(
    ("wish", "pan_rad", "tilt_rad"),
    [
        (LookWish(True, True, 0.0), 0.0, 0.0),
        (LookWish(True, True, 0.0, turn=(1.0, 0.0)), 0.5 + AHEAD_RAD, None),
        (LookWish(True, False, 0.0, drag=(0.5, -0.5)), 0.2 + VIEW_RAD / 2, 0.2 - VIEW_RAD / 2),
    ],
)
def test_joints_go_where_the_operator_wants(
    wish: LookWish, pan_rad: float | None, tilt_rad: float | None
) -> None:
    assert goal_of(wish, False, 0.5, 0.2) == pan_rad
    assert goal_of(wish, True, 0.5, 0.2) == tilt_rad


def test_joint_whose_place_is_unknown_stays() -> None:
    assert goal_of(LookWish(True, True, 0.0, turn=(1.0, 0.0)), False, None, None) is None
    assert goal_of(LookWish(True, True, 0.0, drag=(1.0, 0.0)), False, 0.5, None) is None


@pytest.mark.parametrize(("yaw_rad", "pitch_rad"), [(0.0, 0.0), (1.0, 0.0), (-2.0, 0.5), (0.0, -0.4)])
def test_display_shows_where_the_optical_axis_looks(yaw_rad: float, pitch_rad: float) -> None:
    head = RigidTransform.from_rpy((0.1, 0.0, 0.4), (0.0, pitch_rad, yaw_rad))
    graph = SceneGraph([Node("base_link"), Node("camera", "base_link", head @ AHEAD)])
    assert direction_of(graph, "camera") == pytest.approx((yaw_rad, pitch_rad))
    assert direction_of(graph, "rear_camera") is None
