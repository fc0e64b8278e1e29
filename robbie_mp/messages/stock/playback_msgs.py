"""Messages that control a playback and show its state."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.flaws import Flaw, nan_in
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import float64, uint64
from robbie_mp.messages.stock.builtin_interfaces import Time


class PlaybackControl(Message, name="robbie_msgs/msg/PlaybackControl", version=1):
    """Steer the playback of a log."""

    request: uint64 = DEFAULT  # a number that PlaybackState repeats; 0: none
    command: str = DEFAULT  # pause, resume, step (pause, and play one message), seek or rate
    value: float64 = DEFAULT  # seek: s from the log's beginning; rate: times real time, infinity: no waiting

    def flaw(self) -> Flaw | None:
        """Return a value that is no number."""
        return nan_in(self, "value")


class PlaybackState(Message, name="robbie_msgs/msg/PlaybackState", version=1):
    """The state of a playback; published at each change, and regularly in between."""

    file: str = DEFAULT
    begin: Time = DEFAULT  # of the part of the log that is played
    end: Time = DEFAULT
    position: Time = DEFAULT  # the log's time now
    rate: float64 = DEFAULT  # times real time; infinity: as fast as possible without a loss
    paused: bool = DEFAULT
    loop: bool = DEFAULT
    lockstep: bool = DEFAULT
    ended: bool = DEFAULT  # everything has been played
    messages: uint64 = DEFAULT  # played so far
    jumps: uint64 = DEFAULT  # number of jumps of the time so far
    request: uint64 = DEFAULT  # the last control that was handled
    error: str = DEFAULT  # why that was refused; '' if it was not

    def flaw(self) -> Flaw | None:
        """Return a rate that is no number."""
        return nan_in(self, "rate")


class TimeJump(Message, name="robbie_msgs/msg/TimeJump", version=1):
    """The run's clock has jumped: earlier knowledge of the robot's pose is no longer valid.

    It is published after all messages from before the jump, and before the first message after it.
    """

    before: Time = DEFAULT  # what the clock showed
    after: Time = DEFAULT  # what it shows now
    reason: str = DEFAULT  # start (of a playback), seek, loop, gap (of the log's own time), reset (of ROS's)
