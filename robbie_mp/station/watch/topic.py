"""Holds the newest message of a topic for pages that show it."""

import threading
from contextlib import closing
from typing import Any

from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import Received
from robbie_mp.attached.views.message_text import Abbreviated, FieldPath
from robbie_mp.base.errors import RobbieError
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.messages.descriptions import KnownTypes
from robbie_mp.run.run_directory import KnownRun

MAX_TEXT_CHARACTERS = 200
Node = dict[str, Any]


class TopicWatch:
    """Takes the messages of one channel in a separate thread, and keeps the newest.

    Args:
        run: the run.
        types: the types of its messages.
        channel: type, version and topic.

    Attributes:
        newest: the newest message, encoded; None before the first.
        error: why no message will arrive; '' if there is no error.
    """

    def __init__(self, run: KnownRun, types: KnownTypes, channel: ChannelName):
        self.channel = channel
        self.newest: Received | None = None
        self.error = ""
        self._run = run
        self._types = types
        self._type: type[Message] | None = None
        self._closed = threading.Event()
        threading.Thread(target=self._take, name=f"watch {channel.topic}", daemon=True).start()

    def close(self) -> None:
        """Tell the thread to detach from the run. It does so within a fraction of a second."""
        self._closed.set()

    def _take(self) -> None:
        try:
            wish, purpose = self.channel, f"operator station: {self.channel.type_name}"
            with closing(MessageStream(self._run, [wish], purpose)) as stream:
                while not self._closed.is_set():
                    received = stream.receive()
                    # A subscription without a topic is for all topics of the type.
                    if received is not None and received.topic == wish.topic:
                        self.newest = received
        except RobbieError as error:
            self.error = str(error)

    def tree(self, received: Received) -> list[Node]:
        """Return the fields of a message as a tree. This may be slow.

        Raises:
            RobbieError: its type is unknown, or it cannot be decoded.
        """
        if self._type is None:
            self._type = self._types.get(received.type_name, received.version)
        message = self._type.decode(received.data)
        return nodes_of(FieldPath(self._type, "").value(message, full=False), "")


def nodes_of(value: Any, path: str) -> list[Node]:
    """Return the contents of a message or array as nodes of a tree, whose ids do not change."""
    if isinstance(value, dict):
        pairs = list(value.items())
    else:
        pairs = [(f"[{index}]", item) for index, item in enumerate(value)]
        if isinstance(value, Abbreviated):
            end = len(value) - 1 + value.missing
            pairs[-1:] = [("…", f"{value.missing} more"), (f"[{end}]", value[-1])]
    return [_node(name, inner, f"{path}{name}") for name, inner in pairs]


def _node(name: str, value: Any, path: str) -> Node:
    if isinstance(value, dict):
        return {"id": path, "label": name, "children": nodes_of(value, f"{path}.")}
    if isinstance(value, list):
        length = len(value) + (value.missing if isinstance(value, Abbreviated) else 0)
        return {"id": path, "label": f"{name}: {length} elements", "children": nodes_of(value, path)}
    text = str(value)
    return {
        "id": path,
        "label": f"{name}: {text[:MAX_TEXT_CHARACTERS]}{'…' * (len(text) > MAX_TEXT_CHARACTERS)}",
    }
