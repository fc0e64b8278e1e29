"""Which robot a page is of: its name and colour, in the tab's title, on the login page and in the bar."""

from __future__ import annotations

import re
import zlib
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from robbie_mp.station.module import StationModule

COLOUR = re.compile(r"(#[0-9a-fA-F]{6})?")
COLOURS = ("#42a5f5", "#66bb6a", "#ffa726", "#ec407a", "#ab47bc", "#26c6da", "#d4e157", "#8d6e63")
"""Of robots whose profile sets none: by their name, so that it stays."""
MAX_NAME = 40


class Identity(NamedTuple):
    """How pages show which robot they are of."""

    name: str
    colour: str


ANY_ROBOT = Identity("Robbie", COLOURS[0])


def identity_of(station: StationModule) -> Identity:
    """Return the name and colour that the profile gives, or those that follow from its name."""
    record = station.known_run.record
    profile = record.profile.rpartition("/")[2].rpartition(":")[2] if record else ""
    name = (station.robot_name or profile or ANY_ROBOT.name)[:MAX_NAME]
    return Identity(name, station.robot_colour or COLOURS[zlib.crc32(name.encode()) % len(COLOURS)])
