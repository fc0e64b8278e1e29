"""Messages that a visitor of the page has sent: stamped now, and if one cannot be sent, the page says so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from robbie_mp.messages import Header, Time

if TYPE_CHECKING:
    from robbie_mp.messages import Message
    from robbie_mp.services.operator_station.station import OperatorStation


def header_of_now(station: OperatorStation, frame_id: str = "") -> Header:
    """Return the header of a message that is made now."""
    return Header(stamp=Time.from_nanoseconds(station.clock.now_ns()), frame_id=frame_id)


def send_or_notify(station: OperatorStation, message: Message, what: str, topic: str = "") -> bool:
    """Publish a message; on the page that asked for it, say so if that is not possible.

    Args:
        station: who publishes.
        message: the message.
        what: it is, for the visitor.
        topic: of the message.

    Returns:
        Whether it was published.
    """
    is_sent = station.publish(message, topic=topic)
    if not is_sent:
        ui.notify(f"{what} was not sent: the robot's memory is full", type="negative")
    return is_sent
