"""Reads arenas from YAML files; every error names the file and the line."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from strenum import StrEnum

from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import (
    POST_RADIUS_M,
    AppearingObstacle,
    ArenaPerson,
    ArenaVictim,
    BoardFont,
    Colour,
    Figure,
    HazardSign,
    NumberSign,
    Sheet,
    SignKind,
    StandingObject,
    Table,
    VictimKind,
    WallSpot,
)
from robbie_robots.hw.simulation.arena_drawing import ArenaDrawing, DrawingError
from robbie_robots.hw.simulation.aruco import TAG_COUNT
from robbie_robots.hw.simulation.box_segments import box_segments
from robbie_robots.hw.simulation.doors import Door
from robbie_robots.hw.simulation.yaml_map import ArenaError, YamlMap, read_yaml_map

__all__ = ["ArenaError", "read_arena"]

KEYS = (
    "cell_m",
    "drawing",
    "start_heading_rad",
    "wall_height_m",
    "segments",
    "boxes",
    "circles",
    "victims",
    "signs",
    "appearing",
    "numbers",
    "sheet",
    "tables",
    "objects",
    "people",
    "doors",
)
OBJECT_KEYS = ("name", "box", "can", "x_m", "y_m", "yaw_rad", "print")
NUMBER_KEYS = ("text", "x_m", "y_m", "facing_rad", "height_m", "edge_m", "font", "light", "shadow")
DOOR_KEYS = ("name", "leaf", "opens_rad", "open")
PERSON_KEYS = ("name", "way", "speed_m_per_s", "from_s", "walks", "shirt", "trousers")
SPOT_KEYS = ("x_m", "y_m", "height_m", "facing_rad")
# Maximum distance of victims and signs from their wall.
MAX_FROM_WALL_M = 0.05
# Brighter paper than this would be white all over.
MAX_LIGHT = 1.05
# A person's way keeps this far from walls and obstacles; it is checked at points this far apart.
PERSON_ROOM_M, PERSON_STEP_M = 0.2, 0.1
# A point this far in front of a victim or sign must be free.
IN_FRONT_M = 0.2


def read_arena(path: Path | str) -> Arena:
    """Read an arena from a YAML file.

    The file has these keys; the first two are required:

    - `cell_m`: edge of one character of the drawing, m.
    - `drawing`: a block (`drawing: |`) of lines of equal length: `#` wall, `.` or space free, `o` round
      obstacle as wide as a cell, `R` where the robot starts. The last line is at y = 0.
    - `start_heading_rad`: the robot's first heading, 0 (along x) if absent.
    - `wall_height_m`: height of walls and obstacles, 1.2 if absent.
    - `segments`: a list of thin walls `[x1, y1, x2, y2]`, m.
    - `boxes`: a list of boxes by two opposite corners `[x1, y1, x2, y2]`, m.
    - `circles`: a list of round obstacles `[x, y, radius]`, m.
    - `victims`: a list of maps: `tag` (0 to 49), `x_m`, `y_m`, `facing_rad` (out of the wall), `height_m` (of
      the middle of the tag, 0.35 if absent), `kind` (still, moving or cold; still if absent).
    - `signs`: a list of maps: `kind`, and `x_m`, `y_m`, `facing_rad`, `height_m` as for victims.
    - `appearing`: temporary obstacles, a list of maps: `circle: [x, y, radius]` or
      `box: [x1, y1, x2, y2]`, `from_s`, and `until_s` if it disappears again; in s since the start.
    - `numbers`: boards on posts, a list of maps: `text` (a character, or arrow_left, ring, …), `x_m` and
      `y_m` of the post, `facing_rad`; and if they differ from 0.75, 0.45, DejaVuSans, 1 and 0: `height_m`
      (of the board's middle), `edge_m`, `font`, `light` (0 to 1.05), `shadow` (share of the board in it).
    - `sheet`: a map: the digits `text`, `x_m`, `y_m`, `facing_rad`, `height_m` as for victims. Somebody holds
      it up until the robot drives.
    - `tables`: closed tables, a list of maps: `name`, `box: [x1, y1, x2, y2]` by two opposite corners, and
      `height_m` of the top.
    - `objects`: what stands on them, a list of maps: `name`, `box: [x, y, z]` or `can: [diameter, height]`,
      `x_m`, `y_m`, `yaw_rad` if it is turned, and `print` if something is printed on it: a whole number, the
      seed of the print.
    - `people`: people who walk, a list of maps: `name`; `way`, a list of way points `[x, y, pause_s]`;
      `speed_m_per_s` (0.6 if absent); `from_s`, when the person begins to walk (0 if absent); `walks`:
      `to_and_fro` (if absent), `in_a_loop`, or `across`: to and fro, close behind the first person; `shirt`
      and `trousers`: colours, `[red, green, blue]`.
    - `doors`: a list of maps: `name`; `leaf: [x1, y1, x2, y2]`, the closed leaf from the hinge to the other
      edge, m; `opens_rad`, how far it turns, counter-clockwise if positive; `open`: whether it is open at the
      start (false if absent).

    Raises:
        ArenaError: the file is invalid; the message names the line.
        OSError: the file cannot be read.
    """
    return _ArenaReader(read_yaml_map(Path(path), "an arena", KEYS)).arena()


class Walk(StrEnum):
    """How a person walks."""

    TO_AND_FRO = "to_and_fro"
    LOOP = "in_a_loop"
    ACROSS = "across"


class _ArenaReader:
    """Builds an arena from a file: first walls and obstacles, then victims and signs."""

    def __init__(self, file: YamlMap) -> None:
        self._file = file
        self._cell_m = file.positive("cell_m")
        self._drawing = _drawing(file)
        self._tables = _tables(file)
        boxes, _ = file.rows("boxes", 4)
        sides = np.array([table.corners_m for table in self._tables]).reshape(-1, 4)
        self._boxes = np.concatenate([boxes, sides])
        self._circles = _circles(file)
        self._check_start()
        self._walls = self._solid()

    def arena(self) -> Arena:
        numbers = _numbers(self._file)
        posts = np.array([(sign.x_m, sign.y_m, POST_RADIUS_M) for sign in numbers]).reshape(-1, 3)
        return replace(
            self._walls,
            circles=np.concatenate([self._walls.circles, posts]),
            victims=self._victims(),
            signs=self._signs(),
            appearing=_appearing(self._file),
            numbers=numbers,
            sheet=_sheet(self._file),
            tables=self._tables,
            objects=_objects(self._file, self._tables),
            people=self._people(),
            doors=_doors(self._file),
        )

    def _solid(self) -> Arena:
        drawing, cell_m = self._drawing, self._cell_m
        thin, _ = self._file.rows("segments", 4)
        return Arena(
            segments=np.concatenate([drawing.wall_segments(cell_m), thin, box_segments(self._boxes)]),
            circles=np.concatenate([drawing.round_obstacles(cell_m), self._circles]),
            start=Pose(*drawing.start_m(cell_m), self._file.number("start_heading_rad", 0.0)),
            width_m=drawing.columns * cell_m,
            height_m=drawing.rows * cell_m,
            wall_height_m=self._file.positive("wall_height_m", 1.2),
        )

    def _check_start(self) -> None:
        x, y = self._drawing.start_m(self._cell_m)
        if self._in_box(x, y):
            node = self._file.node("boxes" if "boxes" in self._file else "tables")
            self._file.fail(node, f"the robot's start ({x:g}, {y:g}) lies within a box or table")
        if self._in_circle(x, y):
            node = self._file.node("circles")
            self._file.fail(node, f"the robot's start ({x:g}, {y:g}) lies within a circle")

    def _in_box(self, x: float, y: float) -> bool:
        x1, y1, x2, y2 = self._boxes.T
        within_x = (np.minimum(x1, x2) <= x) & (x <= np.maximum(x1, x2))
        return bool(np.any(within_x & (np.minimum(y1, y2) <= y) & (y <= np.maximum(y1, y2))))

    def _in_circle(self, x: float, y: float) -> bool:
        return bool(np.any(np.hypot(self._circles[:, 0] - x, self._circles[:, 1] - y) <= self._circles[:, 2]))

    def _victims(self) -> tuple[ArenaVictim, ...]:
        victims: dict[int, ArenaVictim] = {}
        for entry in self._file.maps("victims", "a victim", ("tag", "kind", *SPOT_KEYS)):
            tag = entry.number("tag")
            if tag not in range(TAG_COUNT):
                entry.fail(entry.node("tag"), f"tag must be a whole number from 0 to {TAG_COUNT - 1}")
            if tag in victims:
                entry.fail(entry.node("tag"), f"another victim has the tag {tag:g} already")
            kind = entry.name("kind", VictimKind, VictimKind.STILL)
            victims[int(tag)] = ArenaVictim(int(tag), kind, self._spot(entry))
        return tuple(victims.values())

    def _signs(self) -> tuple[HazardSign, ...]:
        entries = self._file.maps("signs", "a sign", ("kind", *SPOT_KEYS))
        return tuple(
            HazardSign(entry.name("kind", SignKind, SignKind.EXPLOSIVE), self._spot(entry))
            for entry in entries
        )

    def _people(self) -> tuple[ArenaPerson, ...]:
        people: dict[str, ArenaPerson] = {}
        for entry in self._file.maps("people", "a person", PERSON_KEYS):
            name = entry.text("name")
            if name in people:
                entry.fail(entry.node("name"), f"another person is called {name!r} already")
            walks = entry.name("walks", Walk, Walk.TO_AND_FRO)
            people[name] = ArenaPerson(
                name,
                self._way(entry, walks is Walk.LOOP),
                entry.positive("speed_m_per_s", 0.6),
                entry.number("from_s", 0.0),
                walks is Walk.LOOP,
                walks is Walk.ACROSS,
                _colour(entry, "shirt", (190, 40, 40)),
                _colour(entry, "trousers", (50, 60, 110)),
            )
        return tuple(people.values())

    def _way(self, entry: YamlMap, is_loop: bool) -> tuple[tuple[float, float, float], ...]:
        """Read the way points of a person; check that the person fits everywhere between them."""
        way, nodes = entry.rows("way", 3)
        if len(way) < 2:
            entry.fail(entry.node("way"), "a way needs at least two points [x, y, pause_s]")
        ends = [*way[1:], way[0]] if is_loop else way[1:]
        for begin, end, node in zip(way, ends, nodes, strict=False):
            count = max(2, int(math.dist(begin[:2], end[:2]) / PERSON_STEP_M) + 1)
            points = np.linspace(begin[:2], end[:2], count)
            inside = [self._in_box(*point) or self._in_circle(*point) for point in points]
            tight = np.flatnonzero((self._walls.clearance_m(points) < PERSON_ROOM_M) | inside)
            if len(tight):
                x, y = points[tight[0]]
                entry.fail(node, f"on the way from here, there is no room for a person at ({x:.2f}, {y:.2f})")
        return tuple((float(x), float(y), float(pause_s)) for x, y, pause_s in way)

    def _spot(self, entry: YamlMap) -> WallSpot:
        """Read a place on a wall; check that the wall is there and that the space in front is free."""
        x, y, facing = entry.number("x_m"), entry.number("y_m"), entry.number("facing_rad")
        distance_m = float(self._walls.clearance_m(np.array([x, y])))
        if distance_m > MAX_FROM_WALL_M:
            place = f"({x:g}, {y:g})"
            entry.fail(None, f"{place} is not on a wall: the nearest wall is {distance_m:.2f} m away")
        front = x + IN_FRONT_M * math.cos(facing), y + IN_FRONT_M * math.sin(facing)
        # The point in front must lie straight away from the wall, not in or behind anything.
        if (
            self._walls.clearance_m(np.array(front)) < 0.9 * IN_FRONT_M
            or self._drawing.is_wall(*front, self._cell_m)
            or self._in_box(*front)
            or self._in_circle(*front)
        ):
            what = f"out of the wall at ({x:g}, {y:g}), with {IN_FRONT_M:g} m of free space around"
            entry.fail(entry.node("facing_rad"), f"facing_rad must point {what}")
        return WallSpot(x, y, entry.positive("height_m", 0.35), facing)


def _drawing(file: YamlMap) -> ArenaDrawing:
    lines, first = file.block("drawing")
    try:
        return ArenaDrawing(lines)
    except DrawingError as error:
        file.fail_at(first + error.row, str(error))


def _circles(file: YamlMap) -> NDArray[np.float64]:
    circles, nodes = file.rows("circles", 3)
    for (_, _, radius), node in zip(circles, nodes, strict=True):
        if radius <= 0:
            file.fail(node, f"the radius of a circle must be greater than 0, not {radius:g}")
    return circles


def _tables(file: YamlMap) -> tuple[Table, ...]:
    tables: dict[str, Table] = {}
    for entry in file.maps("tables", "a table", ("name", "box", "height_m")):
        name = entry.text("name")
        if name in tables:
            entry.fail(entry.node("name"), f"another table has the name {name!r} already")
        x1, y1, x2, y2 = entry.row("box", 4)
        if x1 == x2 or y1 == y2:
            entry.fail(entry.node("box"), "the box of a table must have an area")
        tables[name] = Table(name, (x1, y1, x2, y2), entry.positive("height_m"))
    return tuple(tables.values())


def _objects(file: YamlMap, tables: tuple[Table, ...]) -> tuple[StandingObject, ...]:
    """Read what stands on the tables."""
    objects: dict[str, StandingObject] = {}
    for entry in file.maps("objects", "an object", OBJECT_KEYS):
        name = entry.text("name")
        if name in objects:
            entry.fail(entry.node("name"), f"another object has the name {name!r} already")
        if ("box" in entry) == ("can" in entry):
            entry.fail(None, "an object is either a box or a can")
        is_round = "can" in entry
        row = entry.row("can", 2) if is_round else entry.row("box", 3)
        if min(row) <= 0:
            entry.fail(entry.node("can" if is_round else "box"), "the size of an object must be positive")
        x, y = entry.number("x_m"), entry.number("y_m")
        below = next((table for table in tables if table.is_below(x, y)), None)
        if below is None:
            entry.fail(entry.node("x_m"), f"no table is below the object at ({x:g}, {y:g})")
        size = (row[0], row[0], row[1]) if is_round else (row[0], row[1], row[2])
        yaw_rad = entry.number("yaw_rad", 0.0)
        seed = entry.number("print", 0.0)
        if seed != int(seed) or seed < 0:
            entry.fail(entry.node("print"), f"print must be a whole number from 0, not {seed:g}")
        print_seed = int(seed) if "print" in entry else None
        objects[name] = StandingObject(name, size, is_round, x, y, below.height_m, yaw_rad, print_seed)
    return tuple(objects.values())


def _appearing(file: YamlMap) -> tuple[AppearingObstacle, ...]:
    obstacles = []
    for entry in file.maps("appearing", "an appearing obstacle", ("circle", "box", "from_s", "until_s")):
        if ("circle" in entry) == ("box" in entry):
            entry.fail(None, "an appearing obstacle needs either a circle or a box, not both")
        shape = entry.row("circle", 3) if "circle" in entry else entry.row("box", 4)
        if len(shape) == 3 and shape[2] <= 0:
            entry.fail(
                entry.node("circle"), f"the radius of a circle must be greater than 0, not {shape[2]:g}"
            )
        obstacle = AppearingObstacle(shape, entry.number("from_s"), entry.number("until_s", math.inf))
        if obstacle.until_s <= obstacle.from_s:
            entry.fail(entry.node("until_s"), "until_s must be later than from_s")
        obstacles.append(obstacle)
    return tuple(obstacles)


def _doors(file: YamlMap) -> tuple[Door, ...]:
    doors: dict[str, Door] = {}
    for entry in file.maps("doors", "a door", DOOR_KEYS):
        name = entry.text("name")
        if name in doors:
            entry.fail(entry.node("name"), f"another door has the name {name!r} already")
        x1, y1, x2, y2 = entry.row("leaf", 4)
        if (x1, y1) == (x2, y2):
            entry.fail(entry.node("leaf"), "the leaf of a door must have a length")
        opens_rad = entry.number("opens_rad")
        if not 0.0 < abs(opens_rad) <= math.pi:
            entry.fail(
                entry.node("opens_rad"), f"opens_rad must be from -pi to pi and not 0, not {opens_rad:g}"
            )
        doors[name] = Door(name, (x1, y1), (x2, y2), opens_rad, entry.flag("open", default=False))
    return tuple(doors.values())


def _numbers(file: YamlMap) -> tuple[NumberSign, ...]:
    """Read the boards with digits."""
    signs = []
    for entry in file.maps("numbers", "a board", NUMBER_KEYS):
        text = entry.text("text")
        if len(text) != 1 and text not in list(Figure):
            what = f"text must be one character, or one of {', '.join(Figure)}; not {text!r}"
            entry.fail(entry.node("text"), what)
        shadow, light = entry.number("shadow", 0.0), entry.number("light", 1.0)
        if not 0.0 <= shadow <= 1.0:
            entry.fail(entry.node("shadow"), f"shadow must be from 0 to 1, not {shadow:g}")
        if not 0.0 <= light <= MAX_LIGHT:
            entry.fail(entry.node("light"), f"light must be from 0 to {MAX_LIGHT:g}, not {light:g}")
        signs.append(
            NumberSign(
                text,
                entry.number("x_m"),
                entry.number("y_m"),
                entry.number("facing_rad"),
                entry.positive("height_m", 0.75),
                entry.positive("edge_m", 0.45),
                entry.name("font", BoardFont, BoardFont.SANS),
                light,
                shadow,
            )
        )
    return tuple(signs)


def _colour(entry: YamlMap, key: str, default: Colour) -> Colour:
    if key not in entry:
        return default
    red, green, blue = (round(value) for value in entry.row(key, 3))
    if not all(0 <= value <= 255 for value in (red, green, blue)):
        entry.fail(entry.node(key), f"{key} must be [red, green, blue], each from 0 to 255")
    return red, green, blue


def _sheet(file: YamlMap) -> Sheet | None:
    """Read the sheet with the order, if there is one."""
    if "sheet" not in file:
        return None
    entry = file.one_map("sheet", "a sheet", ("text", *SPOT_KEYS))
    text = entry.text("text")
    if not text.isascii() or not text.isdigit() or len(set(text)) != len(text):
        entry.fail(entry.node("text"), f"text must be digits, each at most once, not {text!r}")
    spot = WallSpot(
        entry.number("x_m"),
        entry.number("y_m"),
        entry.positive("height_m", 0.35),
        entry.number("facing_rad"),
    )
    return Sheet(text, spot)
