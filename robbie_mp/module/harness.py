"""Runs a module inside a test, without a process or shared memory; the test controls the time."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Generic, NamedTuple, Self, TypeVar
from weakref import finalize

from robbie_mp.checkpoint.image import decode, encode
from robbie_mp.messages import Message, lay_out
from robbie_mp.messages.encoded import check_encapsulation, check_type
from robbie_mp.messages.message import check_message, check_message_type
from robbie_mp.module.bus import PublishAfterStop
from robbie_mp.module.clock import ManualClock
from robbie_mp.module.config import Config
from robbie_mp.module.envelope import Envelope, MessageType
from robbie_mp.module.module import Module, ModuleContext, check_period
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.settings import check_settings
from robbie_mp.module.subscriptions import Subscriptions
from robbie_mp.transport.records import ANY_VERSION
from robbie_mp.transport.tables import ChannelName

ModuleClass = TypeVar("ModuleClass", bound=Module)


class Published(NamedTuple):
    """A message that the module under test has published."""

    message: Message
    topic: str


class PublishedEncoded(NamedTuple):
    """An encoded message that the module under test has published."""

    type_name: str
    version: int
    data: bytes
    topic: str


class ModuleHarness(Generic[ModuleClass]):
    """Sends messages to a module and collects what it publishes.

        with ModuleHarness(Obstacles, {"stop_distance_m": 0.5}) as harness:
            harness.send(LaserScan(ranges=[0.4]))
            assert harness.take(DriveCommand)

    Messages and checkpoints are encoded and decoded as in a robot: handlers get read-only arrays, and wrong
    field types are errors.

    Args:
        module_class: the class under test.
        settings: values of settings; the other settings have their defaults.
        config: the robot's configuration, with dotted keys.
        output_directory: where the module writes results; by default a folder that is removed with the
            harness.
        name: the module's name in the profile.
        restored: the state that the module finds in `restored`, such as `checkpoint` of another harness.

    Attributes:
        module: the module under test.
        clock: the module's clock; it stands still except in `advance`.

    Raises:
        SettingError: a setting is wrong.
    """

    def __init__(
        self,
        module_class: type[ModuleClass],
        settings: Mapping[str, object] | None = None,
        *,
        config: Mapping[str, object] | None = None,
        output_directory: Path | None = None,
        name: str = "module",
        restored: object = None,
    ):
        self.clock = ManualClock()
        self.bus = HarnessBus(self.clock)
        self._checkpoints = HarnessCheckpoints(restored)
        checked = check_settings(module_class, settings or {})
        module_class.check(checked)
        if output_directory is None:
            output_directory = Path(mkdtemp(prefix="robbie-harness-"))
            finalize(self, rmtree, output_directory, ignore_errors=True)
        self.module = module_class(
            ModuleContext(
                name=name,
                settings=checked,
                bus=self.bus,
                clock=self.clock,
                config=Config(config or {}),
                checkpoints=self._checkpoints,
                output_directory=output_directory,
                show_status=lambda _line: None,
            )
        )
        self._changes = SettingChanges(self.module, self.bus)
        self._next_tick_ns = 0

    def __enter__(self) -> Self:
        """Run `setup()`.

        Raises:
            InvalidPeriod: the module's `period_s` is not positive, or it has a `tick()` but no period.
        """
        self._changes.listen()
        self.module.setup()
        check_period(self.module)
        self._next_tick_ns = self.clock.monotonic_ns()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Run `teardown()` as an ordered stop does, unless the test has already failed."""
        if error is None:
            self.module.teardown()
        self.bus.stopped = True

    def send(self, message: Message, *, topic: str = "", sender: str = "test") -> None:
        """Let the module handle a message now, if it subscribes to it.

        Args:
            message: the message.
            topic: the topic it is published on.
            sender: the name of its publisher, for `envelope`.
        """
        self.bus.deliver(ChannelName(message.type_name, message.version, topic), message.encode(), sender)

    def send_encoded(
        self, type_name: str, version: int, data: bytes, *, topic: str = "", sender: str = "test"
    ) -> None:
        """Let the module handle an encoded message now, if one of its patterns matches.

        Args:
            type_name: full name of the message's type, which needs no class.
            version: version of that type.
            data: the encoded message with its 4 bytes of encapsulation.
            topic: the topic it is published on.
            sender: the name of its publisher, for `envelope`.
        """
        self.bus.deliver(ChannelName(type_name, version, topic), data, sender)

    def change_setting(self, name: str, value: object) -> None:
        """Change a setting as `robbie param set` does.

        Args:
            name: the setting.
            value: its new value, as a profile would hold it.

        Raises:
            NotChangeable: the module has no changeable setting of this name.
            SettingError: the value does not fit, or the module refuses it.
        """
        self._changes.change(name, value)

    def advance(self, seconds: float) -> None:
        """Move the time forward and run every tick that becomes due; the first tick is due at once.

        Args:
            seconds: how far.
        """
        end_ns = self.clock.monotonic_ns() + round(seconds * 1e9)
        period_s = self.module.period_s
        while period_s is not None and self._next_tick_ns <= end_ns and not self.module.stop_requested:
            self.clock.advance((self._next_tick_ns - self.clock.monotonic_ns()) / 1e9)
            self.module.tick()
            self._next_tick_ns += round(period_s * 1e9)
        self.clock.advance((end_ns - self.clock.monotonic_ns()) / 1e9)

    @property
    def checkpoint(self) -> Any:
        """The state that the module would find in `restored` after a crash now; None for a fresh start."""
        return decode(self._checkpoints.image).state

    @property
    def published(self) -> list[Published]:
        """Everything that the module has published and the test has not taken."""
        return self.bus.published

    @property
    def published_encoded(self) -> list[PublishedEncoded]:
        """Every encoded message that the module has published."""
        return self.bus.published_encoded

    def take(self, message_type: type[MessageType], topic: str | None = None) -> list[MessageType]:
        """Take the messages of a type out of what the module has published.

        Args:
            message_type: the class of the messages.
            topic: take only messages on this topic; None for all.

        Returns:
            The messages, in the order of publishing.
        """
        taken: list[MessageType] = []
        kept: list[Published] = []
        for entry in self.bus.published:
            if isinstance(entry.message, message_type) and topic in (None, entry.topic):
                taken.append(entry.message)
            else:
                kept.append(entry)
        self.bus.published[:] = kept
        return taken


class HarnessCheckpoints:
    """Keeps the image of a module's newest checkpoint; its size has no limit."""

    def __init__(self, restored: object):
        self.image = encode(restored)

    @property
    def restored(self) -> Any:
        """The state in the image, with copies of its arrays."""
        return decode(self.image).state

    def save(self, state: object) -> bool:
        """Replace the image."""
        self.image = encode(state)
        return True


class HarnessBus:
    """A bus with one module on it."""

    def __init__(self, clock: ManualClock):
        self._clock = clock
        numbers = count()
        self._name = ChannelName("", 0, "")
        self.subscriptions = Subscriptions(lambda _: next(numbers), lambda: self._name)
        self._current: Envelope | None = None
        self._sequence = 0
        self.published: list[Published] = []
        self.published_encoded: list[PublishedEncoded] = []
        self.stopped = False

    @property
    def outstanding(self) -> int:
        """Always 0: the harness takes each message at once."""
        return 0

    def deliver(self, name: ChannelName, data: bytes, sender: str) -> None:
        """Run every handler that subscribes to a message, but of those with patterns only the first."""
        self._sequence += 1
        self._name = name
        self._current = Envelope(name.topic, self._sequence, sender, self._clock.monotonic_ns())
        matched_pattern = False
        for subscription in self.subscriptions:
            by_pattern = subscription.name.version == ANY_VERSION
            if (by_pattern and matched_pattern) or not subscription.name.takes(name):
                continue
            matched_pattern |= by_pattern
            subscription.handler(subscription.decoder.decode(memoryview(data)))
        self._current = None

    def advertise(self, message_type: type[Message], topic: str) -> None:
        """Check the type; there is nobody to tell."""
        check_message_type(message_type, "advertise")

    def publish(self, message: Message, topic: str) -> bool:
        """Collect a message."""
        check_message(message, "publish")
        if self.stopped:
            raise PublishAfterStop(f"this module published a {message.type_name} after it was stopped")
        self.published.append(Published(type(message).decode(message.encode()), topic))
        return True

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, topic: str
    ) -> bool:
        """Collect an encoded message."""
        if self.stopped:
            raise PublishAfterStop(f"this module published a {type_name} after it was stopped")
        check_type(type_name, version)
        check_encapsulation(type_name, memoryview(data).cast("B"))
        self.published_encoded.append(PublishedEncoded(type_name, version, bytes(data), topic))
        return True

    @contextmanager
    def loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object]
    ) -> Iterator[MessageType]:
        """Collect a message that is filled in place."""
        check_message_type(message_type, "loan")
        plan = lay_out(message_type, fields)
        buffer = bytearray(plan.size)
        message = plan.write(memoryview(buffer))
        yield message
        message.forget_arrays()
        self.publish(message_type.decode(bytes(buffer)), topic)

    def wake_after_freed(self, messages: int) -> None:
        """Do nothing: there is always room."""

    def envelope(self) -> Envelope:
        """Return the envelope of the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self._current is None:
            raise LookupError("there is an envelope only while a message is being handled")
        return self._current
