"""What a module author subclasses."""

import logging
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robbie_mp.checkpoint.keeper import Checkpoints
from robbie_mp.messages import Message
from robbie_mp.module.bus import Bus, EncodedMessage, Envelope, MessageType
from robbie_mp.module.clock import Clock
from robbie_mp.module.config import Config
from robbie_mp.module.settings import apply_settings, setting
from robbie_mp.transport.records import MessageHandling

if TYPE_CHECKING:
    from robbie_mp.messages.descriptions import TypeDescription

__all__ = ["MessageHandling", "Module", "ModuleContext", "setting"]


@dataclass(frozen=True)
class ModuleContext:
    """Everything a module gets from the robot it is part of."""

    name: str
    settings: dict[str, object]
    bus: Bus
    clock: Clock
    config: Config
    checkpoints: Checkpoints
    output_directory: Path
    show_status: Callable[[str], None]
    show_states: Callable[[str], None] = lambda _line: None
    run_id: str = ""
    """The run it is part of; '' in a test."""


class Module:
    """Thin glue between messages and a device or worker.

    A passive module is woken by the messages it subscribes to; an active one also every `period_s`, when
    `tick()` runs. Everything a module does happens in one thread, one thing after the other, and may take
    its time: only this module waits. An exception that leaves a handler ends the process; the supervisor
    starts it again.

        class Obstacles(Module):
            stop_distance_m: float = setting(0.4, "obstacles nearer than this stop the robot")

            def setup(self) -> None:
                self.subscribe(LaserScan, self.on_scan, MessageHandling.KEEP_ONLY_NEWEST)

            def on_scan(self, scan: LaserScan) -> None:
                if scan.ranges.min() < self.stop_distance_m:
                    self.publish(DriveCommand())
    """

    period_s: float | None = None
    """Time between ticks; None for a passive module."""
    patience_s: float = 0.0
    """How long messages may wait until this module takes them, many at once.

    Who records or sums up saves itself, and everybody else, being woken for each message. On an ordered stop
    what was published before is still handled. In lockstep every message is taken at once.
    """
    nice = 0
    """How far its process steps back behind the others, 0 to 19, unless the profile says otherwise.

    With more than 0 it may compute for long, and nobody who wakes up waits for it. When the processors are
    busy it gets a small share of them: about a tenth of another one's with 10.
    """
    follows_run_clock = True
    """Whether `clock` and ticks go by the run's time when a log plays or a simulation runs.

    What serves people or disks, and not the robot, goes by the machine's.
    """

    def __init__(self, context: ModuleContext):
        self.name = context.name
        self.clock = context.clock
        self.config = context.config
        self.output_directory = context.output_directory
        self.restored: Any = context.checkpoints.restored
        """What was given to `checkpoint` last, its arrays as copies to keep; None for a fresh start."""
        self.log = logging.getLogger(context.name)
        self.stop_requested = False
        self._bus = context.bus
        self._checkpoints = context.checkpoints
        self.run_id = context.run_id
        self._show_status = context.show_status
        self._status = ""
        self._show_states = context.show_states
        self._states: dict[str, str] = {}
        apply_settings(self, context.settings)

    # -- for authors to define -------------------------------------------------------------------------

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check what the types of settings cannot say, before any process starts.

        Raises:
            SettingError: something is wrong with them.
        """

    @classmethod
    def further_types(
        cls, settings: dict[str, object], others: Collection[str]
    ) -> "Iterable[TypeDescription]":
        """Describe message types that it publishes and that no class declares, for who attaches to the run.

        Called after `check`, with the same settings. Types that have a class are known without this.

        Args:
            settings: complete and checked.
            others: names of the profile's other modules.

        Raises:
            SettingError: it could not publish them.
        """
        return ()

    def setup(self) -> None:
        """Open devices, make workers, subscribe. Runs once in each process, before any message comes.

        What is published here may come before others have subscribed; publish from the first tick on.
        """

    def tick(self) -> None:
        """Do what is to be done every `period_s`."""

    def setting_changed(self, name: str) -> None:
        """Take a changed setting into use; its attribute has the new value, checked like a profile's.

        Settings that are declared with `changeable=True` may be changed while the module runs, with `robbie
        param set`. This is called between two messages or ticks. Who reads the attribute each time it is
        needed has nothing to do here.

        Args:
            name: the setting.

        Raises:
            SettingError: it cannot be used; the attribute gets its old value back, and who asked is told.
        """

    def teardown(self) -> None:
        """Write results, close devices. Runs on an ordered stop, not after a crash."""

    # -- for authors to use ----------------------------------------------------------------------------

    def subscribe(
        self,
        message_type: type[MessageType],
        handler: Callable[[MessageType], None],
        handling: MessageHandling = MessageHandling.ALWAYS_DELIVER,
        *,
        topic: str = "",
    ) -> None:
        """Have messages of a type handled.

        Args:
            message_type: the class of the messages.
            handler: called with each one, in the order they were published.
            handling: what to do when they come faster than they are handled.
            topic: only those of this topic; '' for all.
        """
        self._bus.subscriptions.subscribe(message_type, handler, handling, topic)

    def subscribe_encoded(
        self, type_pattern: str, handler: Callable[[EncodedMessage], None], *, topic: str = "*"
    ) -> None:
        """Have messages handled as their bytes, whatever their types: to record them, or to send them on.

            self.subscribe_encoded("sensor_msgs/msg/*", self.on_message)

        Patterns are shell patterns (`*`, `?`, `[…]`; case matters) for the whole name. They are looked at
        once for each new pair of type and topic, so many cost no more than one, and the first message of a
        new pair is not missed. A message that several patterns of this module match comes once,
        to the handler of the pattern that was subscribed to first. Messages of any version come, and all of
        them, up to the limits of this module's queue.

        Args:
            type_pattern: for the full name of the type, such as "sensor_msgs/msg/LaserScan".
            handler: called with each message, in the order they were published.
            topic: pattern for the topic; "" means messages without a topic only.

        Raises:
            SubscribedTwice: to the same patterns.
            EmptyPattern: the one for the type is empty.
            TooManyDeclarations: a module may have 32 patterns.
            NameTooLong: a pattern has more than 96 bytes.
        """
        self._bus.subscriptions.subscribe_encoded(type_pattern, handler, topic)

    def publish_encoded(
        self, type_name: str, version: int, data: bytes | bytearray | memoryview, *, topic: str = ""
    ) -> bool:
        """Send a message given as its bytes, such as one from a log; its type need not have a class here.

        Nothing but the encapsulation is checked: fields that are damaged come to light in who decodes them.

        Args:
            type_name: full name of its type.
            version: of its type.
            data: its encoding (XCDR1, little endian), the 4 bytes of encapsulation included; it is copied.
            topic: the topic to publish on.

        Returns:
            False if it was refused, as for `publish`.

        Raises:
            DecodeError: the bytes are no encoding of a message.
            DeclarationError, VersionError: a type cannot have this name or version.
            MessageTooLarge, PublishAfterStop: as for `publish`.
        """
        return self._bus.publish_encoded(type_name, version, data, topic)

    def publish(self, message: Message, *, topic: str = "") -> bool:
        """Send a message to everyone who wants it.

        Returns:
            False if it was refused here, because memory or ring are full. (The core may refuse it later, when
            its tables are full.) Both are counted and shown.

        Raises:
            FieldError: a field has the wrong type or shape.
            MessageTooLarge: it can never fit into this module's memory.
            PublishAfterStop: the module has been stopped.
        """
        return self._bus.publish(message, topic)

    def loan(
        self, message_type: type[MessageType], *, topic: str = "", **fields: object
    ) -> AbstractContextManager[MessageType]:
        """Write a message in place, without any copy; it is published at the end of the `with` block.

        Give every field its value; an array that is to be filled in place gets its number of elements:

            with self.loan(Image, height=480, width=640, encoding="mono8", step=640, data=480 * 640) as image:
                camera.read_into(image.data)

        An exception inside the block takes the message back.

        An array that is still referred to at the end of the block costs a copy of the message, and a warning.

        Raises:
            MessageTooLarge, PublishAfterStop, FieldError: as for `publish`.
        """
        return self._bus.loan(message_type, topic, fields)

    def checkpoint(self, state: object) -> bool:
        """Keep state outside this process: should it die, the next one finds the state in `restored`.

        Each checkpoint takes the place of the last one, once it is complete. What happens after the last
        checkpoint and before a crash is forgotten: messages handled in that time do not come again. A
        checkpoint copies every array once, so its cost grows with the state.

        Args:
            state: None, bool, int, float, str, bytes, numpy arrays and numbers, in lists, tuples and dicts.

        Returns:
            False if there is no memory for it; the last one stays, and a warning is logged.

        Raises:
            UnsupportedState: there is something else in the state.
            CheckpointTooLarge: it is larger than the profile's `memory.checkpoint_bytes`.
        """
        return self._checkpoints.save(state)

    @property
    def envelope(self) -> Envelope:
        """Topic, sender, sequence and time of the message being handled."""
        return self._bus.envelope()

    @property
    def outstanding(self) -> int:
        """Messages of this module that somebody still waits for or holds: a measure to pace oneself by."""
        return self._bus.outstanding

    def wake_after_freed(self, messages: int) -> None:
        """Have `tick()` run as soon as so many outstanding messages have been let go."""
        self._bus.wake_after_freed(messages)

    @property
    def status(self) -> str:
        """One line that says how the module is doing, shown by `robbie top`; at most 256 bytes."""
        return self._status

    @status.setter
    def status(self, line: str) -> None:
        if line != self._status:
            self._status = line
            self._show_status(line)

    def show_state(self, state: object, machine: str = "") -> None:
        """Say in which state a state machine of this module is; `robbie top` shows it beside the status.

        Args:
            state: such as "DRIVE", or a member of an Enum, whose name is shown.
            machine: which one, if the module has several.
        """
        name = state.name if isinstance(state, Enum) else str(state)
        if self._states.get(machine) != name:
            self._states[machine] = name
            self._show_states(
                ", ".join(f"{key}: {value}" if key else value for key, value in self._states.items())
            )

    def stop(self) -> None:
        """End this module in good order, after the handler or tick that calls this."""
        self.stop_requested = True
