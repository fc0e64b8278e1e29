"""What the operator sees: the map as the tile Map draws it, and the robot on it."""

import base64
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

CELL_M = 0.05
REACH_M = 11.0
"""The operator looks at this much of the map to each side of the robot's start."""
UNKNOWN_GREY = range(160, 181)
WALL_BELOW = 110
LOOK = """([reach, cell]) => {
  const view = Object.values(mounted_app.$refs).find((one) => one?.$el?.id === "map-view");
  if (!view || !view.marks.robot || view.$el.offsetParent === null) return null;
  const camera = document.querySelector(".camera-picture img");
  const side = Math.round(2 * reach / cell);
  const canvas = new OffscreenCanvas(side, side);
  const pen = canvas.getContext("2d");
  pen.fillStyle = "#aaaaaa";
  pen.fillRect(0, 0, side, side);
  pen.translate(side / 2, side / 2);
  pen.scale(1 / cell, -1 / cell);
  view.draw_picture(pen);
  const pixels = pen.getImageData(0, 0, side, side).data;
  const reds = new Uint8Array(side * side);
  for (let at = 0; at < reds.length; at += 1) reds[at] = pixels[4 * at];
  let text = "";
  for (let at = 0; at < reds.length; at += 8192) text += String.fromCharCode(...reds.subarray(at, at + 8192));
  return { robot: view.marks.robot, side, reds: btoa(text), camera: camera?.naturalWidth ?? 0 };
}"""
ROBOT = """() => {
  const view = Object.values(mounted_app.$refs).find((one) => one?.$el?.id === "map-view");
  return view && view.$el.offsetParent !== null ? view.marks.robot : null;
}"""


class NothingSeen(RuntimeError):
    """The map is not in sight, or shows no robot."""


@dataclass(frozen=True)
class Sight:
    """The map tile.

    Attributes:
        cells: occupancy `(H, W) int8`, row 0 at the smallest y: 100 wall, 0 free, -1 unknown.
        corner_m: x and y of the outer corner of cell (0, 0), m.
        robot: x, y (m) and heading (rad), as the map draws it.
        camera_pixels: width of the picture in the camera's tile; 0: none is in sight.
    """

    cells: NDArray[np.int8]
    corner_m: tuple[float, float]
    robot: tuple[float, float, float]
    camera_pixels: int


def look(page: Page) -> Sight:
    """Look at the map. It is the picture that the tile draws, without the marks on it.

    Raises:
        NothingSeen: the map is not in sight, or shows no robot.
    """
    seen = page.evaluate(LOOK, [REACH_M, CELL_M])
    if seen is None:
        raise NothingSeen("the tile Map shows no robot")
    reds = np.frombuffer(base64.b64decode(seen["reds"]), np.uint8).reshape(seen["side"], seen["side"])[::-1]
    cells = np.where(reds < WALL_BELOW, np.int8(100), np.int8(0))
    cells[(reds >= UNKNOWN_GREY.start) & (reds < UNKNOWN_GREY.stop)] = -1
    x, y, heading = seen["robot"]
    return Sight(cells, (-REACH_M, -REACH_M), (x, y, heading), int(seen["camera"]))


def look_at_robot(page: Page) -> tuple[float, float, float]:
    """Return x, y (m) and heading (rad) of the robot as the map draws it now.

    Raises:
        NothingSeen: the map is not in sight, or shows no robot.
    """
    seen = page.evaluate(ROBOT)
    if seen is None:
        raise NothingSeen("the tile Map shows no robot")
    return float(seen[0]), float(seen[1]), math.remainder(float(seen[2]), 2 * math.pi)
