"""A stream counts the messages that it missed, whatever the core does meanwhile."""

from pathlib import Path

import pytest

from robbie_mp.attached.tool import message_stream
from robbie_mp.attached.tool.message_stream import MessageStream
from robbie_mp.attached.tool.tool import Detached, Received
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.run.run_directory import KnownRun

CHANNEL = ChannelName("test/msg/Number", 1, "")
MEANWHILE = 150


class BusyTool:
    """A tool that stands still for a moment while it reads counters, in which the core routes messages."""

    routed_in_run = 1000

    def __init__(self, _run: KnownRun, _purpose: str):
        self._attached_at = BusyTool.routed_in_run
        self._stands_still = self._attached_at == 1000  # only the first one
        self.takes: list[Received | None] = []

    def subscribe(self, *_name: object) -> None: ...
    def ready(self) -> None: ...
    def wait_for(self, *_condition: object) -> None: ...
    def is_subscribed(self) -> bool:
        return True

    def close(self) -> None: ...

    def counts(self) -> tuple[int, int]:
        routed = BusyTool.routed_in_run - self._attached_at
        return routed, routed  # all wait

    def passed(self) -> dict[ChannelName, int]:
        passed = {CHANNEL: BusyTool.routed_in_run}
        if self._stands_still:
            self._stands_still = False
            BusyTool.routed_in_run += MEANWHILE
        return passed

    def take(self) -> Received | None:
        raise Detached


@pytest.fixture
def stream(monkeypatch: pytest.MonkeyPatch) -> MessageStream:
    monkeypatch.setattr(message_stream, "Tool", BusyTool)
    monkeypatch.setattr(message_stream, "attach_again", BusyTool)
    return MessageStream(KnownRun("0123abcd", Path(), True, None), [CHANNEL], "")


def test_messages_routed_while_the_counters_are_read_are_not_missed(stream: MessageStream) -> None:
    BusyTool.routed_in_run += 7
    assert stream.receive() is None  # the tool was detached, and is attached again
    assert (
        stream.missed == MEANWHILE + 7
    )  # what came before the second attachment, and nothing that came after
