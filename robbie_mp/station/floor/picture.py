"""What a page draws on the floor in a picture."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from nicegui import ui
from nicegui.element import Element

from robbie_mp.station.live import SCRIPTS

if TYPE_CHECKING:
    from robbie_mp.station.driving.motion import Movement

STYLE = Path(__file__).parent / "floor_picture.css"
STANDS_M_PER_S = 0.02
"""A slower robot has no track."""


class FloorPicture(Element, component="floor_picture.js", esm=SCRIPTS):
    """Draws on the floor in the pictures of a camera, over which it lies.

    Args:
        camera: its name.
    """

    def __init__(self, camera: str) -> None:
        super().__init__()
        ui.add_css(STYLE)
        self._props["camera"] = camera

    def show(self, **properties: object) -> None:
        """Change what is drawn, if it differs."""
        if any(self._props.get(name) != value for name, value in properties.items()):
            self._props.update(properties)
            self.update()


def track_of(now: Movement, width_m: float) -> list[float] | None:
    """Return speed (m/s), turn rate (rad/s) and half the width (m) of a robot's track; None if it has none.

    The track is that of what is commanded, or without a command, of the motion itself.

    Args:
        now: the robot's movement.
        width_m: the robot's width.
    """
    linear, angular = now.commanded_linear, now.commanded_angular
    if linear is None and not now.silent:
        linear, angular = now.linear_m_per_s, now.angular_rad_per_s
    if linear is None or not abs(linear) >= STANDS_M_PER_S:
        return None
    turn = angular if angular is not None and math.isfinite(angular) else 0.0
    return [round(linear, 2), round(turn, 2), round(width_m / 2, 3)] if math.isfinite(linear) else None
