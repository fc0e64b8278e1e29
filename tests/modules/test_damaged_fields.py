"""No module of a stock robot dies of a message with one damaged field."""

import importlib
import logging
import warnings
from collections import Counter
from pathlib import Path
from typing import Any, cast

import pytest

from robbie_mp import Module, ModuleHarness
from robbie_mp.bus.transport.records import ANY_VERSION
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.messages import Message
from robbie_mp.messages.message import MessageType
from robbie_mp.run.profile.load import load_profile
from tests._support.damage import damaged, plausible
from tests._support.places import PROJECT

PROFILES = (
    "demo", "navigation", "rescue", "rescue-team", "home", "parcours", "numbers", "arm", "objects", "spoken",
)  # fmt: skip
TICK_S = 0.2


def modules() -> dict[str, tuple[str, dict[str, object]]]:
    """Return class and settings of each module of the stock robots, each class once."""
    found: dict[str, tuple[str, dict[str, object]]] = {}
    for profile in PROFILES:
        robot = load_profile(profile, PROJECT)
        for one in robot.modules:
            if one.class_path.startswith("robbie_robots."):
                found.setdefault(one.class_path, (profile, dict(one.settings)))
    return found


def inputs(harness: ModuleHarness[Module]) -> list[tuple[ChannelName, type[Message]]]:
    """Return what a module subscribes to, with the class of the messages."""
    return [
        (one.name._replace(topic=one.name.topic or "front"), cast("type[Message]", one.decoder))
        for one in harness.bus.subscriptions
        if isinstance(one.decoder, MessageType) and one.name.version != ANY_VERSION
    ]


@pytest.mark.sampled(20)
@pytest.mark.slow
@pytest.mark.parametrize("class_path", sorted(modules()))
def test_module_survives_every_damaged_field(
    class_path: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, settings = modules()[class_path]
    folder, _, name = class_path.partition(":")
    cls: type[Module] = getattr(importlib.import_module(folder), name)
    made = Counter[str]()
    deaths: dict[str, str] = {}

    def open_one() -> ModuleHarness[Module]:
        return ModuleHarness(cls, settings, output_directory=tmp_path)

    try:
        with open_one() as harness:
            channels = inputs(harness)
    except Exception as error:  # a device, a model or a service that this machine does not have
        pytest.skip(f"cannot be set up alone: {type(error).__name__}: {error}")
    logging.disable(logging.CRITICAL)
    try:
        for channel, message_type in channels:
            harness = _ready(open_one(), channels)
            for what, message in damaged(plausible(message_type)):
                made[message_type.__name__] += 1
                if (death := _death_of(harness, channel, message)) is None:
                    continue
                harness = _ready(open_one(), channels)
                if _death_of(harness, channel, message) is not None:
                    deaths[f"{message_type.__name__} {what}"] = death
                    harness = _ready(open_one(), channels)
            death = _ended(harness)
            if death:
                deaths[f"{message_type.__name__} at the end"] = death
    finally:
        logging.disable(logging.NOTSET)
    with capsys.disabled():
        print(f"\n{name}: {len(made)} types, {made.total()} damaged fields, {len(deaths)} deaths")
    assert not deaths, "\n".join(f"{message}: {death}" for message, death in deaths.items())


def _ready(harness: ModuleHarness[Module], channels: list[tuple[ChannelName, type[Message]]]) -> Any:
    """Return a module that has heard a good message of everything."""
    harness.__enter__()
    for channel, message_type in channels:
        _death_of(harness, channel, plausible(message_type))
    return harness


def _death_of(harness: ModuleHarness[Module], channel: ChannelName, message: Message) -> str | None:
    """Return how a module dies of a message; None if it lives."""
    try:
        with warnings.catch_warnings():  # they end no process
            warnings.simplefilter("ignore")
            harness.send_encoded(*channel[:2], message.encode(), topic=channel.topic)
            harness.advance(TICK_S)
        harness.bus.published.clear()
    except Exception as error:
        return f"{type(error).__name__}: {error}"[:200]
    return None


def _ended(harness: ModuleHarness[Module]) -> str:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            harness.module.teardown()
    except Exception as error:
        return f"teardown: {type(error).__name__}: {error}"[:200]
    return ""
