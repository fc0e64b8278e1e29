"""What waits for a shadow is bounded, and what is lost is counted."""

from robbie_mp.logs.shadow.feed import Feed
from robbie_mp.logs.shadow.frames import Given


def given(number: int, size: int = 1, topic: str = "") -> Given:
    return Given(number, "std_msgs/msg/String", 1, topic, "somebody", bytes(size))


def taken(feed: Feed) -> list[int]:
    return [feed.take().time_ns for _ in range(len(feed))]


def test_oldest_messages_are_lost_and_counted() -> None:
    feed = Feed(most_messages=3)
    for number in range(5):
        feed.add(given(number))
    assert (taken(feed), feed.lost) == ([2, 3, 4], 2)


def test_bytes_are_bounded_but_one_large_message_fits() -> None:
    feed = Feed(most_bytes=100)
    for number in range(4):
        feed.add(given(number, 40))
    assert (feed.messages, feed.lost) == (2, 2)
    feed.add(given(9, 1000))
    assert (taken(feed), feed.lost) == ([9], 4)


def test_only_the_newest_waits_where_no_other_is_wanted() -> None:
    feed = Feed()
    for number in range(4):
        feed.add(given(number, topic="front"), only_newest=True)
        feed.add(given(10 + number, topic="rear"))
    assert (taken(feed), feed.replaced, feed.lost) == ([10, 11, 12, 3, 13], 3, 0)


def test_time_alone_is_no_message() -> None:
    feed = Feed(most_messages=1)
    feed.add(Given(1))
    feed.add(Given(2))
    assert (feed.messages, feed.lost) == (0, 0)
