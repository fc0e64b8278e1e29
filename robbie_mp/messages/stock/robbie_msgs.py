"""What Robbie-MP says itself, where ROS has no message for it."""

from robbie_mp.messages.field_types import DEFAULT
from robbie_mp.messages.message import Message
from robbie_mp.messages.primitives import float64, uint32, uint64
from robbie_mp.messages.stock.builtin_interfaces import Duration, Time
from robbie_mp.messages.stock.std_msgs import Header


class ModuleState(Message, name="robbie_msgs/msg/ModuleState", version=1):
    """The supervisor saw a module change its state."""

    stamp: Time = DEFAULT
    module: str = DEFAULT  # its name in the profile
    state: str = DEFAULT  # STARTING, RUNNING, BACKOFF, FAILED or STOPPED
    incarnation: uint64 = DEFAULT  # counts the module's processes, from 1
    pid: uint32 = DEFAULT  # of its process; 0 if it has none
    restarts: uint32 = DEFAULT  # so far in this run
    reason: str = DEFAULT  # why it changed, for people


class SettingChange(Message, name="robbie_msgs/msg/SettingChange", version=1):
    """Change a setting of the module whose name is the topic."""

    request: uint64 = DEFAULT  # a number that the answer repeats
    setting: str = DEFAULT
    value: str = DEFAULT  # in YAML


class SettingChanged(Message, name="robbie_msgs/msg/SettingChanged", version=1):
    """A module's answer to a SettingChange."""

    request: uint64 = DEFAULT
    module: str = DEFAULT
    setting: str = DEFAULT
    value: str = DEFAULT  # what it is now
    error: str = DEFAULT  # why it was not changed; '' if it was


class DriveCommand(Message, name="robbie_msgs/msg/DriveCommand", version=1):
    """Drive at a velocity, for a while: the device stops when `valid_for` passes without a newer command."""

    header: Header = DEFAULT  # stamp: when it was decided
    linear_m_per_s: float64 = DEFAULT  # forward
    angular_rad_per_s: float64 = DEFAULT  # counter-clockwise seen from above
    valid_for: Duration = DEFAULT
