"""Reads arenas from YAML files; every error names the file and the line."""

import math
from pathlib import Path
from typing import NoReturn

import numpy as np
import yaml

from hw.arena import Arena
from hw.arena_drawing import Drawing, DrawingError
from hw.pose import Pose

KEYS = ("cell_m", "drawing", "start_heading_rad", "segments", "boxes", "circles")


class ArenaError(ValueError):
    """An arena file that cannot be used; the text says the file, the line, and what was expected."""


def read_arena(path: Path | str) -> Arena:
    """Read an arena from a YAML file.

    The file has these keys; the first two are required:

    - `cell_m`: edge of one character of the drawing, m.
    - `drawing`: a block (`drawing: |`) of lines of equal length: `#` wall, `.` or space free, `o` round
      obstacle as wide as a cell, `R` where the robot starts. The last line is at y = 0.
    - `start_heading_rad`: the robot's first heading, 0 (along x) if absent.
    - `segments`: a list of thin walls `[x1, y1, x2, y2]`, m.
    - `boxes`: a list of boxes by two opposite corners `[x1, y1, x2, y2]`, m.
    - `circles`: a list of round obstacles `[x, y, radius]`, m.

    Raises:
        ArenaError: the file is not such a file; the text names the line.
        OSError: the file cannot be read.
    """
    return _ArenaReader(Path(path)).arena()


class _ArenaReader:
    """Turns the YAML nodes of one file, which know their lines, into an arena."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._nodes = self._compose()

    def arena(self) -> Arena:
        cell_m = self._number(self._required("cell_m"))
        if cell_m <= 0:
            self._fail(self._nodes["cell_m"], f"cell_m must be greater than 0, not {cell_m:g}")
        drawing = self._drawing()
        boxes = self._rows("boxes", 4)
        circles = self._rows("circles", 3)
        start = drawing.start_m(cell_m)
        self._check_start(start, boxes, circles)
        heading = self._nodes.get("start_heading_rad")
        walls = [drawing.wall_segments(cell_m), self._rows("segments", 4), box_segments(boxes)]
        return Arena(
            segments=np.concatenate(walls),
            circles=np.concatenate([drawing.round_obstacles(cell_m), circles]),
            start=Pose(*start, self._number(heading) if heading else 0.0),
            width_m=drawing.columns * cell_m,
            height_m=drawing.rows * cell_m,
        )

    def _compose(self) -> dict[str, yaml.Node]:
        try:
            root = yaml.compose(self._path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise ArenaError(f"{self._path}:{line}: not YAML: {error.problem}") from error
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ArenaError(f"{self._path}:1: not YAML in UTF-8: {error}") from error
        if not isinstance(root, yaml.MappingNode):
            raise ArenaError(f"{self._path}:1: an arena is a map with the keys {', '.join(KEYS)}")
        nodes: dict[str, yaml.Node] = {}
        for key, value in root.value:
            if key.value not in KEYS:
                self._fail(key, f"unknown key {key.value!r}; an arena has {', '.join(KEYS)}")
            if key.value in nodes:
                self._fail(key, f"the key {key.value!r} is there twice")
            nodes[key.value] = value
        return nodes

    def _required(self, key: str) -> yaml.Node:
        if key not in self._nodes:
            raise ArenaError(f"{self._path}:1: the key {key!r} is missing")
        return self._nodes[key]

    def _drawing(self) -> Drawing:
        node = self._required("drawing")
        if not isinstance(node, yaml.ScalarNode) or node.style != "|":
            self._fail(node, "drawing must be a block of lines: `drawing: |` and the lines indented below it")
        try:
            return Drawing(node.value.splitlines())
        except DrawingError as error:
            # The block's first line is the one below its key.
            raise ArenaError(f"{self._path}:{node.start_mark.line + 2 + error.row}: {error}") from error

    def _rows(self, key: str, width: int) -> np.ndarray:
        node = self._nodes.get(key)
        if node is None:
            return np.empty((0, width))
        if not isinstance(node, yaml.SequenceNode):
            self._fail(node, f"{key} must be a list of lists of {width} numbers")
        rows = []
        for row in node.value:
            if not isinstance(row, yaml.SequenceNode) or len(row.value) != width:
                self._fail(row, f"each of {key} must be a list of {width} numbers")
            rows.append([self._number(item) for item in row.value])
            if key == "circles" and rows[-1][2] <= 0:
                self._fail(row, f"the radius of a circle must be greater than 0, not {rows[-1][2]:g}")
        return np.array(rows, dtype=np.float64).reshape(-1, width)

    def _number(self, node: yaml.Node) -> float:
        if node.tag not in ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float"):
            self._fail(node, "expected a number")
        number = float(yaml.safe_load(node.value))
        if not math.isfinite(number):
            self._fail(node, f"expected a finite number, not {node.value}")
        return number

    def _check_start(self, start: tuple[float, float], boxes: np.ndarray, circles: np.ndarray) -> None:
        x, y = start
        lower, upper = np.minimum(boxes[:, :2], boxes[:, 2:]), np.maximum(boxes[:, :2], boxes[:, 2:])
        if np.any(np.all((lower <= start) & (start <= upper), axis=1)):
            self._fail(self._nodes["boxes"], f"the robot's start ({x:g}, {y:g}) lies within a box")
        if np.any(np.hypot(circles[:, 0] - x, circles[:, 1] - y) <= circles[:, 2]):
            self._fail(self._nodes["circles"], f"the robot's start ({x:g}, {y:g}) lies within a circle")

    def _fail(self, node: yaml.Node, what: str) -> NoReturn:
        raise ArenaError(f"{self._path}:{node.start_mark.line + 1}: {what}")


def box_segments(boxes: np.ndarray) -> np.ndarray:
    """Return the four sides of each box: (N, 4) corners in, (4 N, 4) segments out, m."""
    x1, y1, x2, y2 = boxes.T
    sides = [(x1, y1, x2, y1), (x2, y1, x2, y2), (x2, y2, x1, y2), (x1, y2, x1, y1)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])
