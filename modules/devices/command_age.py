"""How long a command may be followed: until it expires, or until what it rests on is too old."""

from collections.abc import Callable
from typing import Protocol

from robbie_mp import CallRefused, Duration, Module, Time, setting

AHEAD_S = 0.1
"""A stamp may lie this far in the future: clocks of devices are estimated."""

MAX_AGE_S: float = setting(
    0.25,
    "age of a command's oldest measurement, or of the operator's input, at which it is no longer followed",
    minimum=0.02,
    maximum=1.0,
)
"""The setting of all modules that move something."""
LOOK_FOR = Duration(sec=1)
"""Validity of the commands that turn a camera."""
LOOK_AGE_S: float = setting(
    1.0, "age of what a direction rests on at which the unit no longer turns to it", minimum=0.02
)
"""The setting of all modules that only turn a camera; its direction is sent once."""
HELD_UP_S = 0.02
"""A command that took longer to give may have begun late, and is given again with the time that is left."""
ORDER_WITHIN_S = 1.0
"""An order that lets the robot move is refused when it has waited longer: its client has given it up."""


class MotionCommand(Protocol):
    """A message that moves the robot."""

    @property
    def valid_for(self) -> Duration:
        """Time after which it has expired."""

    @property
    def based_on(self) -> Time:
        """Stamp of the oldest measurement, or operator's input, that it rests on."""


class StaleCommand(ValueError):
    """A command that must not be followed, because it is too old or rests on something too old.

    Example scenarios:
      - the module that computes it has lost its laser and goes on commanding
      - the sender does not set `based_on`
      - the network has delayed it
    """


def left_s(module: Module, command: MotionCommand, max_age_s: float) -> float:
    """Return how long a command that a module is handling may be followed, in s.

    Args:
        module: the module of the device.
        command: the command.
        max_age_s: greatest age of what it rests on.

    Raises:
        StaleCommand: no longer.
    """
    # The age counts from publication: this module may have been stopped while the command waited.
    waited_s = waiting_s(module)
    valid_s = command.valid_for.nanoseconds / 1e9
    if waited_s >= valid_s > 0.0:
        raise StaleCommand(f"it waited {waited_s:.2f} s and is valid for {valid_s:g} s")
    age_s = age_of(module, command.based_on)
    if age_s < -AHEAD_S:
        raise StaleCommand(f"it rests on what will be known in {-age_s:.2f} s: the clocks do not agree")
    if age_s >= max_age_s:
        known = (
            f"was known {age_s:.2f} s ago" if command.based_on.nanoseconds else "it does not say (based_on)"
        )
        raise StaleCommand(f"it rests on what {known}; at most {max_age_s:g} s are allowed")
    return min(valid_s - waited_s, max_age_s - age_s)


def command_since(
    module: Module,
    judged_s: float,
    valid_for_s: float,
    command: Callable[[float], object],
    end: Callable[[], object],
) -> None:
    """Give a device a command that ends in time, however long this process is held up meanwhile.

    A device counts the validity from when it takes the command. If this process was stopped or had no
    processor since the command was judged, it would move on what has become old.

    Args:
        module: the module of the device.
        judged_s: when the command was judged, by the module's monotonic clock, s.
        valid_for_s: how long it was valid then, s.
        command: gives the device the command; gets how long it is valid, s.
        end: ends a command that the device has taken too late.

    Raises:
        StaleCommand: its time is over.
    """
    told_s = module.monotonic_s()
    if told_s - judged_s >= valid_for_s > 0.0:
        raise StaleCommand(f"this module was held up for {told_s - judged_s:.2f} s while it judged it")
    command(judged_s + valid_for_s - told_s)
    while (now_s := module.monotonic_s()) - told_s > HELD_UP_S:
        told_s = now_s
        if told_s - judged_s >= valid_for_s:
            end()
            raise StaleCommand(f"this module was held up for {told_s - judged_s:.2f} s while it gave it")
        command(judged_s + valid_for_s - told_s)


def waiting_s(module: Module) -> float:
    """Return how long the message that a module is handling has waited since it was published, in s."""
    return max(0.0, (module.clock.monotonic_ns() - module.envelope.published_ns) / 1e9)


def is_late(module: Module) -> bool:
    """Return whether the order that a module is handling is too old for the robot to move by it."""
    return waiting_s(module) > ORDER_WITHIN_S


def check_order(module: Module) -> None:
    """Check that the order that a module is handling, by which the robot may move, is not late.

    Raises:
        CallRefused: it is. Its client may have been told that nobody answers.
    """
    if is_late(module):
        waited_s = waiting_s(module)
        raise CallRefused(f"the order has waited {waited_s:.1f} s, which is too long; give it again")


def age_of(module: Module, stamp: Time) -> float:
    """Return how long ago a stamp was by the module's clock, in s."""
    return (module.clock.now_ns() - stamp.nanoseconds) / 1e9
