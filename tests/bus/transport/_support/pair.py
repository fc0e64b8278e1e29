"""A publisher and a subscriber of images with real memory between them, in one process."""

import os
from collections.abc import Callable

import numpy as np

from robbie_mp import Header, MessageHandling, Time
from robbie_mp.bus.transport.channels import ChannelNames
from robbie_mp.bus.transport.run_memory import make_block_store, make_views
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.messages import Image
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from tests._support.implementations import Native
from tests.bus.core._support.simulated_run import SimulatedRun

RUN_ID = f"test{os.getpid()}"


def encoded(type_name: str, version: int, data: bytes | bytearray) -> EncodedMessage:
    return EncodedMessage(type_name, version, memoryview(data))


class Pair:
    """A publisher and a subscriber of images."""

    def __init__(self, native: Native | None = None) -> None:
        self.run = SimulatedRun(queue_messages=5000, handles=5000)
        sender, receiver = self.run.start(1), self.run.start(2)
        self.receiver = receiver
        self.sender_words, self.receiver_words = sender.out, receiver.out
        make_folder(RUN_ID)
        blocks = make_block_store(RUN_ID, 1, 1, segment_bytes=1 << 16, limit_bytes=1 << 21, native=native)
        self.outbox = Outbox(sender.endpoint, blocks, sender.out, SystemClock(), native)
        self.views = make_views(RUN_ID, native)
        self.channel_name = ChannelNames(self.run.words)
        self.inbox = Inbox(receiver.endpoint, self.views, receiver.out, self.channel_name, native)
        self.on_image: Callable[[Image], None] = lambda _image: None
        self.inbox.subscriptions.subscribe(Image, self._handle, MessageHandling.ALWAYS_DELIVER, "")
        sender.ready()
        receiver.ready()
        self.run.run_core()

    def pass_on(self) -> None:
        """Let the core route and the subscriber handle everything."""
        self.run.run_core()
        while self.inbox.handle_next():
            self.inbox.release_unreferenced()
            self.run.run_core()

    def _handle(self, image: Image) -> None:
        self.on_image(image)

    def close(self) -> None:
        self.on_image = lambda _image: None
        self.outbox.close()
        self.inbox.close()
        self.views.close()
        vars(self).clear()  # this pair is a cycle, which would unmap what it still maps only when collected
        remove_names(RUN_ID)


def picture(value: int, size: int = 1000) -> Image:
    return Image(
        header=Header(stamp=Time(sec=value)), height=1, width=size, data=np.full(size, value, np.uint8)
    )
