"""The appearance of victims and hazard signs, in visible light and in heat."""

import numpy as np
from numpy.typing import NDArray

from robbie_robots.hw.simulation.arena_contents import ArenaVictim, HazardSign, SignKind, VictimKind
from robbie_robots.hw.simulation.aruco import tag_cells
from robbie_robots.hw.simulation.texture import Texture

Colours = NDArray[np.uint8]

TAG_M = 0.25
"""Edge of a victim's tag, including its black border."""
SIGN_M = 0.30
"""Edge of the square around a sign, which stands on a corner."""

# A tag has 6 cells of 8 texels; the doll around it is 96 texels wide and 136 high.
CELL, ROWS, COLUMNS = 8, 136, 96
TAG_ROW, TAG_HALF = 88, 24
SHIRT, SKIN, PAPER, INK = (226, 112, 58), (236, 178, 140), (245, 245, 245), (15, 15, 15)
SHIRT_CELSIUS, SKIN_CELSIUS, PAPER_CELSIUS = 32.0, 35.0, 27.0

SIGN_TEXELS = 64
SIGN_COLOURS = {
    SignKind.EXPLOSIVE: (240, 130, 20),
    SignKind.FLAMMABLE_GAS: (205, 25, 35),
    SignKind.NON_FLAMMABLE_GAS: (10, 140, 70),
    SignKind.DANGEROUS_WHEN_WET: (25, 80, 190),
    SignKind.OXIDIZER: (250, 215, 10),
    SignKind.TOXIC: (245, 245, 245),
}


def victim_textures(victim: ArenaVictim) -> tuple[Texture, Texture]:
    """Return the two pictures of a victim (red, green, blue). They differ only if it waves."""
    return _coloured(victim, 0), _coloured(victim, 1)


def victim_heat(victim: ArenaVictim) -> tuple[Texture, Texture]:
    """Return the two pictures of a warm victim's temperatures, in hundredths of a kelvin."""
    return _heated(victim, 0), _heated(victim, 1)


def sign_texture(sign: HazardSign) -> Texture:
    """Return the picture of a sign (red, green, blue)."""
    row, column = np.mgrid[:SIGN_TEXELS, :SIGN_TEXELS] - (SIGN_TEXELS - 1) / 2
    from_middle = np.abs(row) + np.abs(column)
    values = np.empty((SIGN_TEXELS, SIGN_TEXELS, 3), np.uint8)
    values[:] = SIGN_COLOURS[sign.kind]
    # A black frame a little within the edge, a triangle as the symbol, and a bar as the word.
    values[(from_middle > 25) & (from_middle < 28)] = INK
    values[(row > -16) & (row < -2) & (np.abs(column) < (row + 16) * 0.6)] = INK
    values[(row > 4) & (row < 9) & (np.abs(column) < 16)] = INK
    return Texture(values, from_middle < SIGN_TEXELS / 2, SIGN_M / SIGN_TEXELS, SIGN_TEXELS / 2)


def _coloured(victim: ArenaVictim, phase: int) -> Texture:
    head, body, paper = _shapes(victim, phase)
    values = np.empty((ROWS, COLUMNS, 3), np.uint8)
    values[:] = SHIRT
    values[head] = SKIN
    values[paper] = PAPER
    cells = tag_cells(victim.tag).repeat(CELL, axis=0).repeat(CELL, axis=1)
    middle = COLUMNS // 2
    tag = values[TAG_ROW - TAG_HALF : TAG_ROW + TAG_HALF, middle - TAG_HALF : middle + TAG_HALF]
    tag[:] = np.where(cells[:, :, None], PAPER, INK)
    return Texture(values, head | body | paper, TAG_M / 6 / CELL, TAG_ROW)


def _heated(victim: ArenaVictim, phase: int) -> Texture:
    head, body, paper = _shapes(victim, phase)
    celsius = np.full((ROWS, COLUMNS), SHIRT_CELSIUS)
    celsius[head] = SKIN_CELSIUS
    celsius[paper] = PAPER_CELSIUS
    return Texture(centikelvin(celsius), head | body | paper, TAG_M / 6 / CELL, TAG_ROW)


def centikelvin(celsius: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return temperatures in the unit of radiometric cameras: hundredths of a kelvin."""
    return np.asarray((celsius + 273.15) * 100).astype(np.uint16)


def _shapes(
    victim: ArenaVictim, phase: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (ROWS, COLUMNS) of the head with hands, the body with arms, and the paper."""
    row, column = np.mgrid[:ROWS, :COLUMNS] + 0.5
    aside = column - COLUMNS / 2
    head = np.hypot(row - 22, aside) < 17
    body = np.hypot((row - TAG_ROW) / 48, aside / 46) < 1
    if victim.kind is VictimKind.MOVING:
        # One arm is up, first the right one, then the left one.
        up = aside if phase else -aside
        arm = (up > 30) & (up < 40) & (row > 6) & (row < TAG_ROW)
        head |= arm & (row < 16)
        body |= arm & (row >= 16)
    # Neither body nor paper is a square: a tag detector could take a square for a larger tag.
    across, along = np.abs(aside), np.abs(row - TAG_ROW)
    paper = (np.maximum(across, along) < 34) & (across + along < 54)
    return head, body, paper
