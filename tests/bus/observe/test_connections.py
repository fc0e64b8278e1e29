"""What is said about subscriptions that nobody publishes for."""

import pytest

from robbie_mp.bus.observe.connections import Unconnected, unconnected
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName

SCAN = "sensor_msgs/msg/LaserScan"


def said(wanted: ChannelName, published: dict[ChannelName, list[str]]) -> list[str]:
    return [str(one) for one in unconnected([wanted], published)]


@pytest.mark.parametrize("wanted", [ChannelName(SCAN, 2, ""), ChannelName(SCAN, 2, "front")])
def test_subscription_that_somebody_has_published_for_is_connected(wanted: ChannelName) -> None:
    assert not said(wanted, {ChannelName(SCAN, 2, "front"): []})


def test_patterns_may_match_nothing() -> None:
    assert not said(ChannelName("sensor_msgs/*", ANY_VERSION, "*"), {})


def test_type_that_nobody_publishes() -> None:
    others = {ChannelName("nav_msgs/msg/Odometry", 1, "scan"): ["base"]}
    expected = ["gets no sensor_msgs/LaserScan on topic 'scan': nobody publishes it"]
    assert (
        said(ChannelName(SCAN, 1, "scan"), {ChannelName("nav_msgs/msg/Odometry", 1, "odo"): []}) == expected
    )
    carries = [f"{expected[0]}; topic 'scan' carries nav_msgs/Odometry (by base)"]
    assert said(ChannelName(SCAN, 1, "scan"), others) == carries
    assert said(ChannelName(SCAN, 1, ""), others) == ["gets no sensor_msgs/LaserScan: nobody publishes it"]


def test_type_that_is_published_on_another_topic_names_it_and_its_publisher() -> None:
    found = said(
        ChannelName(SCAN, 1, "scan"),
        {ChannelName(SCAN, 1, "front"): ["laser"], ChannelName(SCAN, 1, "rear"): ["laser", "spare"]},
    )
    assert found == [
        "gets no sensor_msgs/LaserScan on topic 'scan': it is published only on topic 'front', 'rear' "
        "(by laser, spare)"
    ]


def test_type_of_another_version_names_both_versions() -> None:
    (found,) = said(ChannelName(SCAN, 2, "scan"), {ChannelName(SCAN, 1, "scan"): ["laser"]})
    assert found == (
        "gets no sensor_msgs/LaserScan on topic 'scan': only version 1 is published (by laser), and this is "
        "a subscription to version 2"
    )


def test_other_version_on_the_topic_is_nearer_than_the_right_one_elsewhere() -> None:
    channels = {ChannelName(SCAN, 2, "rear"): ["a"], ChannelName(SCAN, 1, "front"): ["b"]}
    (found,) = unconnected([ChannelName(SCAN, 2, "front")], channels)
    assert found == Unconnected(SCAN, 2, "front", found.why)
    assert "only version 1 is published (by b)" in found.why


def test_publishers_that_are_gone_and_crowds_of_topics_are_not_listed() -> None:
    many: dict[ChannelName, list[str]] = {ChannelName(SCAN, 1, f"t{number}"): [] for number in range(9)}
    (found,) = unconnected([ChannelName(SCAN, 1, "scan")], many)
    assert found.why == "it is published only on topic 't0', 't1', 't2', …"
