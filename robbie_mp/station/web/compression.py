"""Compresses the states that a page gets: an element is sent with all its properties when one changes.

Live parts and pictures are not compressed again: they go to many pages, and most are compressed already.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

import wsproto
from wsproto.connection import ConnectionType
from wsproto.events import AcceptConnection
from wsproto.extensions import PerMessageDeflate
from wsproto.frame_protocol import CloseReason

if TYPE_CHECKING:
    from wsproto.events import Event
    from wsproto.frame_protocol import FrameDecoder, FrameProtocol

MAX_MESSAGE_BYTES = 1 << 17
"""Maximum size of a message from a page. A page that sends a larger one is disconnected."""
WINDOW_BITS = 13
"""What was sent within the last 8 kB is sent as a reference. With more, each page would need more memory."""


class BoundedDeflate(PerMessageDeflate):
    """The extension `permessage-deflate` (RFC 7692), by which few bytes of a page cannot become very many."""

    def __init__(self) -> None:
        super().__init__(server_max_window_bits=WINDOW_BITS)

    def frame_inbound_payload_data(
        self, proto: FrameDecoder | FrameProtocol, data: bytes
    ) -> bytes | CloseReason:
        """Return what a part of a page's message contains."""
        if not self._inbound_compressed or not self._inbound_is_compressible:
            return data
        assert self._decompressor is not None
        try:
            found = self._decompressor.decompress(bytes(data), MAX_MESSAGE_BYTES)
        except zlib.error:
            return CloseReason.INVALID_FRAME_PAYLOAD_DATA
        return CloseReason.MESSAGE_TOO_BIG if self._decompressor.unconsumed_tail else found


class PageConnection(wsproto.WSConnection):
    """A page's end of a connection.

    Attributes:
        is_compressed: whether to compress what is sent, if the browser can.
    """

    def __init__(self) -> None:
        super().__init__(ConnectionType.SERVER)
        self.is_compressed = False

    def send(self, event: Event) -> bytes:
        """Return the bytes that tell the browser of an event."""
        if self.is_compressed and isinstance(event, AcceptConnection):
            event.extensions.append(BoundedDeflate())
        return super().send(event)
