"""A shadow that has compared nothing is not said to be equal."""

from dataclasses import replace

from robbie_mp.bus.transport.histogram import Distribution
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.shadow.comparison import ShadowReport
from robbie_mp.logs.shadow.pairing import ChannelResult

FINE = ShadowReport(
    channels=[],
    handled=10,
    lost=0,
    replaced=0,
    unhandled=0,
    calls=0,
    module_times=None,
    shadow_times=Distribution(),
    end="",
    from_checkpoint=False,
)


def test_shadow_is_equal_only_if_it_has_lived_and_handled_something() -> None:
    assert FINE.is_equal
    assert not replace(FINE, handled=0, unhandled=36).is_equal
    assert not replace(FINE, end="exit code 3").is_equal


def test_channel_of_which_nothing_was_compared_is_not_equal() -> None:
    channel = ChannelResult(ChannelName("std_msgs/msg/Float64", 1, "double"))
    assert replace(FINE, channels=[channel]).is_equal
    channel.left_out = 100  # the module published, and the shadow did not, in a log of one second
    assert not replace(FINE, channels=[channel]).is_equal
