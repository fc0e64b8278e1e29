"""Messages that a visitor of the page sends: stamped now."""

from __future__ import annotations

from typing import TYPE_CHECKING

from robbie_mp.messages import Header, Time

if TYPE_CHECKING:
    from robbie_mp.station.station import OperatorStation


def header_of_now(station: OperatorStation, frame_id: str = "") -> Header:
    """Return the header of a message that is made now."""
    return Header(stamp=Time.from_nanoseconds(station.clock.now_ns()), frame_id=frame_id)
