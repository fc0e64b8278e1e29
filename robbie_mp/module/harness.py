"""Runs a module inside a test: no process, no shared memory, and time moves when the test says so."""

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
from robbie_mp.module.bus import Envelope, MessageType, PublishAfterStop
from robbie_mp.module.clock import ManualClock
from robbie_mp.module.config import Config
from robbie_mp.module.module import Module, ModuleContext
from robbie_mp.module.setting_changes import SettingChanges
from robbie_mp.module.settings import check_settings
from robbie_mp.module.subscriptions import Subscriptions
from robbie_mp.transport.endpoint import ChannelName
from robbie_mp.transport.records import ANY_VERSION

ModuleClass = TypeVar("ModuleClass", bound=Module)


class Published(NamedTuple):
    """A message that the module under test has sent."""

    message: Message
    topic: str


class PublishedEncoded(NamedTuple):
    """A message that the module under test has sent as its bytes."""

    type_name: str
    version: int
    data: bytes
    topic: str


class ModuleHarness(Generic[ModuleClass]):
    """Feeds a module with messages and collects what it publishes.

        with ModuleHarness(Obstacles, {"stop_distance_m": 0.5}) as harness:
            harness.send(LaserScan(ranges=[0.4]))
            assert harness.take(DriveCommand)

    Messages pass through their bytes on the way in and out, so handlers see what they see in a robot:
    read-only arrays, and wrong field types are errors. So do checkpoints.

    Args:
        module_class: the class under test.
        settings: values for its settings; the others have their defaults.
        config: the robot's configuration, dotted keys.
        output_directory: where it may write results; by default a folder that is removed with the harness.
        name: its name in the profile.
        restored: the state it finds from its last incarnation, as `harness.checkpoint` of another harness.
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
        """Run `setup()`."""
        self._changes.listen()
        self.module.setup()
        self._next_tick_ns = self.clock.monotonic_ns()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Run `teardown()` as an ordered stop does, unless the test has failed already."""
        if error is None:
            self.module.teardown()
        self.bus.stopped = True

    def send(self, message: Message, *, topic: str = "", sender: str = "test") -> None:
        """Have the module handle a message now, if it subscribes to it."""
        self.bus.deliver(ChannelName(message.type_name, message.version, topic), message.encode(), sender)

    def send_encoded(
        self, type_name: str, version: int, data: bytes, *, topic: str = "", sender: str = "test"
    ) -> None:
        """Have the module handle a message of a type without a class, if one of its patterns matches."""
        self.bus.deliver(ChannelName(type_name, version, topic), data, sender)

    def change_setting(self, name: str, value: object) -> None:
        """Change a setting as `robbie param set` does.

        Raises:
            NotChangeable: there is no such setting to change.
            SettingError: the value does not fit, or the module refuses it.
        """
        self._changes.change(name, value)

    def advance(self, seconds: float) -> None:
        """Let time pass, with every tick that is due on the way (the first one at once)."""
        end_ns = self.clock.monotonic_ns() + round(seconds * 1e9)
        period_s = self.module.period_s
        while period_s is not None and self._next_tick_ns <= end_ns and not self.module.stop_requested:
            self.clock.advance((self._next_tick_ns - self.clock.monotonic_ns()) / 1e9)
            self.module.tick()
            self._next_tick_ns += round(period_s * 1e9)
        self.clock.advance((end_ns - self.clock.monotonic_ns()) / 1e9)

    @property
    def checkpoint(self) -> Any:
        """The state that the module would find if it were killed now; None if it would start fresh."""
        return decode(self._checkpoints.image).state

    @property
    def published(self) -> list[Published]:
        """Everything the module has sent and the test has not taken."""
        return self.bus.published

    @property
    def published_encoded(self) -> list[PublishedEncoded]:
        """Everything the module has sent as its bytes."""
        return self.bus.published_encoded

    def take(self, message_type: type[MessageType], topic: str | None = None) -> list[MessageType]:
        """Take the messages of a type (and topic) that the module has sent."""
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
    """Keeps the image of a module's newest checkpoint, without any limit."""

    def __init__(self, restored: object):
        self.image = encode(restored)

    @property
    def restored(self) -> Any:
        """The state in the image, with arrays of its own."""
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
        """Always none: whatever is published is taken at once."""
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

    def publish(self, message: Message, topic: str) -> bool:
        """Collect a message."""
        if self.stopped:
            raise PublishAfterStop(f"a {message.type_name} was published after this module was stopped")
        self.published.append(Published(type(message).decode(message.encode()), topic))
        return True

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, topic: str
    ) -> bool:
        """Collect a message that is given as its bytes."""
        if self.stopped:
            raise PublishAfterStop(f"a {type_name} was published after this module was stopped")
        check_type(type_name, version)
        check_encapsulation(type_name, memoryview(data).cast("B"))
        self.published_encoded.append(PublishedEncoded(type_name, version, bytes(data), topic))
        return True

    @contextmanager
    def loan(
        self, message_type: type[MessageType], topic: str, fields: Mapping[str, object]
    ) -> Iterator[MessageType]:
        """Collect a message that is filled in place."""
        plan = lay_out(message_type, fields)
        buffer = bytearray(plan.size)
        message = plan.write(memoryview(buffer))
        yield message
        message.forget_arrays()
        self.publish(message_type.decode(bytes(buffer)), topic)

    def wake_after_freed(self, messages: int) -> None:
        """Do nothing: there is always room."""

    def envelope(self) -> Envelope:
        """What came with the message being handled.

        Raises:
            LookupError: no message is being handled.
        """
        if self._current is None:
            raise LookupError("there is an envelope only while a message is being handled")
        return self._current
