"""Poses in the plane, and how a differential drive changes them."""

import math
from typing import NamedTuple


class Pose(NamedTuple):
    """A place and a heading in the plane, in the frame that the context names (REP 103: x ahead, y left)."""

    x_m: float
    y_m: float
    heading_rad: float

    def after_arc(self, distance_m: float, turn_rad: float) -> "Pose":
        """Return the pose after driving an arc of constant curvature.

        Args:
            distance_m: length of the arc, negative when driving backwards.
            turn_rad: change of heading over the arc.
        """
        # The chord of an arc points half the turn away from the start and is sin(h)/h as long as the arc.
        half = turn_rad / 2
        chord_m = distance_m * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        direction = self.heading_rad + half
        return Pose(
            self.x_m + chord_m * math.cos(direction),
            self.y_m + chord_m * math.sin(direction),
            wrapped(self.heading_rad + turn_rad),
        )

    def plus(self, offset: "Pose") -> "Pose":
        """Return the pose of something mounted at `offset` in this pose's own frame."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return Pose(
            self.x_m + cos * offset.x_m - sin * offset.y_m,
            self.y_m + sin * offset.x_m + cos * offset.y_m,
            wrapped(self.heading_rad + offset.heading_rad),
        )


ORIGIN = Pose(0.0, 0.0, 0.0)


def wrapped(angle_rad: float) -> float:
    """Return the same angle within (-pi, pi]."""
    return math.pi - (math.pi - angle_rad) % (2 * math.pi)
