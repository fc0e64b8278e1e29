"""A name on the command line says which messages are meant, or the error says why not."""

import pytest

from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.cli.channel_choice import NoSuchMessages, choose_channel, nobody_publishes, nobody_subscribes
from robbie_mp.messages.descriptions import KnownTypes

SCAN, IMAGE, IMU = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu"
CHANNELS = [
    ChannelName(SCAN, 1, "laser/front"),
    ChannelName(SCAN, 1, ""),
    ChannelName(IMU, 1, "imu"),
    ChannelName(SCAN, 1, "Image"),
    ChannelName(SCAN, 1, "both"),
    ChannelName(IMAGE, 1, "both"),
    ChannelName("team_msgs/msg/Foreign", 3, "foreign"),
]


def choose(name: str, topic: str = "") -> ChannelName:
    return choose_channel(name, topic, KnownTypes(), CHANNELS)


@pytest.mark.parametrize(
    ("name", "topic", "expected"),
    [
        ("LaserScan", "", (SCAN, 1, "")),
        ("laserscan", "", (SCAN, 1, "")),
        ("sensor_msgs/LaserScan", "laser/front", (SCAN, 1, "laser/front")),
        ("LaserScan", "/laser/front", (SCAN, 1, "laser/front")),
        ("LaserScan", "new", (SCAN, 1, "new")),
        ("laser/front", "", (SCAN, 1, "laser/front")),
        ("/laser/front", "", (SCAN, 1, "laser/front")),
        ("imu", "", (IMU, 1, "imu")),
        ("Imu", "", (IMU, 1, "")),
        ("Image", "both", (IMAGE, 1, "both")),
        (SCAN, "Image", (SCAN, 1, "Image")),
        ("foreign", "", ("team_msgs/msg/Foreign", 3, "foreign")),
        ("team_msgs/Foreign", "", ("team_msgs/msg/Foreign", 3, "")),
    ],
)
def test_type_or_topic_is_chosen(name: str, topic: str, expected: tuple[str, int, str]) -> None:
    assert choose(name, topic) == expected


@pytest.mark.parametrize(
    ("name", "topic", "error"),
    [
        ("lasr/front", "", "no message type and no topic is called 'lasr/front'; did you mean 'laser/front'"),
        ("LaserScn", "", "no message type and no topic is called 'LaserScn'; did you mean 'LaserScan'"),
        ("laser/front", "imu", "no message type and no topic is called 'laser/front'"),
        ("nav_msgs/LaserScan", "", "did you mean 'sensor_msgs/msg/LaserScan'"),
        (
            "both",
            "",
            f"topic 'both' has messages of the types {IMAGE}, {SCAN}; name one of them, as in {IMAGE}",
        ),
        (
            "Image",
            "",
            f"'Image' is a topic, and also the type {IMAGE}; write {IMAGE} for the type, and {SCAN} ",
        ),
    ],
)
def test_unclear_name_is_an_error_that_says_why(name: str, topic: str, error: str) -> None:
    with pytest.raises(NoSuchMessages) as raised:
        choose(name, topic)
    assert error in str(raised.value)


def test_command_says_on_which_topics_a_type_is_published() -> None:
    assert nobody_publishes(ChannelName(SCAN, 1, "laser/front"), CHANNELS) == ""
    assert nobody_publishes(ChannelName(SCAN, 1, ""), CHANNELS) == ""
    assert nobody_publishes(ChannelName(SCAN, 2, ""), CHANNELS) == f"no module publishes {SCAN}"
    assert nobody_publishes(ChannelName(SCAN, 1, "rear"), CHANNELS) == (
        f"no module publishes {SCAN} on topic 'rear'; there are messages without a topic, 'Image', 'both', "
        "'laser/front'"
    )


@pytest.mark.parametrize(
    ("topic", "hint"),
    [
        ("scan", ""),
        ("", "nobody subscribes to sensor_msgs/msg/LaserScan on topic ''; it is taken on 'scan'"),
        ("scna", "nobody subscribes to sensor_msgs/msg/LaserScan on topic 'scna'; did you mean 'scan'?"),
    ],
)
def test_nobody_hears_on_another_topic(topic: str, hint: str) -> None:
    subscribed = [ChannelName("sensor_msgs/msg/LaserScan", 1, "scan"), ChannelName("std_msgs/msg/*", 0, "*")]
    assert nobody_subscribes(ChannelName("sensor_msgs/msg/LaserScan", 1, topic), subscribed) == hint
    assert nobody_subscribes(ChannelName("std_msgs/msg/String", 1, topic), subscribed) == ""
    other = nobody_subscribes(ChannelName("nav_msgs/msg/Path", 1, topic), subscribed)
    assert other.startswith("nobody subscribes to nav_msgs/msg/Path; ")
