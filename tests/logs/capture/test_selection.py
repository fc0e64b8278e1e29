"""The messages that are recorded, and those that are reported as missing."""

import pytest

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.capture.queue_drops import QueueDrops, key_of_missing, share_out
from robbie_mp.logs.capture.selection import Selection
from robbie_mp.logs.recording.format import ChannelKey

SCAN, IMAGE, ODOMETRY = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Image", "nav_msgs/msg/Odometry"


@pytest.mark.parametrize(
    ("types", "topics", "exclude", "expected"),
    [
        (["*"], ["*"], [], {(SCAN, "front"), (SCAN, ""), (IMAGE, "camera/left"), (ODOMETRY, "")}),
        (["LaserScan"], ["*"], [], {(SCAN, "front"), (SCAN, "")}),
        (["sensor_msgs/*"], ["*"], ["Image"], {(SCAN, "front"), (SCAN, "")}),
        (["*"], ["camera/*", "front"], [], {(SCAN, "front"), (IMAGE, "camera/left")}),
        (["*"], [""], [], {(SCAN, ""), (ODOMETRY, "")}),
        (["*"], ["*"], ["camera/*", "nav_msgs/*"], {(SCAN, "front"), (SCAN, "")}),
    ],
)
def test_types_and_topics_are_selected_by_patterns(
    types: list[str], topics: list[str], exclude: list[str], expected: set[tuple[str, str]]
) -> None:
    selection = Selection.by_types_and_topics(types, topics, exclude)
    passing = [(SCAN, "front"), (SCAN, ""), (IMAGE, "camera/left"), (ODOMETRY, "")]
    assert {one for one in passing if selection.wants(*one)} == expected
    assert all(selection.is_subscribed(*one) for one in expected)


def test_pattern_without_a_match_is_reported() -> None:
    selection = Selection.by_either(["front", "Odometry", "nothing"], ["rear"])
    assert selection.wants(SCAN, "front")
    assert selection.wants(ODOMETRY, "")
    assert not selection.wants(IMAGE, "rear")
    assert list(selection.unmatched) == ["'nothing'"]


FRONT, REAR = ChannelName(SCAN, 1, "front"), ChannelName(SCAN, 1, "rear")


def test_messages_dropped_by_the_core_are_reported_once_per_channel() -> None:
    missed, passed = 0, {FRONT: 100}
    drops = QueueDrops(lambda: missed, lambda: dict(passed))
    passed |= {FRONT: 150, REAR: 20}
    assert drops.look({FRONT: 40, REAR: 20}) == {}  # the others still wait
    missed = 7
    assert drops.look({FRONT: 43, REAR: 20}) == {FRONT: 7}
    assert drops.look({FRONT: 43, REAR: 20}) == {}
    missed, passed = 17, {FRONT: 160, REAR: 30}
    assert drops.look({FRONT: 50, REAR: 23}) == {FRONT: 3, REAR: 7}
    assert drops.missed == 17


def test_restarted_process_does_not_report_losses_twice() -> None:
    drops = QueueDrops(lambda: 17, lambda: {FRONT: 160}, missed_before=17)
    assert drops.look({}) == {}


@pytest.mark.parametrize(
    ("total", "weights"), [(1, [1, 1, 1]), (10, [3, 0, 4]), (7, [1000, 1, 1]), (5, [0, 2])]
)
def test_shares_add_up(total: int, weights: list[int]) -> None:
    shares = share_out(total, {ChannelName("t", 1, str(i)): weight for i, weight in enumerate(weights)})
    assert sum(shares.values()) == total
    assert share_out(3, {FRONT: 0}) == {}


def test_sender_of_missing_messages_is_known_if_there_is_only_one() -> None:
    laser, other = ChannelKey(*FRONT, "laser"), ChannelKey(*FRONT, "other")
    assert key_of_missing(FRONT, [laser, ChannelKey(*REAR, "base")]) == laser
    assert key_of_missing(FRONT, [laser, other]).sender == ""
    assert key_of_missing(FRONT, []).sender == ""
