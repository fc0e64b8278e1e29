"""Typed messages from outbox to inbox through a real data segment and a core, in one process."""

import contextlib
import gc
import logging
import os
import sys
import threading
import time
import weakref
from array import array
from collections import deque
from collections.abc import Callable
from pathlib import Path
from pickle import PickleBuffer
from typing import Any, cast

import numpy as np
import pytest

from robbie_mp import Header, Message, MessageHandling, Time, int32
from robbie_mp.base.linux.forks import ForkedProcess
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.messages import FieldError, Image, Imu
from robbie_mp.module import outbox as outbox_module
from robbie_mp.module.bus import PublishAfterStop
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.inbox import Inbox
from robbie_mp.module.pins import MAX_PINNED, PINNED_SHARE
from robbie_mp.module.subscriptions import SubscribedTwice
from robbie_mp.run.supervisor.memory import unlink_data_segments
from tests._support.growth import blocks_kept
from tests.bus.transport._support.pair import RUN_ID, Pair, encoded, picture


def test_message_comes_as_it_went(pair: Pair) -> None:
    seen: list[Image] = []
    pair.on_image = seen.append
    sent = picture(7)
    assert pair.outbox.publish(sent, "camera")
    pair.pass_on()
    assert seen == [sent]


def test_second_handler_for_the_same_messages_is_refused(pair: Pair) -> None:
    with pytest.raises(SubscribedTwice, match="one handler call the other"):
        pair.inbox.subscriptions.subscribe(Image, pair.on_image, MessageHandling.KEEP_ONLY_NEWEST, "")
    pair.inbox.subscriptions.subscribe(Image, pair.on_image, MessageHandling.ALWAYS_DELIVER, "camera")


def test_received_array_cannot_be_written(pair: Pair) -> None:
    def write(image: Image) -> None:
        image.data[0] = 1

    pair.on_image = write
    pair.outbox.publish(picture(7), "")
    with pytest.raises(ValueError, match="read-only"):
        pair.pass_on()


class Number(Message, name="test_msgs/msg/PlainNumber", version=1):
    data: int32


class Secret(Message, name="test_msgs/msg/Secret", version=1):
    """Has functions of its own in the place of the generated ones."""

    number: int32

    def encode_into(self, buffer: memoryview, offset: int = 0) -> int:
        return Number(data=self.number ^ 0x55).encode_into(buffer, offset)

    @classmethod
    def decode(cls, buffer: Any) -> "Secret":
        return cls(number=Number.decode(buffer).data ^ 0x55)


def test_message_that_encodes_and_decodes_itself_is_left_to_do_so(pair: Pair) -> None:
    seen: list[Secret] = []
    written: list[Message] = []
    pair.inbox.subscriptions.subscribe(Secret, seen.append, MessageHandling.ALWAYS_DELIVER, "own")
    pair.run.run_core()
    for _ in range(3):
        pair.outbox.publish(Secret(number=7), "own")
        pair.run.run_core()
        source, offset = pair.run.modules[1, 1].last_record()[2:4]
        written.append(Number.decode(pair.views.view(source, offset, 8)))
        pair.pass_on()
    assert seen == [Secret(number=7)] * 3
    assert written == [Number(data=7 ^ 0x55)] * 3


def test_block_is_pinned_until_the_last_array_dies(pair: Pair) -> None:
    kept: list[np.ndarray] = []
    pair.on_image = lambda image: kept.append(image.data[10:20][::2])
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    assert pair.receiver_words[layout.OUT_PINNED] == 1
    for value in range(50):  # whatever else is published, the kept array stays as it is
        pair.on_image = lambda _image: None
        pair.outbox.publish(picture(100 + value), "")
        pair.pass_on()
    assert kept[0].tolist() == [7] * 5
    assert pair.outbox.outstanding == 1
    kept.clear()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.receiver_words[layout.OUT_PINNED] == 0
    assert pair.outbox.outstanding == 0


def test_core_learns_from_the_first_count_that_a_module_paces_itself(pair: Pair) -> None:
    def paces() -> int:
        return pair.sender_words[layout.OUT_PACES]

    pair.outbox.publish(picture(7), "")
    assert not paces()
    assert pair.outbox.outstanding == 1
    assert paces() == 1
    pair.pass_on()
    assert pair.outbox.outstanding == 0
    assert not pair.sender_words[layout.OUT_AWAITED_FREED] and not pair.outbox.awaits_room


def test_counting_leaves_an_earlier_wish_alone(pair: Pair) -> None:
    pair.outbox.publish(picture(7), "")
    pair.outbox.wake_after_freed(4)
    assert pair.outbox.outstanding == 1
    assert pair.sender_words[layout.OUT_AWAITED_FREED] == 4


def test_message_let_go_in_another_thread_is_released(pair: Pair) -> None:
    kept: list[Image] = []
    pair.on_image = kept.append
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    thread = threading.Thread(target=kept.clear)
    thread.start()
    thread.join()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_message_let_go_by_a_thread_in_the_moment_its_handler_ends_is_released(pair: Pair) -> None:
    handler_ended, is_dying, handled = threading.Event(), threading.Event(), threading.Event()

    class Words(array):  # type: ignore[type-arg]  # array takes no argument at run time before Python 3.12
        def __setitem__(self, at: int, value: int) -> None:  # type: ignore[override]
            if at == layout.OUT_HANDLED:
                handler_ended.set()
                is_dying.wait(10)

    def hold_up_death(_: object) -> None:
        is_dying.set()
        handled.wait(10)

    def let_go() -> None:
        handler_ended.wait(10)
        kept.clear()

    class Watching:
        has_views = True

        def decode(self, buffer: memoryview) -> Image:
            # Called before the finalizer of the inbox, which was registered earlier.
            watching.append(weakref.ref(cast(Any, buffer.obj), hold_up_death))
            return Image.decode(buffer)

    kept: list[object] = []
    watching: list[object] = []
    words = Words("Q", bytes(8 * layout.OUT_RING))
    inbox = Inbox(pair.run.modules[2, 1].endpoint, pair.views, words, pair.channel_name)
    inbox.subscriptions.subscribe(Image, kept.append, MessageHandling.ALWAYS_DELIVER, "")
    for number, subscription in inbox.subscriptions.by_number.items():
        inbox.subscriptions.by_number[number] = subscription._replace(decoder=Watching())
    pair.run.run_core()
    pair.outbox.publish(picture(7), "")
    pair.run.run_core()
    thread = threading.Thread(target=let_go)
    thread.start()
    delivery = inbox.take()
    assert delivery is not None
    inbox.handle(delivery)
    handled.set()
    thread.join()
    inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_threads_publish_at_the_same_time_and_nothing_is_lost_or_doubled(pair: Pair) -> None:
    seen: list[tuple[int, int]] = []
    pair.on_image = lambda image: seen.append((image.width, image.header.stamp.sec))
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)

    def publish(thread: int) -> None:
        for number in range(30):
            image = Image(
                header=Header(stamp=Time(sec=number)), width=thread, data=np.zeros(number, np.uint8)
            )
            while not pair.outbox.publish(image, ""):
                pass

    threads = [threading.Thread(target=publish, args=(thread,)) for thread in range(4)]
    for each in threads:
        each.start()
    while any(each.is_alive() for each in threads):
        pair.pass_on()
    sys.setswitchinterval(before)
    pair.pass_on()
    assert sorted(seen) == [(thread, number) for thread in range(4) for number in range(30)]
    for thread in range(4):
        assert [number for of, number in seen if of == thread] == list(range(30))
    assert pair.sender_words[layout.OUT_PUBLISHED] == 120
    assert pair.outbox.outstanding == 0


def test_message_in_a_reference_cycle_is_released_by_the_garbage_collector(pair: Pair) -> None:
    def make_cycle(image: Image) -> None:
        cycle: list[object] = [image.data]
        cycle.append(cycle)

    pair.on_image = make_cycle
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    gc.collect()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_loan_is_filled_in_place_and_published_at_its_end(pair: Pair) -> None:
    seen: list[bytes] = []
    pair.on_image = lambda image: seen.append(image.data.tobytes())
    fields = {"height": 2, "width": 3, "encoding": "mono8", "step": 3, "data": 6}
    with pair.outbox.loan(Image, "", fields) as image:
        image.data[:] = range(6)
        pair.pass_on()
        assert seen == []
    pair.pass_on()
    assert seen == [bytes(range(6))]


def test_array_that_still_has_a_name_cannot_change_the_message_and_costs_no_copy(pair: Pair) -> None:
    seen: list[list[list[int]]] = []
    pair.on_image = lambda image: seen.append(image.data.reshape(2, 3).tolist())
    with pair.outbox.loan(Image, "", {"data": 6}) as image:
        pixels = image.data.reshape(2, 3)
        for row in pixels:
            row[:] = 1
        corner = pixels[:1, :1].view(np.uint8)
    for named in (pixels, row, corner):
        with pytest.raises(ValueError, match="read-only"):
            named[...] = 2
    pair.pass_on()
    assert seen == [[[1, 1, 1], [1, 1, 1]]]
    assert pair.outbox.copied_loans.count == 0


def test_block_of_a_loan_is_used_again_when_its_arrays_are_gone_and_it_was_read(pair: Pair) -> None:
    def publish(data: int, then: Callable[[], None]) -> None:
        with pair.outbox.loan(Image, "", {"data": 4}) as image:
            pixels = image.data
            pixels[:] = data
        then()
        assert pixels.tolist() == [data] * 4

    def read_and_publish_others() -> None:
        pair.pass_on()
        for _ in range(3):
            publish(9, pair.pass_on)
        assert pair.outbox.outstanding == 1

    publish(1, read_and_publish_others)
    assert pair.outbox.outstanding == 0
    publish(2, lambda: None)
    assert pair.outbox.outstanding == 1
    pair.pass_on()
    assert pair.outbox.outstanding == 0


def test_refused_loan_with_a_named_array_leaks_nothing(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pair.outbox._endpoint, "publish", lambda *_: False)

    def publish() -> None:
        with pair.outbox.loan(Image, "", {"data": 4}) as image:
            kept = image.data
        assert pair.sender_words[layout.OUT_REFUSED] == 1
        assert pair.outbox.outstanding == 1
        del kept

    publish()
    assert pair.outbox.outstanding == 0


@pytest.mark.parametrize(
    "keep",
    [
        lambda array: array,
        lambda array: array.reshape(2, 2),
        lambda array: array[1:].view(np.int8),
        memoryview,
        lambda array: np.asarray(memoryview(array)[:2]),
        iter,
    ],
)
@pytest.mark.parametrize("has_name", [False, True])
def test_array_kept_beyond_its_loan_cannot_change_the_message(
    pair: Pair, keep: Callable[[Any], Any], has_name: bool, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[list[int]] = []
    pair.on_image = lambda image: seen.append(image.data.tolist())
    with pair.outbox.loan(Image, "", {"data": 4}) as image:
        image.data[:] = 1
        kept = [keep(image.data)]
        name = image.data.reshape(2, 2) if has_name else None
        del image
    if isinstance(kept[0], np.ndarray) and kept[0].flags.writeable:
        kept[0][...] = 2
    pair.pass_on()
    assert seen == [[1] * 4]
    assert "is kept beyond its with block, so the message was copied (1 in all)" in caplog.text
    assert pair.outbox.outstanding == 1  # its block is not used again as long as it is held
    kept.clear()
    del name
    _ = sys._getframe().f_locals  # a frame may keep its locals
    assert pair.outbox.outstanding == 0


def test_copies_of_kept_arrays_are_warned_of_less_and_less_often(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    kept = []
    for _ in range(66):
        with pair.outbox.loan(Image, "", {"data": 4}) as image:
            kept.append(image.data)
    assert pair.outbox.copied_loans.count == 66
    assert caplog.text.count("was copied") == 7  # the 1st, 2nd, 4th, …, 64th


def test_exception_takes_a_loan_back(pair: Pair) -> None:
    with pytest.raises(OSError, match="cable"), pair.outbox.loan(Image, "", {"data": 4}):
        raise OSError("the camera's cable is out")
    pair.pass_on()
    assert pair.sender_words[layout.OUT_PUBLISHED] == 0
    gc.collect()
    assert pair.outbox.outstanding == 0


def test_loan_with_full_memory_is_counted_and_does_not_fail(pair: Pair) -> None:
    while pair.outbox.publish(picture(1, 100_000), ""):
        pass
    refused = pair.sender_words[layout.OUT_REFUSED]
    with pair.outbox.loan(Image, "", {"data": 100_000}) as image:
        image.data[:] = 3
    assert pair.sender_words[layout.OUT_REFUSED] == refused + 1


def test_full_memory_refuses_until_something_is_released(pair: Pair) -> None:
    accepted = 0
    while pair.outbox.publish(picture(1, 100_000), ""):
        accepted += 1
    assert 5 < accepted < 25
    assert pair.sender_words[layout.OUT_PUBLISHED] == accepted
    pair.pass_on()
    assert pair.outbox.publish(picture(1, 100_000), "")


def test_publisher_without_memory_has_the_core_look_for_releases(pair: Pair) -> None:
    while pair.outbox.publish(picture(1, 100_000), ""):
        pair.run.run_core()
    while (delivery := pair.inbox.take()) is not None:
        pair.inbox.handle(delivery)
    sender = pair.run.modules[1, 1]
    before = sender.core_wakeups
    assert not pair.outbox.publish(picture(1, 100_000), "")
    assert sender.core_wakeups > before
    pair.run.run_core()
    assert pair.outbox.publish(picture(1, 100_000), "")


def test_asking_again_for_outstanding_messages_has_the_core_look_for_releases(pair: Pair) -> None:
    assert pair.outbox.outstanding == 0, "the core knows from now on that it is asked"
    pair.outbox.publish(picture(1), "")
    pair.run.run_core()
    delivery = pair.inbox.take()
    assert delivery is not None
    pair.inbox.handle(delivery)
    sender = pair.run.modules[1, 1]
    before = sender.core_wakeups
    assert pair.outbox.outstanding == 1
    assert sender.core_wakeups == before, "the publisher has woken it already"
    assert pair.outbox.outstanding == 1
    assert sender.core_wakeups > before
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_room_was_made_when_so_many_messages_were_let_go_and_is_said_once(pair: Pair) -> None:
    for _ in range(3):
        pair.outbox.publish(picture(1), "")
    pair.outbox.wake_after_freed(2)
    pair.run.run_core()
    assert not pair.outbox.room_was_made()
    pair.pass_on()
    assert pair.outbox.room_was_made()
    assert not pair.outbox.room_was_made()


def test_large_message_gets_a_segment_of_its_own(pair: Pair) -> None:
    seen: list[int] = []
    pair.on_image = lambda image: seen.append(int(image.data.sum()))
    pair.outbox.publish(picture(1, 10), "")
    pair.outbox.publish(picture(1, 500_000), "")
    pair.pass_on()
    assert seen == [10, 500_000]
    assert pair.sender_words[layout.OUT_SEGMENTS] == 2


def test_message_that_can_never_fit_is_an_error(pair: Pair) -> None:
    with pytest.raises(MessageTooLarge, match=r"raise memory\.limit_bytes"):
        pair.outbox.publish(picture(1, 4_000_000), "")


def test_publishing_after_the_stop_is_an_error_that_says_what_to_do(pair: Pair) -> None:
    pair.outbox.close()
    with pytest.raises(PublishAfterStop, match=r"teardown\(\)"):
        pair.outbox.publish(picture(1), "")


def test_message_changed_into_something_wrong_gives_its_block_back(pair: Pair) -> None:
    message = Image()
    object.__setattr__(message, "data", "no array")
    with pytest.raises(FieldError):
        pair.outbox.publish(message, "")
    assert pair.outbox.outstanding == 0


def test_garbage_in_the_publishers_memory_is_counted_and_nobody_dies(
    pair: Pair, caplog: pytest.LogCaptureFixture
) -> None:
    seen: list[Image] = []
    pair.on_image = seen.append
    pair.outbox.publish(picture(1), "")
    pair.run.run_core()
    delivery = pair.inbox.take()
    assert delivery is not None
    pair.inbox.handle(delivery._replace(size=1 << 40))
    assert seen == []
    assert "refused an ill-formed message" in caplog.text
    assert pair.receiver_words[layout.OUT_ILL_FORMED] == 1
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_damaged_message_is_not_pinned(pair: Pair, caplog: pytest.LogCaptureFixture) -> None:
    for number in range(3):
        assert pair.outbox.publish(encoded("sensor_msgs/msg/Image", 1, b"\0\1\0\0damaged"), "")
        pair.run.run_core()
        assert pair.inbox.handle_next()
        assert pair.receiver_words[layout.OUT_PINNED] == 0
        assert pair.receiver_words[layout.OUT_HANDLED] == number + 1
        pair.run.run_core()
        assert pair.outbox.outstanding == 0
    assert pair.receiver_words[layout.OUT_ILL_FORMED] == 3
    assert caplog.text.count("refused an ill-formed message") == 2  # the 1st and the 2nd, then the 4th


def test_maps_of_a_dead_publisher_go_when_its_last_message_is_released(pair: Pair) -> None:
    pair.outbox.publish(picture(1), "")
    pair.pass_on()
    pair.run.kill(pair.run.modules[1, 1])
    assert pair.inbox.take() is None
    unlink_data_segments(RUN_ID, 1, 1)
    with pytest.raises(SegmentMissing):
        pair.views.view(layout.pack_source(1, 0, 1), 0, 1)


def free_bytes(pair: Pair) -> int:
    return pair.outbox._blocks.room_bytes - pair.outbox._blocks.taken_bytes


def test_what_a_hoarder_keeps_beyond_its_share_is_a_copy(pair: Pair) -> None:
    size, kept = 50_000, deque[np.ndarray](maxlen=60)
    pair.on_image = lambda image: kept.append(image.data)
    for value in range(200):
        assert pair.outbox.publish(picture(value % 100, size), "")
        pair.pass_on()
        pinned = pair.receiver_words[layout.OUT_PINNED_BYTES]
        assert PINNED_SHARE * (pinned - size) <= free_bytes(pair)
    assert [int(array[0]) for array in kept] == [value % 100 for value in range(140, 200)]
    assert not any(array.flags.writeable for array in kept)
    assert all(array.flags.aligned for array in kept)
    assert pair.receiver_words[layout.OUT_COPIED] > 100
    assert 0 < pair.receiver_words[layout.OUT_PINNED] == pair.outbox.outstanding < 10
    kept.clear()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_small_messages_are_pinned_up_to_a_number(pair: Pair) -> None:
    kept: list[np.ndarray] = []
    pair.on_image = lambda image: kept.append(image.data)
    for value in range(MAX_PINNED + 10):
        pair.outbox.publish(picture(value % 100, 10), "")
        pair.pass_on()
    assert pair.receiver_words[layout.OUT_PINNED] == MAX_PINNED
    assert pair.receiver_words[layout.OUT_COPIED] == 10


def test_who_lets_messages_go_gets_no_copies(pair: Pair) -> None:
    kept = deque[np.ndarray](maxlen=1)
    pair.on_image = lambda image: kept.append(image.data)
    for value in range(100):
        pair.outbox.publish(picture(value, 50_000), "")
        pair.pass_on()
    assert pair.receiver_words[layout.OUT_COPIED] == 0


def test_publisher_of_a_stopped_subscriber_never_runs_out_of_memory(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before there is no room for a message, the core drops old ones that only wait."""
    monkeypatch.setattr(outbox_module, "_MIN_AGE_TO_DROP_NS", 0)
    monkeypatch.setattr(outbox_module, "_MIN_REQUEST_INTERVAL_NS", 0)
    for value in range(200):
        assert pair.outbox.publish(picture(value % 100, 50_000), "")
        pair.run.run_core()
    counts = pair.run.counts(0)
    assert counts["routed"] == 200
    assert counts["dropped"] + pair.run.waiting(2) == 200
    seen: list[int] = []
    pair.on_image = lambda image: seen.append(int(image.data[0]))
    pair.pass_on()
    assert seen[-1] == 99
    assert pair.run.counts(0)["delivered"] == len(seen) > 20


def test_publisher_with_memory_in_pieces_gets_room_for_a_large_message(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox_module, "_MIN_AGE_TO_DROP_NS", 0)
    monkeypatch.setattr(outbox_module, "_MIN_REQUEST_INTERVAL_NS", 0)
    for value in range(16):
        assert pair.outbox.publish(picture(value, 60_000), "")
        pair.run.run_core()
    tries = 0
    while not pair.outbox.publish(picture(99, 1_000_000), ""):
        tries += 1
        assert tries < 16
        pair.run.run_core()
    assert pair.sender_words[layout.OUT_REFUSED] == tries


def test_core_that_is_away_is_not_asked_for_room_more_often_than_its_ring_holds(
    pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox_module, "_MIN_REQUEST_INTERVAL_NS", 0)
    for value in range(500):
        pair.outbox.publish(picture(value % 100, 400_000), "")
    assert not pair.outbox._endpoint._backlog
    pair.pass_on()
    assert pair.run.reports == []


@pytest.mark.parametrize(
    "derive",
    [
        lambda data: data,
        lambda data: data[10:20][::2],
        lambda data: data.reshape(10, 100).T,
        lambda data: data.view(np.int8),
        lambda data: data.data,
        lambda data: memoryview(data)[5:10].cast("B"),
        lambda data: np.frombuffer(data[3:], np.uint8),
        lambda data: np.asarray(memoryview(data.data)),
        iter,
        lambda data: PickleBuffer(data[1:]),
        lambda data: data.base,
        lambda data: np.lib.stride_tricks.as_strided(data, (4, 2), (2, 1)),
        lambda data: weakref.ref(data)(),
    ],
)
def test_message_is_pinned_as_long_as_any_view_of_it_lives(
    pair: Pair, derive: Callable[[Any], object]
) -> None:
    kept: list[object] = []
    pair.on_image = lambda image: kept.append(derive(image.data))
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    assert pair.outbox.outstanding == 1
    assert pair.receiver_words[layout.OUT_PINNED] == 1
    thread = threading.Thread(target=kept.clear)
    thread.start()
    thread.join()
    pair.pass_on()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0
    assert pair.receiver_words[layout.OUT_PINNED] == pair.receiver_words[layout.OUT_PINNED_BYTES] == 0


def test_bytes_of_a_message_are_pinned_as_long_as_they_are_kept(pair: Pair) -> None:
    kept: list[EncodedMessage] = []
    pair.inbox.subscriptions.subscribe_encoded("sensor_msgs/msg/*", kept.append, "other")
    pair.run.run_core()
    for _ in range(2):
        assert pair.outbox.publish(picture(7), "other")
        pair.pass_on()
    assert [message.type_name for message in kept] == ["sensor_msgs/msg/Image"] * 2
    assert kept[0].data == kept[1].data == picture(7).encode()
    assert kept[0].data.readonly
    assert pair.outbox.outstanding == 2
    kept.clear()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_kept_array_stays_though_its_publisher_dies_and_the_maps_are_closed(pair: Pair) -> None:
    kept: list[np.ndarray] = []
    pair.on_image = lambda image: kept.append(image.data)
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    pair.views.close()
    assert mapped_data_segments(1)
    assert kept[0].tolist() == [7] * 1000
    kept.clear()
    assert mapped_data_segments(0)


def mapped_data_segments(count: int) -> bool:
    """Whether the subscriber maps this number of data segments; the publisher's own maps do not count."""
    gc.collect()
    lines = Path("/proc/self/maps").read_text().splitlines()
    return sum(f"robbie-{RUN_ID}/data" in line and " r--s " in line for line in lines) == count


def test_what_a_handler_raises_leaves_nothing_pinned_or_mapped(pair: Pair) -> None:
    def fail(image: Image) -> None:
        raise KeyError(image.data[0])

    pair.on_image = fail
    for _ in range(2):
        pair.outbox.publish(picture(7), "")
        pair.run.run_core()
        with pytest.raises(KeyError):
            pair.inbox.handle_next()
        assert pair.inbox.current is not None, "what was being handled can be told"
    assert pair.receiver_words[layout.OUT_HANDLED] == pair.receiver_words[layout.OUT_PINNED] == 0
    pair.views.close()
    assert mapped_data_segments(0)


def test_message_has_a_name_only_while_it_is_handled(pair: Pair) -> None:
    names: list[str] = []
    pair.on_image = lambda _image: names.append(pair.inbox.name_current().topic)
    for topic in ("left", "right", "left"):
        pair.outbox.publish(picture(7), topic)
        pair.pass_on()
    assert names == ["left", "right", "left"]
    assert pair.inbox.current is None
    with pytest.raises(LookupError):
        pair.inbox.name_current()


def test_handler_can_subscribe_publish_and_look_at_its_message(pair: Pair) -> None:
    seen: list[int] = []

    def answer(image: Image) -> None:
        current = pair.inbox.current
        assert current is not None
        seen.append(current.sequence)
        if len(seen) == 1:
            pair.inbox.subscriptions.subscribe(
                Imu, lambda imu: seen.append(-1), MessageHandling.ALWAYS_DELIVER, ""
            )
            pair.run.run_core()
            assert pair.outbox.publish(Imu(), "")

    pair.on_image = answer
    pair.outbox.publish(picture(7), "")
    pair.pass_on()
    pair.outbox.publish(picture(8), "")
    pair.pass_on()
    assert seen == [1, -1, 3]


@pytest.mark.parametrize("keeps", [False, True])
def test_message_is_given_back_while_another_thread_sends(pair: Pair, keeps: bool) -> None:
    lock, kept = pair.receiver.endpoint.lock, deque[Image](maxlen=1)
    has_lock = threading.Event()

    def send_slowly() -> None:
        with lock:
            has_lock.set()
            time.sleep(0.05)  # a lock that is held cannot tell when somebody waits for it

    sender = threading.Thread(target=send_slowly)

    def begin(image: Image) -> None:
        if keeps:
            kept.append(image)
        sender.start()
        assert has_lock.wait(5.0)

    pair.outbox.publish(picture(7), "")
    pair.pass_on()  # the first one is always handled in Python
    pair.on_image = begin
    pair.outbox.publish(picture(8), "")
    pair.run.run_core()
    assert pair.inbox.handle_next()
    sender.join()
    kept.clear()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_inbox_that_was_closed_handles_nothing(pair: Pair) -> None:
    pair.outbox.publish(picture(7), "")
    pair.run.run_core()
    pair.inbox.close()
    assert pair.inbox.native is None or pair.inbox.native.handle_next(pair.inbox) is None


def test_message_handled_in_a_forked_process_is_not_counted(pair: Pair) -> None:
    """A handler forks, and returns in both processes."""
    pids: list[int] = []

    def fork(_image: Image) -> None:
        pids.append(os.fork())

    pair.on_image = fork
    pair.outbox.publish(picture(7), "")
    pair.run.run_core()
    try:
        pair.inbox.handle_next()
    except BaseException as error:
        os._exit(42 if pids == [0] and isinstance(error, (ForkedProcess, ValueError)) else 1)
    if pids == [0]:
        os._exit(2)
    _, status = os.waitpid(pids[0], 0)
    assert os.waitstatus_to_exitcode(status) == 42
    assert pair.receiver_words[layout.OUT_HANDLED] == 1
    pair.run.run_core()
    assert pair.outbox.outstanding == 0


def test_messages_leave_nothing_behind_in_a_module(pair: Pair) -> None:
    kept = deque[object](maxlen=2)
    pair.on_image = lambda image: kept.append(image.data[1:])
    message = picture(7)
    pair.inbox.subscriptions.subscribe_encoded("sensor_msgs/msg/*", kept.append, "encoded")
    pair.run.run_core()

    def pass_on() -> None:
        pair.outbox.publish(message, "")
        pair.outbox.publish(message, "encoded")
        pair.pass_on()

    for _ in range(20):
        pass_on()
    assert blocks_kept(pass_on, 200) < 1
    kept.clear()


def test_failures_leave_nothing_behind_in_a_module(pair: Pair, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_image: Image) -> None:
        raise KeyError

    pair.on_image = fail
    monkeypatch.setattr(logging.getLogger("robbie.receive"), "disabled", True)
    wrong = Image()
    object.__setattr__(wrong, "data", "no array")

    def try_all() -> None:
        with contextlib.suppress(FieldError):
            pair.outbox.publish(wrong, "")
        assert pair.outbox.publish(encoded("sensor_msgs/msg/Image", 1, b"\0\1\0\0short"), "")
        pair.pass_on()
        pair.outbox.publish(picture(1), "")
        pair.run.run_core()
        with contextlib.suppress(KeyError):
            pair.inbox.handle_next()
        delivery = pair.inbox.current
        assert delivery is not None
        pair.inbox.release(delivery)
        pair.run.run_core()

    for _ in range(20):
        try_all()
    assert blocks_kept(try_all, 100) < 2
