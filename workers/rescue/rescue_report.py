"""The report of a rescue mission: map, victims, figures.

The map is a PNG file in the colours of the RoboCup Rescue League's rule for GeoTIFF maps (Kleiner et al.,
"RoboCup Rescue virtual robots: map data format", 2009). The victims are a CSV file, the rule's victim list.
"""

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

from robbie_robots.workers.maps.navigation_grid import OCCUPIED_PERCENT
from robbie_robots.workers.rescue.mission_targets import SearchedGrid
from robbie_robots.workers.rescue.mission_victims import VictimReport
from robbie_robots.workers.rescue.searched_walls import SEARCHED
from robbie_robots.workers.rescue.victim_map import VictimState

PX_PER_M = 40
BORDER_M = 0.5
UNKNOWN_LIGHT, UNKNOWN_DARK = (237, 237, 238), (226, 226, 227)
FREE, GRID_LINE, WALL = (255, 255, 255), (190, 190, 191), (0, 40, 120)
SEARCHED_GREEN = (130, 230, 130)
PATH, START, VICTIM, INK = (120, 0, 140), (255, 200, 0), (240, 10, 10), (0, 44, 207)
SUSPECTED = (255, 100, 30)
VICTIM_M, START_M = 0.3, 0.4


@dataclass(frozen=True)
class MissionFigures:
    """The figures of a mission.

    Attributes:
        state: the last state.
        reason: why the mission entered it.
        duration_s: how long the mission took.
        battery: the charge that was left, as a ratio. None if it is not known.
        notes: what went wrong.
        collisions: how often the bumper was pressed. None if there is no bumper.
    """

    state: str
    reason: str
    duration_s: float
    battery: float | None
    notes: Sequence[str]
    collisions: int | None = None


Map = tuple[NDArray[np.int8], float, ArrayLike]
"""Occupancy in percent `(H, W)`, row 0 at the smallest y, -1 unknown; edge of a cell, m; corner, m."""


def write_report(
    write: Callable[[str, str | bytes], None],
    name: str,
    figures: MissionFigures,
    made_map: Map | None,
    searched: SearchedGrid | None,
    victims: Sequence[VictimReport],
    path_m: Sequence[tuple[float, float]],
    home: ArrayLike | None,
    number: int = 1,
) -> list[str]:
    """Write `NAME_map.png` (if there is a map), `NAME_victims.csv` and `mission.json`; return their names.

    Args:
        write: writes a file, given its name and content.
        name: prefix of the files' names.
        figures: the mission's figures.
        made_map: the newest map.
        searched: which walls were searched.
        victims: all reported victims.
        path_m: where the robot was, m, map frame.
        home: x, y (m) and heading (rad) where the mission began.
        number: of the mission in the run; from the second on, it follows the names of the files.
    """
    ending = "" if number == 1 else f"_{number}"
    names = [f"{name}_victims{ending}.csv", f"mission{ending}.json"]
    if made_map is not None:
        picture = RescuePicture(*made_map)
        if searched is not None:
            picture.draw_searched(searched)
        picture.draw_path(path_m)
        if home is not None:
            picture.draw_start(home)
        for victim in victims:
            picture.draw_victim(victim)
        names.append(f"{name}_map{ending}.png")
        write(names[-1], picture.png(names[-1]))
    write(names[0], _victims_csv(victims))
    described = {
        **asdict(figures),
        "notes": list(figures.notes),
        "travelled_m": round(travelled_m(path_m), 2),
        "mapped_m2": None if made_map is None else round(known_m2(*made_map[:2]), 2),
        "victims": [{**asdict(victim), "state": victim.state.name} for victim in victims],
    }
    write(names[1], json.dumps(described, indent=2) + "\n")
    return names


def travelled_m(path_m: Sequence[tuple[float, float]]) -> float:
    """Return the length of a way, m."""
    return sum(math.dist(*pair) for pair in pairwise(path_m))


def known_m2(cells: NDArray[np.int8], resolution_m: float) -> float:
    """Return the area of the cells that are not unknown, m²."""
    return float((cells >= 0).sum()) * resolution_m**2


def _victims_csv(victims: Sequence[VictimReport]) -> str:
    """Return a table of the victims that the operator has not rejected."""
    table = io.StringIO()
    writer = csv.writer(table)
    writer.writerow(("id", "time", "name", "x", "y", "z", "confirmed"))
    for victim in sorted(victims, key=lambda victim: victim.found_s):
        if victim.state is not VictimState.REJECTED:
            time = datetime.fromtimestamp(victim.found_s, timezone.utc).strftime("%H:%M:%S")
            place = [f"{value:.3f}" for value in (victim.x_m, victim.y_m, victim.z_m)]
            confirmed = "yes" if victim.state is VictimState.CONFIRMED else "no"
            writer.writerow((victim.id, time, victim.name, *place, confirmed))
    return table.getvalue()


class RescuePicture:
    """A map in the colours of RoboCup Rescue; up is y, right is x."""

    def __init__(self, cells: NDArray[np.int8], resolution_m: float, corner_xy_m: ArrayLike) -> None:
        corner = np.asarray(corner_xy_m, float)
        known = np.argwhere(cells >= 0)[:, ::-1] * resolution_m + corner
        if len(known) == 0:
            known = np.zeros((1, 2))
        self._low = np.floor(known.min(axis=0) - BORDER_M)
        self._high = np.ceil(known.max(axis=0) + BORDER_M)
        width, height = ((self._high - self._low) * PX_PER_M).astype(int)
        # The middle of each pixel, m, map frame.
        x = self._low[0] + (np.arange(width) + 0.5) / PX_PER_M
        y = self._high[1] - (np.arange(height) + 0.5) / PX_PER_M
        self._places = np.stack(np.meshgrid(x, y), axis=-1)
        values = _values_at(cells, resolution_m, corner, self._places)
        colours = np.empty((height, width, 3), np.uint8)
        chess = np.floor(self._places).astype(int).sum(axis=-1) & 1
        colours[:] = np.where(chess[..., None], UNKNOWN_DARK, UNKNOWN_LIGHT)
        colours[values >= 0] = FREE
        # Grid lines every half metre on the explored area.
        near_line = (np.abs(self._places / 0.5 - np.rint(self._places / 0.5)) < 0.5 / PX_PER_M).any(axis=-1)
        colours[(values >= 0) & near_line] = GRID_LINE
        colours[values >= OCCUPIED_PERCENT] = WALL
        self._set(colours)

    def draw_searched(self, searched: SearchedGrid) -> None:
        """Draw in green which walls were searched."""
        colours = np.array(self._image)
        values = _values_at(searched.cells, searched.resolution_m, searched.corner_xy_m, self._places)
        colours[values == SEARCHED] = SEARCHED_GREEN
        self._set(colours)

    def draw_path(self, path_m: Sequence[tuple[float, float]]) -> None:
        """Draw where the robot was."""
        if len(path_m) > 1:
            self._draw.line([self._pixel(place) for place in path_m], fill=PATH, width=2)

    def draw_start(self, pose: ArrayLike) -> None:
        """Draw the place and heading in which the robot began, as an arrow."""
        x, y, heading = np.asarray(pose, float)
        corners = [
            (x + length * math.cos(heading + turn), y + length * math.sin(heading + turn))
            for length, turn in ((START_M, 0.0), (START_M / 2, 2.4), (START_M / 2, -2.4))
        ]
        self._draw.polygon([self._pixel(corner) for corner in corners], fill=START, outline=INK)

    def draw_victim(self, victim: VictimReport) -> None:
        """Draw a victim, with its number: red if it is confirmed, orange if it is suspected."""
        if victim.state is VictimState.REJECTED:
            return
        x, y = self._pixel((victim.x_m, victim.y_m))
        half = VICTIM_M / 2 * PX_PER_M + 3
        fill = VICTIM if victim.state is VictimState.CONFIRMED else SUSPECTED
        self._draw.ellipse((x - half, y - half, x + half, y + half), fill=fill)
        self._draw.text((x, y), str(victim.id), fill="white", anchor="mm", font=ImageFont.load_default())

    def png(self, title: str) -> bytes:
        """Return the picture as PNG, with scale, directions and a title."""
        font = ImageFont.load_default()
        self._draw.text((6, 4), title, fill=INK, font=font)
        self._draw.line((10, 26, 10 + PX_PER_M, 26), fill=INK, width=2)
        self._draw.text((16 + PX_PER_M, 20), "1 m", fill=INK, font=font)
        right = self._image.width - 50
        self._draw.line((right, 40, right, 10), fill=INK, width=2)
        self._draw.line((right, 40, right + 30, 40), fill=INK, width=2)
        self._draw.text((right - 12, 6), "y", fill=INK, font=font)
        self._draw.text((right + 34, 34), "x", fill=INK, font=font)
        encoded = io.BytesIO()
        self._image.save(encoded, "PNG")
        return encoded.getvalue()

    def _set(self, colours: NDArray[np.uint8]) -> None:
        self._image = Image.fromarray(colours)
        self._draw = ImageDraw.Draw(self._image)

    def _pixel(self, place_m: tuple[float, float]) -> tuple[float, float]:
        return (place_m[0] - self._low[0]) * PX_PER_M, (self._high[1] - place_m[1]) * PX_PER_M


def _values_at(
    cells: NDArray[np.int8], resolution_m: float, corner_m: NDArray[np.float64], places: NDArray[np.float64]
) -> NDArray[np.int8]:
    """Return the cells' values at places `(..., 2)`, m, map frame; -1 beyond the grid."""
    column, row = np.moveaxis(np.floor((places - corner_m) / resolution_m).astype(int), -1, 0)
    inside = (row >= 0) & (row < cells.shape[0]) & (column >= 0) & (column < cells.shape[1])
    return np.where(inside, cells[np.where(inside, row, 0), np.where(inside, column, 0)], np.int8(-1))
