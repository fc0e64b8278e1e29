"""Commands that rest on what is known now, as those of a module that sees, and messages that have waited."""

from typing import Any, TypeVar

import pytest

from robbie_mp import Message, ModuleHarness, Time
from robbie_mp.messages import replace

Command = TypeVar("Command", bound=Message)


def fresh(harness: ModuleHarness[Any], command: Command, age_s: float = 0.0) -> Command:
    """Return the command with the stamp of what it rests on, by the harness' clock."""
    stamp_ns = max(0, harness.clock.now_ns() - round(age_s * 1e9))
    return replace(command, based_on=Time.from_nanoseconds(stamp_ns))


def waits(harness: ModuleHarness[Any], monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Let all messages wait from now on before they are handled, as in a process that was stopped."""
    envelope, published_ns = harness.bus.envelope, harness.clock.monotonic_ns() - round(seconds * 1e9)
    monkeypatch.setattr(harness.bus, "envelope", lambda: envelope()._replace(published_ns=published_ns))
