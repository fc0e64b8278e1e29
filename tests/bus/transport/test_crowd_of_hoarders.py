"""Many who keep all they get, beside one who does not; images and memory are in a camera's proportion."""

from collections import deque
from collections.abc import Iterator

import numpy as np
import pytest

from robbie_mp import MessageHandling
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.channels import ChannelNames
from robbie_mp.bus.transport.run_memory import make_block_store, make_views
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.messages import Image
from robbie_mp.module.clock import SystemClock
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.outbox import Outbox
from robbie_mp.module.pins import PINNED_SHARE
from robbie_mp.run.supervisor.memory import unlink_data_segments
from tests.bus.core._support.simulated_run import SimulatedModule, SimulatedRun
from tests.bus.transport._support.pair import picture

pytestmark = pytest.mark.slow

RUN_ID = "7e57c20d"
LIMIT_BYTES = 4 << 20
IMAGE_BYTES = LIMIT_BYTES * 62 // 2560
IMAGES = 300


class Crowd:
    """A publisher, a healthy subscriber, and hoarders."""

    def __init__(self, hoarders: int, keep: int | None):
        self.run = SimulatedRun(
            hoarders + 3, queue_messages=1000, handles=2000, subscriptions=32, memory_bytes=LIMIT_BYTES
        )
        sender = self.run.start(1)
        blocks = make_block_store(RUN_ID, 1, 1, segment_bytes=1 << 16, limit_bytes=LIMIT_BYTES)
        self.outbox = Outbox(sender.endpoint, blocks, sender.out, SystemClock())
        self.blocks = blocks
        sender.ready()
        self.views = make_views(RUN_ID)
        self.seen = 0
        self.kept = [deque[np.ndarray](maxlen=keep) for _ in range(hoarders)]
        self.modules: list[SimulatedModule] = []
        self.inboxes = [self._inbox(2, self._see)]
        for number, kept in enumerate(self.kept):
            self.inboxes.append(self._inbox(3 + number, lambda image, kept=kept: kept.append(image.data)))
        self.run.run_core()

    def _inbox(self, slot: int, handler: object) -> Inbox:
        module = self.run.start(slot)
        self.modules.append(module)
        inbox = Inbox(module.endpoint, self.views, module.out, ChannelNames(self.run.words))
        inbox.subscriptions.subscribe(Image, handler, MessageHandling.ALWAYS_DELIVER, "")  # type: ignore[arg-type]
        module.ready()
        return inbox

    def _see(self, _image: Image) -> None:
        self.seen += 1

    def pass_on(self) -> None:
        self.run.run_core()
        for inbox in self.inboxes:
            while (delivery := inbox.take()) is not None:
                inbox.handle(delivery)
        self.run.run_core()

    def close(self) -> None:
        for kept in self.kept:
            kept.clear()
        self.outbox.close()
        self.views.close()
        vars(self).clear()
        unlink_data_segments(RUN_ID, 1, 1)


@pytest.fixture(params=[(1, 60), (4, 60), (8, 60), (20, 60), (8, None)], ids=str)
def crowd(request: pytest.FixtureRequest) -> Iterator[Crowd]:
    make_folder(RUN_ID)
    made = Crowd(*request.param)
    yield made
    made.close()
    remove_names(RUN_ID)


def test_hoarders_leave_memory_for_the_others(crowd: Crowd) -> None:
    for value in range(IMAGES):
        assert crowd.outbox.publish(picture(value % 100, IMAGE_BYTES), "")
        crowd.pass_on()
    assert crowd.seen == IMAGES
    assert crowd.run.reports == []
    hoarders = len(crowd.kept)
    free_bytes = crowd.blocks.room_bytes - crowd.blocks.taken_bytes
    least = PINNED_SHARE / (PINNED_SHARE + hoarders) * LIMIT_BYTES - hoarders * IMAGE_BYTES
    assert free_bytes >= max(least, 2 * IMAGE_BYTES)
    copied = [module.out[layout.OUT_COPIED] for module in crowd.modules[1:]]
    assert min(copied) > IMAGES / 2
    for kept in crowd.kept:
        assert [int(array[0]) for array in kept] == [value % 100 for value in range(IMAGES)][-len(kept) :]
