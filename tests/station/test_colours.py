"""Colours that say something are told apart by eyes that lack a kind of cone, or by a shape, icon or word."""

import re
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from robbie_mp.station.live.map import PALETTE
from robbie_mp.station.page.alarms import AlarmLevel
from robbie_mp.station.page.control_bar import MODES
from robbie_mp.station.panels.map import COSTS
from robbie_robots.modules.rescue.messages import VictimFound
from robbie_robots.modules.rescue.station.victim_watch import COLOURS as VICTIM_COLOURS
from robbie_robots.modules.rescue.station.wall_layers import LAYERS as WALL_LAYERS
from tests.station._support.colour_vision import EYES, apart, ciede2000

STATION = Path(__file__).parents[2] / "robbie_mp" / "station"
LEAST = 10.0
"""Smallest distance (CIEDE2000) of two colours that are told apart by themselves, also in small marks."""
HEX = r"(#[0-9a-f]{6})\b"


class Sign(NamedTuple):
    """What stands for a meaning."""

    meaning: str
    colour: str
    form: str
    """Its shape, icon or word; '' if it is only a colour."""


def found_in(file: str, pattern: str) -> list[tuple[str, ...]]:
    """Return what a pattern finds in a source of the page."""
    found = re.findall(pattern, (STATION / file).read_text())
    assert found, f"{file} says it in another way"
    return [one if isinstance(one, tuple) else (one,) for one in found]


def of_map() -> Iterator[Sign]:
    """Yield the marks on the map; those of lines are as wide as each other."""
    for shape, colour, name in found_in("panels/map_view.js", rf'\["(\w+)", "{HEX}", "([\w-]+)"\]'):
        yield Sign(name, colour, shape)
    ((colour,),) = found_in("panels/map_view.js", rf'draw_arrow\(pen, \[x, y, yaw\], "{HEX}"')
    yield Sign("another robot", colour, "arrow")


def of_cells() -> Iterator[Sign]:
    """Yield what fills cells of the map; all of them are squares, and so are the laser's points."""
    free, wall = (PALETTE[3 * at : 3 * at + 3] for at in (1, 101))
    yield Sign("free", as_hex(free), "")
    yield Sign("wall", as_hex(wall), "")
    ((unknown,),) = found_in("panels/map_view.js", rf'fillStyle = "{HEX}";\n\s*pen.fillRect\(0, 0')
    yield Sign("unknown", unknown, "")
    for title, colour, _ in WALL_LAYERS:
        yield Sign(title, colour, "")
    for title, colour, *_ in COSTS:
        if re.fullmatch(HEX, colour):  # the others are translucent, and shown on request
            yield Sign(title, colour, "")
    yield next(sign._replace(form="") for sign in of_map() if sign.meaning == "laser")


def of_modes() -> Iterator[Sign]:
    """Yield who controls the robot: each has an icon and its name in the bar."""
    icons = pairs_in("page/control_bar.js", r'\b(AUTO|MANUAL|HOLD): "(\w+)"')
    colours = pairs_in("page/control_bar.css", rf"\.control-mode\.is-(\w+) {{background: {HEX}")
    for mode in MODES.values():
        yield Sign(mode, colours[mode.lower()], icons[mode])


def of_stop() -> Iterator[Sign]:
    """Yield the states of the base beside the emergency stop: each is a word."""
    words = found_in("stop/emergency_stop.js", r'state: "([\w ]+)(?: …)?", look(?:: "(?:is-(\w+))?")?')
    colours = pairs_in("stop/emergency_stop.css", rf"\.is-(\w+) {{background: {HEX}")
    ((silent,),) = found_in("stop/emergency_stop.css", rf"line-height: 1.2; background: {HEX}")
    source = (STATION / "stop/emergency_stop.js").read_text()
    for word, look in words:
        is_pending = f'state: "{word}", look,' in source or f'state: "{word} …", look,' in source
        yield Sign(word, colours["pending" if is_pending else look] if is_pending or look else silent, word)


def of_alarms() -> Iterator[Sign]:
    """Yield the levels of alarms: each has an icon."""
    ((icons,),) = found_in("page/alarms.js", r"ICONS = \[(.*)\]")
    found = re.findall(r'"(\w+)"', icons)
    for level, colour in found_in("page/alarms.css", rf"\.alarm-line\.is-level-(\d) {{background: {HEX}"):
        yield Sign(AlarmLevel(int(level)).name, colour, found[int(level)])


def of_victims() -> Iterator[Sign]:
    """Yield the states of victims on the map, which are the same figure."""
    for state, colour in VICTIM_COLOURS.items():
        yield Sign(f"victim {state}", colour, "person")
    assert len(VICTIM_COLOURS) == VictimFound.REJECTED - VictimFound.SUSPECTED + 1


def of_ring() -> Iterator[Sign]:
    """Yield how near something is, in the ring round the speed."""
    for look, colour in found_in("panels/camera.css", rf"\.hud-ring path\.is-(\w+) {{fill: {HEX}"):
        yield Sign(look, colour, "")


GROUPS = (of_map, of_cells, of_modes, of_stop, of_alarms, of_victims, of_ring)


def pairs_in(file: str, pattern: str) -> dict[str, str]:
    """Return what a pattern with two groups finds: the second by the first."""
    return {one: other for one, other in found_in(file, pattern)}


def as_hex(levels: list[int]) -> str:
    return "#" + "".join(f"{level:02x}" for level in levels)


@pytest.mark.parametrize("group", GROUPS)
def test_signs_of_different_meanings_are_told_apart(group) -> None:  # type: ignore[no-untyped-def]
    signs = sorted(set(group()))
    assert len(signs) >= 2
    for one, other in combinations(signs, 2):
        if one.form and one.form != other.form:
            continue
        for eyes in EYES:
            distance = apart(one.colour, other.colour, eyes)
            assert distance >= LEAST, f"with {eyes}, {one} and {other} are only {distance:.1f} apart"


@pytest.mark.parametrize("group", [of_modes, of_alarms, of_stop])
def test_states_have_a_word_or_icon_of_their_own(group) -> None:  # type: ignore[no-untyped-def]
    signs = list(group())
    assert len({sign.form for sign in signs}) == len({sign.meaning for sign in signs}) >= 3


def test_robot_goal_and_person_have_shapes_of_their_own() -> None:
    shapes = {sign.meaning: sign.form for sign in of_map()}
    assert len({shapes[name] for name in ("robot", "goal", "person", "place")}) == 4


def test_red_and_green_of_equal_brightness_are_alike_without_a_kind_of_cone() -> None:
    red, green = "#c62828", "#557b2e"
    assert apart(red, green) > 40
    assert apart(red, green, "deuteranopia") < 15
    assert apart("#0072b2", "#e69f00", "deuteranopia") > 40  # blue and orange, made to be told apart
    for eyes in EYES:
        assert apart("#777777", "#777777", eyes) == 0
        assert apart("#000000", "#ffffff", eyes) == pytest.approx(100, abs=0.1)


@pytest.mark.parametrize(
    ("one", "other", "distance"),
    [  # from the table of test data in the paper on CIEDE2000
        ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
        ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
        ((50, 2.5, 0), (50, 0, -2.5), 4.3065),
        ((50, 2.5, 0), (73, 25, -18), 27.1492),
        ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
        ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
        ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
    ],
)
def test_distances_are_those_of_the_paper(
    one: tuple[float, ...], other: tuple[float, ...], distance: float
) -> None:
    assert ciede2000(np.array(one), np.array(other)) == pytest.approx(distance, abs=1e-4)
