"""Simulated cameras in an arena: one for colours, one for heat."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.camera import Camera, CameraFrame, CameraGeometry
from robbie_robots.hw.pose import Pose
from robbie_robots.hw.simulation.arena import Arena
from robbie_robots.hw.simulation.arena_contents import NumberSign, Sheet, VictimKind
from robbie_robots.hw.simulation.hanging import Hanging
from robbie_robots.hw.simulation.number_board import back_texture, board_texture, sheet_texture
from robbie_robots.hw.simulation.panel_textures import centikelvin, sign_texture, victim_heat, victim_textures
from robbie_robots.hw.simulation.people import PICTURE_S, head_hanging, person_hanging
from robbie_robots.hw.simulation.renderer import Paint, Renderer
from robbie_robots.hw.simulation.texture import Texture

WAVE_S = 0.5
"""Time after which a waving victim changes its picture."""
SHEET_UNTIL_M = 0.3
"""The sheet with the order is taken away when the robot has driven this far."""
STRIPE_M = 0.4
# Brightness falls with the distance and is halved at this distance.
DIM_M = 12.0
WALL_COLOURS = ((196, 198, 190), (176, 186, 196), (186, 190, 176), (168, 174, 184))
REST_COLOURS = ((104, 106, 108), (124, 126, 128), (214, 222, 230))
WALL_CELSIUS, REST_CELSIUS = 20.0, (19.0, 19.0, 20.5)

Pictures = dict[int, list[Hanging]]


class CameraNotPlaced(RuntimeError):
    """The simulated camera was asked for an image before it was placed."""


class SimulatedCamera(Camera):
    """A colour camera with noise. It sees the arena from the place where `place` last put it.

    Args:
        arena: the world; you may replace it when it changes, as long as the victims stay the same.
        geometry: the camera's projection and mounting position.
        noise: standard deviation of pixel values.
        seed: random seed of the noise; the same seed and poses give the same images.
    """

    def __init__(
        self, arena: Arena, geometry: CameraGeometry | None = None, noise: float = 2.0, seed: int = 0
    ) -> None:
        self.arena = arena
        self._geometry = geometry or CameraGeometry()
        self._renderer = Renderer(self._geometry, self._paint())
        self._pictures = {phase: self._hang(phase) for phase in (0, 1)}
        self._sheet = None if arena.sheet is None else self._hang_sheet(arena.sheet)
        self._noise = _Noise(noise, self._geometry, seed)
        self._placed: tuple[Pose, float] | None = None
        self._direction = (0.0, 0.0)
        self.people: NDArray[np.float64] = np.empty((0, 5))
        """Where people are: (P, 5), as `PersonState.shown` of `people.py`; set it before `capture`."""
        self.heads: dict[str, list[Texture]] = {}
        """Pictures of people's heads by their names: see `robbie_robots.hw.simulation.people.read_heads`."""

    @property
    def geometry(self) -> CameraGeometry:
        """Return the camera's projection and mounting position."""
        return self._geometry

    def place(self, robot: Pose, stamp_s: float) -> None:
        """Put the camera's robot at a true pose.

        Args:
            robot: pose of the robot, arena frame.
            stamp_s: when the robot was there.
        """
        self._placed = (robot, stamp_s)

    def look(self, pan_rad: float, tilt_rad: float) -> None:
        """Turn the camera: pan positive to the left, tilt positive below the horizon."""
        self._direction = (pan_rad, tilt_rad)

    def capture(self) -> CameraFrame:
        """Return the image from the last place, with the stamp given there.

        Raises:
            CameraNotPlaced: `place` has not been called.
        """
        if self._placed is None:
            raise CameraNotPlaced("the simulated camera has no pose: call place() before capture()")
        robot, stamp_s = self._placed
        pictures = self._pictures[int(stamp_s / WAVE_S) % 2]
        if self._sheet is not None and math.dist(robot[:2], self.arena.start[:2]) < SHEET_UNTIL_M:
            pictures = [*pictures, self._sheet]
        x, y, _ = self._geometry.mount_m
        pictures = [*pictures, *self._figures(robot.plus(Pose(x, y, 0.0)), stamp_s)]
        image = self._renderer.render(self.arena, robot, self._direction, pictures)
        return CameraFrame(stamp_s, self._noise.added(image))

    def _paint(self) -> Paint:
        return ColourPaint()

    def _hang(self, phase: int) -> list[Hanging]:
        signs = [Hanging(sign.spot, sign_texture(sign)) for sign in self.arena.signs]
        boards = [board for sign in self.arena.numbers for board in _boards(sign)]
        victims = [Hanging(victim.spot, victim_textures(victim)[phase]) for victim in self.arena.victims]
        return [*signs, *boards, *victims]

    def _figures(self, eye: Pose, stamp_s: float) -> list[Hanging]:
        """Return the pictures of people as they are seen from the eye, who look at the eye."""
        figures = []
        for person, shown in zip(self.arena.people, self.people.tolist(), strict=False):
            figures.append(person_hanging(person, shown, eye))
            if heads := self.heads.get(person.name):
                figures.append(head_hanging(heads[int(stamp_s / PICTURE_S) % len(heads)], shown, eye))
        return figures

    def _hang_sheet(self, sheet: Sheet) -> Hanging | None:
        return Hanging(sheet.spot, sheet_texture(sheet.text, sheet.height_m))


class SimulatedThermalCamera(SimulatedCamera):
    """A thermal camera that sees walls, floor and warm victims, in hundredths of a kelvin.

    The unit is that of FLIR's Lepton cameras in their mode TLinear. The noise is in hundredths of a kelvin.
    It does not see people who walk.
    """

    def _paint(self) -> Paint:
        return HeatPaint()

    def _hang(self, phase: int) -> list[Hanging]:
        warm = [victim for victim in self.arena.victims if victim.kind is not VictimKind.COLD]
        return [Hanging(victim.spot, victim_heat(victim)[phase]) for victim in warm]

    def _figures(self, eye: Pose, stamp_s: float) -> list[Hanging]:
        return []

    def _hang_sheet(self, sheet: Sheet) -> Hanging | None:
        return None


class ColourPaint:
    """Paints walls in pale colours with stripes, darker at a distance."""

    def walls(
        self, surfaces: NDArray[np.intp], points_m: NDArray[np.float64], ranges_m: NDArray[np.float64]
    ) -> NDArray[np.uint8]:
        """Return red, green, blue of walls and of their skirting: (2 B, 3)."""
        stripe = np.floor(points_m.sum(axis=1) / STRIPE_M).astype(np.int64) & 1
        light = (1.0 - 0.05 * stripe) * 0.5 ** (ranges_m / DIM_M)
        walls = np.array(WALL_COLOURS)[surfaces % len(WALL_COLOURS)] * light[:, None]
        return np.concatenate([walls, 0.6 * walls]).astype(np.uint8)

    def rest(self) -> NDArray[np.uint8]:
        """Return red, green, blue of tiles and sky: (3, 3)."""
        return np.array(REST_COLOURS, np.uint8)


class HeatPaint:
    """Paints walls, floor and ceiling at almost the same temperature."""

    def walls(
        self, surfaces: NDArray[np.intp], points_m: NDArray[np.float64], ranges_m: NDArray[np.float64]
    ) -> NDArray[np.uint16]:
        """Return the temperature of walls and of their skirting, hundredths of a kelvin: (2 B,)."""
        return centikelvin(np.full(2 * len(surfaces), WALL_CELSIUS))

    def rest(self) -> NDArray[np.uint16]:
        """Return the temperature of tiles and ceiling: (3,)."""
        return centikelvin(np.array(REST_CELSIUS))


def _boards(sign: NumberSign) -> tuple[Hanging, Hanging]:
    """Return front and back of a board on a post."""
    front = board_texture(sign.text, sign.edge_m, sign.font, sign.light, sign.shadow)
    return Hanging(sign.front, front), Hanging(sign.back, back_texture(sign.edge_m, sign.light))


class _Noise:
    """Adds noise from a table, starting at a random place for each image."""

    def __init__(self, deviation: float, geometry: CameraGeometry, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._reach = 4096
        size = geometry.width * geometry.height * 3 + self._reach
        self._table = np.rint(self._random.normal(0.0, deviation, size)).astype(np.int16)

    def added(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the image with noise, in its own type."""
        begin = int(self._random.integers(self._reach))
        noise = self._table[begin : begin + image.size].reshape(image.shape)
        if image.dtype == np.uint8:
            clipped = np.clip(image + noise, 0, 255, dtype=np.int16, casting="unsafe")
            return np.asarray(clipped).astype(np.uint8)
        return np.asarray(image + noise.view(np.uint16))
