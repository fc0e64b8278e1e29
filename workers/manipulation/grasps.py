"""Where a hand may grasp an object, and where on a table it may put it down."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robbie_robots.workers.manipulation.collisions import Shape
from robbie_robots.workers.manipulation.rotations import upright_pose
from robbie_robots.workers.manipulation.table_view import TableView

Floats = NDArray[np.float64]

PITCHES_RAD = (0.5, 0.0, 1.0, math.pi / 2)
"""Directions of the hand below the horizon, the best first; the last one is from above."""
TURNS_RAD = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2)
ABOVE_TABLE_M, BELOW_TOP_M = 0.045, 0.022
"""The grasp point keeps these distances from the table and from the object's top."""
FINGER_ROOM_M = 0.008
"""The open gripper is wider than the object by this on each side."""
PLACE_STEP_M = 0.05
FROM_EDGE_M, LEAST_FROM_EDGE_M = 0.08, 0.05
"""Places for the middle of an object are this far from the edge; where there are none, at least this far."""
APART_M = 0.05
DROP_M = 0.004
"""An object is let go this far above the table."""


def hand_pose(place: Floats, azimuth_rad: float, pitch_rad: float) -> Floats:
    """Return X_BT of a hand that points in a direction, with its fingers left and right: (4, 4).

    Args:
        place: (3,), m: the grasp point.
        azimuth_rad: direction seen from above.
        pitch_rad: angle below the horizon.
    """
    (sa, ca), (sp, cp) = ((math.sin(angle), math.cos(angle)) for angle in (azimuth_rad, pitch_rad))
    pose = np.eye(4)
    pose[:3, 0] = (ca * cp, sa * cp, -sp)
    pose[:3, 1] = (-sa, ca, 0.0)
    pose[:3, 2] = np.cross(pose[:3, 0], pose[:3, 1])
    pose[:3, 3] = place
    return pose


def moved_along(pose: Floats, ahead_m: float = 0.0, up_m: float = 0.0) -> Floats:
    """Return a hand's pose moved in its own direction, and upwards."""
    there = pose.copy()
    there[:3, 3] += ahead_m * pose[:3, 0] + np.array([0.0, 0.0, up_m])
    return there


def grasps(shape: Shape, top_m: float, shoulder: Floats, half_opening_m: float) -> Iterator[Floats]:
    """Return poses X_BT of the hand around an object, the best first.

    Args:
        shape: the object; it stands.
        top_m: height of the table.
        shoulder: (3,), m, from where the arm reaches.
        half_opening_m: of the open gripper.
    """
    x, y, height = shape.size_m
    widest_m = 2 * (half_opening_m - FINGER_ROOM_M)
    towards_rad = math.atan2(shape.pose[1, 3] - shoulder[1], shape.pose[0, 3] - shoulder[0])
    yaw_rad = math.atan2(shape.pose[1, 0], shape.pose[0, 0])
    if shape.is_round:
        azimuths = [towards_rad + turn for turn in TURNS_RAD] if x <= widest_m else []
    else:
        # The hand points along one side, so its fingers close across the other one.
        sides = [(yaw_rad, y), (yaw_rad + math.pi / 2, x), (yaw_rad + math.pi, y), (yaw_rad - math.pi / 2, x)]
        azimuths = [azimuth for azimuth, across_m in sides if across_m <= widest_m]
        azimuths.sort(key=lambda azimuth: abs(math.remainder(azimuth - towards_rad, 2 * math.pi)))
    grasp_m = max(min(ABOVE_TABLE_M, height / 2), height - BELOW_TOP_M)
    for pitch_rad in PITCHES_RAD:
        # The flatter the hand, the nearer to the object's middle; but never into the table.
        share = math.sin(pitch_rad)
        z = top_m + share * grasp_m + (1 - share) * max(min(ABOVE_TABLE_M, grasp_m), 0.55 * height)
        for azimuth in azimuths:
            yield hand_pose(np.array([shape.pose[0, 3], shape.pose[1, 3], z]), azimuth, pitch_rad)


def places(view: TableView, held: Shape, shoulder: Floats) -> Iterator[Floats]:
    """Return poses X_BT of the hand that put down what it holds, the best first.

    Args:
        view: the table.
        held: what is in the hand, with X_TO as its pose; it stood when it was grasped.
        shoulder: (3,), m, from where the arm reaches.
    """
    in_object = np.linalg.inv(held.pose)
    along = in_object[:2, 0] if np.linalg.norm(in_object[:2, 0]) > 0.3 else in_object[:2, 2]
    hand_rad = math.atan2(along[1], along[0])
    for x, y in _free_places(view, held):
        towards_rad = math.atan2(y - shoulder[1], x - shoulder[0])
        for turn in TURNS_RAD[:5]:
            place = (x, y, view.top_m + held.size_m[2] / 2 + DROP_M)
            yield upright_pose(place, towards_rad + turn - hand_rad) @ in_object


def _free_places(view: TableView, held: Shape) -> list[tuple[float, float]]:
    """Return places on the table with nothing near, those straight ahead and near to the robot first.

    Places near the edge come last.
    """
    table = view.table
    half_m = np.array(table.size_m[:2]) / 2
    counts = (half_m - LEAST_FROM_EDGE_M) // PLACE_STEP_M
    steps = [PLACE_STEP_M * np.arange(-count, count + 1) for count in counts]
    on_table_m = np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 2)
    places_m = on_table_m @ table.pose[:2, :2].T + table.pose[:2, 3]
    room_m = np.full(len(places_m), np.inf)
    for one in view.objects:
        beside_m = np.abs((places_m - one.pose[:2, 3]) @ one.pose[:2, :2]) - np.array(one.size_m[:2]) / 2
        room_m = np.minimum(room_m, np.hypot(*np.maximum(beside_m, 0.0).T))
    free = room_m > math.hypot(*held.size_m[:2]) / 2 + APART_M
    is_near_edge = (half_m - np.abs(on_table_m) < FROM_EDGE_M).any(axis=1)
    ahead_m = places_m[:, 0].min(initial=np.inf) + FROM_EDGE_M
    order = np.lexsort((np.hypot(places_m[:, 0] - ahead_m, places_m[:, 1]), is_near_edge))
    return [(x, y) for x, y in places_m[order[free[order]]].tolist()]
