"""What a module and its shadow publish is paired by stamps, content or order, and compared."""

import numpy as np
import pytest

from robbie_mp import Message
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.shadow.comparison import Comparison
from robbie_mp.logs.shadow.pairing import MOST_WAITING, ChannelResult, Side
from robbie_mp.messages import Header, LaserScan, String, Time
from robbie_mp.messages.schema import schema_text

S = 10**9
MODULE, SHADOW = Side.MODULE, Side.SHADOW
TYPES = {one.type_name: one for one in (String, LaserScan)}


class Compared:
    """A comparison that began at 0 s."""

    def __init__(self) -> None:
        self.comparison = Comparison(0, lambda name, _version: schema_text(TYPES[name]))

    def add(self, side: Side, at_s: float, message: Message) -> None:
        name = ChannelName(message.type_name, message.version, "")
        self.comparison.add(side, name, round(at_s * S), message.encode())

    def end(self, at_s: float) -> ChannelResult:
        (result,) = self.comparison.end(round(at_s * S))
        return result


def scan(stamp_s: int, *ranges: float) -> LaserScan:
    header = Header(stamp=Time(sec=stamp_s), frame_id="laser")
    return LaserScan(header=header, ranges=np.array(ranges, np.float32))


def text(what: object) -> String:
    return String(data=str(what))


def counts(result: ChannelResult) -> tuple[int, int, int, int]:
    return result.equal, result.different, *result.only  # type: ignore[return-value]


def test_same_messages_are_equal_however_late_the_shadow_is() -> None:
    compared = Compared()
    for number in range(5):
        compared.add(MODULE, number * 0.1, text(number))
    for number in range(5):
        compared.add(SHADOW, number * 0.1, text(number))
    assert counts(compared.end(1.0)) == (5, 0, 0, 0)


def test_messages_are_paired_by_their_stamps_and_say_how_much_they_differ() -> None:
    compared = Compared()
    for number in range(1, 5):
        compared.add(MODULE, number, scan(number, 1.0, 2.0))
    for number in (1, 3, 4):  # it has missed one
        compared.add(SHADOW, number + 0.1, scan(number, 1.0, 2.0 + number / 4))
    result = compared.end(100.0)
    assert counts(result) == (0, 3, 1, 0)
    assert result.first is not None
    assert (result.first.field, result.first.a, result.first.b) == ("ranges[1]", "2.0", "2.25")
    assert result.amounts["ranges"].largest == pytest.approx(1.0)
    assert result.amounts["ranges"].mean == pytest.approx((0.25 + 0.75 + 1.0) / 3)


def test_stamps_of_two_clocks_do_not_count_as_a_difference() -> None:
    compared = Compared()
    for number in range(1, 4):
        compared.add(MODULE, number, scan(10 * number, 1.0))
        compared.add(SHADOW, number + 0.1, scan(10 * number + 3, 1.0))
    assert counts(compared.end(100.0)) == (3, 0, 0, 0)


def test_what_only_one_publishes_is_said() -> None:
    compared = Compared()
    for number in range(2, 6):
        compared.add(MODULE, number, text(number))
        compared.add(SHADOW, number, text(number))
        compared.add(SHADOW, number + 0.01, text(f"{number} and more"))
    assert counts(compared.end(100.0)) == (4, 0, 0, 4)


def test_begin_and_end_are_left_out_where_one_side_was_not_there() -> None:
    compared = Compared()
    compared.add(MODULE, 0.1, text("of a message before"))
    for number in range(3):
        compared.add(MODULE, 0.2 + number, text(number))
        compared.add(SHADOW, 0.2 + number, text(number))
    compared.add(MODULE, 2.9, text("too late for the shadow"))
    result = compared.end(3.0)
    assert counts(result) == (3, 0, 0, 0)
    assert result.left_out == 2


def test_flood_without_counterparts_is_bounded_and_counted() -> None:
    compared = Compared()
    for number in range(3 * MOST_WAITING):
        compared.add(SHADOW, 2 + number, text(number))
    assert counts(compared.end(10_000.0))[3] == 3 * MOST_WAITING


def test_nothing_waits_for_ever() -> None:
    compared = Compared()
    compared.add(MODULE, 2.0, text("a"))
    compared.comparison.expire(round(2.5 * S))
    compared.comparison.expire(4 * S)
    compared.add(SHADOW, 4.0, text("a"))
    compared.comparison.expire(9 * S)
    assert counts(compared.end(9.0)) == (0, 0, 1, 1)
