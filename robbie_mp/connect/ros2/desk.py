"""The services that the bridge to ROS 2 offers: decodes requests, and encodes responses."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from robbie_mp.base.visible_text import one_line
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.service_types import ServiceType
from robbie_mp.connect.ros2.side import Call, MiddlewareInbox, Side
from robbie_mp.messages import Message, MessageError, from_dict


@dataclass
class RosRequest:
    """A request of a ROS node, to be answered once.

    Attributes:
        request: the decoded request.
        sent_at_ns: as that of a `Call`.
    """

    request: Any
    sent_at_ns: float
    _service: ServiceType
    _send: Callable[[bytes], None]

    @property
    def waited_s(self) -> float:
        """How long ago it was sent, s."""
        return (time.monotonic_ns() - self.sent_at_ns) * 1e-9

    def answer(self, **fields: object) -> None:
        """Send the response, with these fields."""
        self._send(from_dict(self._service.response, fields).encode())


Handler = Callable[[RosRequest], None]


class Desk:
    """Hands requests of ROS nodes to their handlers.

    Args:
        side: the middleware.
        inbox: where requests arrive.
        log: where wrong requests are named.

    Attributes:
        offered: types and handlers of the services, by name.
        handled: requests that were handed to a handler.
        malformed: requests that are not what their type declares; their clients get no response, as from ROS.
    """

    def __init__(self, side: Side, inbox: MiddlewareInbox, log: logging.Logger):
        self._side, self._inbox, self._log = side, inbox, log
        self.offered: dict[str, tuple[ServiceType, Handler]] = {}
        self.handled = self.malformed = 0

    def offer(self, name: str, service: ServiceType, handler: Handler) -> None:
        """Offer a service.

        Args:
            name: its name in ROS, with a slash before it.
            service: its type.
            handler: gets each request, and answers it now or later.
        """
        self.offered[name] = service, handler
        self._side.serve(name, service)

    def serve(self) -> None:
        """Handle the requests that wait."""
        for call in self._inbox.take_calls():
            service, handler = self.offered[call.service]
            request = self._decoded(service, call)
            if request is not None:
                self.handled += 1
                handler(RosRequest(request, call.sent_at_ns, service, call.answer))

    def _decoded(self, service: ServiceType, call: Call) -> Message | None:
        try:
            request = service.request.decode(call.data)
            unpadded(request, call.data)
        except MessageError as error:
            self.malformed += 1
            self._log.warning("a request to %s was dropped: %s", call.service, one_line(str(error)))
            return None
        return request
