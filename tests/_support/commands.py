"""Commands that rest on what is known now, as those of a module that sees."""

from typing import Any, TypeVar

from robbie_mp import Message, ModuleHarness, Time
from robbie_mp.messages import replace

Command = TypeVar("Command", bound=Message)


def fresh(harness: ModuleHarness[Any], command: Command, age_s: float = 0.0) -> Command:
    """Return the command with the stamp of what it rests on, by the harness' clock."""
    stamp_ns = max(0, harness.clock.now_ns() - round(age_s * 1e9))
    return replace(command, based_on=Time.from_nanoseconds(stamp_ns))
