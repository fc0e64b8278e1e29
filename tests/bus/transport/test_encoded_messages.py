"""Messages as their bytes, by patterns, from outbox to inbox through a real data segment and a core."""

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

from robbie_mp import EncodedMessage
from robbie_mp.bus.transport import layout
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.bus.transport.endpoint import NameTooLong
from robbie_mp.messages import DeclarationError, DecodeError, Image, VersionError
from robbie_mp.module.bus import PublishAfterStop
from robbie_mp.module.subscriptions import EmptyPattern, SubscribedTwice
from tests.bus.transport._support.pair import Pair, encoded, picture


def subscribe(
    pair: Pair, type_pattern: str, handler: Callable[[EncodedMessage], None], topic_pattern: str
) -> None:
    pair.inbox.subscriptions.subscribe_encoded(type_pattern, handler, topic_pattern)
    pair.run.run_core()


def test_encoded_messages_pass_as_they_are_though_nobody_has_a_class_for_them(pair: Pair) -> None:
    came: list[tuple[str, int, bytes]] = []
    subscribe(pair, "team_msgs/*", lambda m: came.append((*m[:2], bytes(m.data))), "*")
    data = b"\x00\x01\x00\x00" + bytes(range(100))
    assert pair.outbox.publish(encoded("team_msgs/msg/Secret", 3, bytearray(data)), "safe")
    assert pair.outbox.publish(picture(7), "")
    pair.pass_on()
    assert came == [("team_msgs/msg/Secret", 3, data)]


def test_class_and_bytes_are_the_same_message(pair: Pair) -> None:
    seen: list[bytes] = []
    pair.on_image = lambda image: seen.append(image.encode())
    subscribe(pair, "*/Image", lambda m: seen.append(bytes(m.data)), "left")
    pair.outbox.publish(encoded(Image.type_name, Image.version, picture(7).encode()), "left")
    pair.outbox.publish(picture(8), "left")
    pair.pass_on()
    assert seen == [picture(value).encode() for value in (7, 7, 8, 8)]
    assert pair.outbox.outstanding == 0


def test_encoded_message_is_copied_once_and_read_in_place(pair: Pair) -> None:
    def look(message: EncodedMessage) -> None:
        assert message.data.readonly
        addresses.append(np.frombuffer(message.data, np.uint8).ctypes.data)

    addresses: list[int] = []
    size = 1 << 20
    data = picture(7, size).encode()
    subscribe(pair, "*/Image", look, "*")
    pair.outbox.publish(encoded(Image.type_name, 1, data), "")
    pair.pass_on()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    pair.outbox.publish(encoded(Image.type_name, 1, data), "")
    pair.pass_on()
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    assert peak < size / 20
    mapped = [np.frombuffer(segment.buffer, np.uint8) for segment in pair.views._segments.values()]
    starts = [(each.ctypes.data, each.nbytes) for each in mapped]
    assert all(any(at <= address < at + length for at, length in starts) for address in addresses)


@pytest.mark.parametrize(
    "look",
    [
        lambda data: data,
        lambda data: data[4:],
        lambda data: np.frombuffer(data, np.uint8)[8:],
        lambda data: np.frombuffer(data.toreadonly().cast("B")[4:12], np.uint32),
    ],
)
def test_view_of_an_encoded_message_that_is_kept_pins_it(
    pair: Pair, look: Callable[[memoryview], object]
) -> None:
    kept: list[object] = []
    subscribe(pair, "*", lambda m: kept.append(look(m.data)), "encoded")
    pair.outbox.publish(encoded(Image.type_name, 1, picture(7).encode()), "encoded")
    pair.pass_on()
    assert pair.receiver_words[layout.OUT_PINNED] == 1
    before = bytes(kept[0])  # type: ignore[call-overload]
    for value in range(50):
        pair.outbox.publish(picture(100 + value), "")
        pair.pass_on()
    assert bytes(kept[0]) == before  # type: ignore[call-overload]
    kept.clear()
    pair.inbox.release_unreferenced()
    pair.run.run_core()
    assert (pair.receiver_words[layout.OUT_PINNED], pair.outbox.outstanding) == (0, 0)


@pytest.mark.parametrize(
    ("arguments", "error", "text"),
    [
        (("a_msgs/msg/A", 1, b""), DecodeError, "0 bytes"),
        (("a_msgs/msg/A", 1, b"\x00\x01\x00"), DecodeError, "3 bytes"),
        (("a_msgs/msg/A", 1, b"\x00\x00\x00\x00abcd"), DecodeError, "00 00 00 00"),
        (("", 1, b"\x00\x01\x00\x00"), DeclarationError, "full name"),
        (("a_msgs/A", 1, b"\x00\x01\x00\x00"), DeclarationError, "full name"),
        (("a_msgs/msg/A", 0, b"\x00\x01\x00\x00"), VersionError, "counted from 1"),
        (("a_msgs/msg/A" * 9, 1, b"\x00\x01\x00\x00"), DeclarationError, "full name"),
        (("a_msgs/msg/" + 90 * "A", 1, b"\x00\x01\x00\x00"), NameTooLong, "96"),
        (("a_msgs/msg/A", 1, b"\x00\x01\x00\x00" + bytes(1 << 22)), MessageTooLarge, "does not fit"),
    ],
)
def test_bytes_that_are_no_message_are_not_published(
    pair: Pair, arguments: tuple[str, int, bytes], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        pair.outbox.publish(encoded(*arguments), "")
    assert pair.outbox.outstanding == 0
    assert pair.run.reports == []


def test_encoded_message_for_which_there_is_no_memory_is_refused_and_counted(pair: Pair) -> None:
    came: list[int] = []
    subscribe(pair, "*/Image", lambda m: came.append(m.version), "encoded")
    data = picture(7, 1 << 19).encode()
    sent = [pair.outbox.publish(encoded(Image.type_name, 1, data), "encoded") for _ in range(4)]
    assert (sent[0], sent[-1]) == (True, False)
    assert pair.sender_words[layout.OUT_REFUSED] == sent.count(False)
    pair.pass_on()
    assert len(came) == sent.count(True)


def test_nothing_encoded_is_published_after_the_end(pair: Pair) -> None:
    pair.outbox.close()
    with pytest.raises(PublishAfterStop):
        pair.outbox.publish(encoded("a_msgs/msg/A", 1, b"\x00\x01\x00\x00"), "")


def test_patterns_that_cannot_match_or_stand_twice_are_refused(pair: Pair) -> None:
    with pytest.raises(EmptyPattern, match="matches all"):
        pair.inbox.subscriptions.subscribe_encoded("", print, "*")
    pair.inbox.subscriptions.subscribe_encoded("*", print, "*")
    with pytest.raises(SubscribedTwice):
        pair.inbox.subscriptions.subscribe_encoded("*", print, "*")
