"""Shows a run in Foxglove, live, and takes messages, settings and the emergency stop from there."""

import json
import math
import secrets
from collections import Counter, deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robbie_mp.base.errors import RobbieError
from robbie_mp.base.linux.priority import MAX_SLICE_MS
from robbie_mp.base.linux.private_files import make_private_folder
from robbie_mp.bus.observe.run_observer import RunObserver
from robbie_mp.bus.transport.endpoint import TooManyDeclarations
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.connect.bridge.arrivals import GoalGate, hand_over
from robbie_mp.connect.bridge.diagnostics import MAX_LINES, TraceLines
from robbie_mp.connect.bridge.driving import drive_command
from robbie_mp.connect.bridge.foreign import (
    MAX_FOREIGN,
    ForeignTypeRefused,
    RecordersDoNotLearn,
    learn_foreign,
)
from robbie_mp.connect.bridge.frames import FrameMap
from robbie_mp.connect.bridge.mapping import BridgeMap, Incoming, MappingError
from robbie_mp.connect.bridge.orders import RELEASE_WITHIN_S
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.connect.foxglove.door import ClientDoor, Passage
from robbie_mp.connect.foxglove.server import (
    CDR,
    JSON,
    ROS2MSG,
    Arrived,
    ClientChannel,
    ClientServer,
    FoxgloveMissing,
    FromClient,
    ParameterWish,
    ServerOptions,
    ServiceCall,
)
from robbie_mp.connect.link.keys import default_folder
from robbie_mp.logs.capture.selection import TypeAndTopic, type_pattern
from robbie_mp.logs.recording.topic_names import ros_topic, snake_case
from robbie_mp.messages import (
    DriveCommand,
    EmergencyStop,
    Header,
    IllFormed,
    Log,
    Message,
    MessageError,
    NavigateTo,
    SettingChange,
    SettingChanged,
    String,
    Time,
    Twist,
    TwistStamped,
    check_well_formed,
)
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.frames import Rename, renamed
from robbie_mp.messages.plain import from_dict
from robbie_mp.messages.registry import full_name
from robbie_mp.messages.schema import schema_text
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.listening import check_listening
from robbie_mp.module.module import MessageHandling, Module, setting
from robbie_mp.module.secret import Secret, reveal
from robbie_mp.module.setting_changes import SettingsFile
from robbie_mp.module.settings import SettingError
from robbie_mp.run.operator_link import (
    FOXGLOVE_LINK_FILE,
    FOXGLOVE_TOKEN_FILE,
    remove_link,
    token_of_run,
    write_link,
)
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.profile.show import inline
from robbie_mp.run.run_clock import RunClock
from robbie_mp.run.run_directory import list_runs

CLASS_PATH = "robbie_mp.connect.foxglove.module:FoxgloveServer"
LOOK_NS = 500_000_000
"""Time between two looks at the run's channels and settings, and between two updates of the status."""
GRAPH_NS = 2_000_000_000
"""Time between two looks at who publishes and subscribes to what."""
MAX_CHANNELS = 200
MAX_WISHES = 64
NULL = "null"
"""How clients see and send a setting without a value: parameters always have one."""
ROSOUT = "/rosout"
TOKEN_FILE = "foxglove.token"
STOP_TOPIC = "emergency_stop"
STOP_OR_RELEASE, STOP = "/emergency_stop", "/emergency_stop/engage"
SERVICES = {STOP_OR_RELEASE: True, STOP: False}
"""Services for clients, and whether their request has a bool."""
LARGE = ["Image", "CompressedImage", "PointCloud2", "OccupancyGrid"]


class ShownChannel:
    """A channel of the run that clients can read.

    Args:
        name: type, version and topic in the run.
        channel: the same at the server.
        rename: renames the frames in its messages.
        pass_on: gets each message that arrives.

    Attributes:
        is_subscribed: whether the module gets its messages.
        is_latched: whether later readers get the newest message, which is kept for them.
        newest: that message; None until there is one.
    """

    def __init__(
        self,
        name: ChannelName,
        channel: Any,
        rename: Rename,
        pass_on: "Callable[[ShownChannel, EncodedMessage], None]",
    ):
        self.name = name
        self.rename = rename
        self.channel = channel
        self.is_subscribed = False
        self.is_latched = False
        self.newest: tuple[bytes, int] | None = None
        self._pass_on = pass_on

    def on_message(self, message: EncodedMessage) -> None:
        """Handle a message of the channel."""
        self._pass_on(self, message)


class FoxgloveServer(Module):
    """Serves all topics to Foxglove, as they are; see docs/foxglove.md.

        foxglove:
          class: robbie_mp.connect.foxglove.module:FoxgloveServer
          settings:
            accept:
              /initialpose: PoseStamped initial_pose
              /cmd_vel: Twist as DriveCommand manual

    `robbie foxglove` prints the address to open in Foxglove.
    """

    period_s = 0.05
    slice_ms = MAX_SLICE_MS
    """Its images never make other modules wait, and the emergency stop from a client is as fast as ever."""
    follows_run_clock = False

    host: str = setting("127.0.0.1", "address to listen on; 0.0.0.0: all addresses of this machine")
    port: int = setting(8765, "port to listen on; 0: any free port", minimum=0, maximum=65535)
    token: Secret | None = setting(None, "what clients must know; null: a new one for each run")
    keep_token: bool = setting(
        False, "without `token`: keep it in ~/.config/robbie, so that a link outlives the run"
    )
    send: dict[str, str] = setting(
        {"*": "{topic}"}, "what clients may read: a type, or a type and a topic, and its name for them"
    )
    accept: dict[str, str] = setting(
        {}, "what clients may publish: their topic, and the type and topic that it becomes"
    )
    frames: dict[str, str] = setting({}, "names of the robot's frames for clients; `*` stands for all others")
    drive_valid_for_s: float = setting(
        0.4,
        "how long a velocity of a client drives the robot unless another follows",
        minimum=0.01,
        maximum=MAX_VALID_FOR_S,
    )
    newest: list[str] = setting(LARGE, "types of which only the newest message counts for a slow reader")
    change_settings: bool = setting(True, "whether clients may change the settings that can be changed")
    emergency_stop: bool = setting(True, "whether clients get services for the emergency stop")
    assets: dict[str, Path] = setting(
        {}, "folders that clients may read, as package://NAME/…, such as the robot's model"
    )
    max_clients: int = setting(8, "most clients at a time", minimum=1)
    queue_messages: int = setting(
        32, "messages that wait for a client; then the oldest is dropped", minimum=8
    )
    max_message_bytes: int = setting(1 << 20, "size of the largest message that a client may send", minimum=1)

    @classmethod
    def check(cls, settings: dict[str, Any]) -> None:
        """Check the token and what is sent and accepted."""
        check_listening(settings["host"], "token", token=settings["token"])
        try:
            BridgeMap(settings["send"], {})
        except MappingError as error:
            raise SettingError(str(error), "send") from error
        try:
            FrameMap(settings["frames"])
        except MappingError as error:
            raise SettingError(str(error), "frames") from error

    # -- begin and end ---------------------------------------------------------------------------------

    def setup(self) -> None:
        """Open the server and the door before it."""
        around = BridgeRun.of(self.run_id, self.name, CLASS_PATH)
        try:
            self._map = BridgeMap(
                self.send, self.accept, types=around.types, takes_foreign=True, name_of=ros_topic
            )
        except MappingError as error:
            raise SettingError(str(error), "accept") from error
        self._surroundings = around
        self._types: KnownTypes = around.types
        self._begin_reports()
        self._foreign: dict[ClientChannel, type[Message] | str] = {}
        self._frames = FrameMap(self.frames)
        self._accepted = {one.name: one for one in self._map.incoming}
        self._gate = GoalGate(self, self._map.incoming)
        self._newest_only = [TypeAndTopic(type_pattern(one), "*") for one in self.newest]
        self._shown: dict[ChannelName, ShownChannel] = {}
        self._by_id: dict[int, ShownChannel] = {}
        self._readers: dict[int, set[int]] = {}
        self._offered: Counter[int] = Counter()
        self._wishes: dict[int, None] = {}
        self._unknown: set[ChannelName] = set()
        self._look_at_ns = 0
        self._is_open = False
        self.refused: Counter[str] = Counter()
        self._is_too_slow = False
        self._dropped: dict[int, int] = {}
        self._dropped_before = 0
        self.strangers = 0
        self._observer: RunObserver | None = None
        self._run_clock: RunClock | None = None
        self._files: dict[str, SettingsFile] = {}
        self._folder: Path | None = None
        if self.run_id:
            self._meet_run()
        else:
            self.subscribe_encoded("*", self._on_unannounced)
        if self.emergency_stop:
            self.advertise(EmergencyStop, topic=STOP_TOPIC)
        for one in [one for one in self._map.incoming if not one.is_foreign]:
            if one.becomes is not NavigateTo:
                self.advertise(one.becomes or self._types.get(one.type_name), topic=one.topic)
        if self.change_settings:
            self.subscribe(SettingChanged, self._on_setting_changed, optional=True)
        try:
            self._open()
        except FoxgloveMissing as missing:
            self.status = str(missing)
            self.log.error("%s", missing)
            self.stop()

    def _begin_reports(self) -> None:
        """Prepare what clients are told besides messages: losses, the run's time, its log and its graph."""
        self._told_dropped: dict[int, int] = {}
        self._bytes: Counter[str] = Counter()
        self._jumps = 0
        self._is_cleared = False
        self._graph_at_ns = 0
        self._lines: deque[Log] = deque(maxlen=MAX_LINES)
        self._trace = None if self._surroundings.output is None else TraceLines(self._surroundings.output)

    def _meet_run(self) -> None:
        run = next(run for run in list_runs() if run.run_id == self.run_id)
        self._folder = run.folder
        self._observer = RunObserver(self.run_id)
        self._run_clock = RunClock.attach(self.run_id)
        names = [module.name for module in RunPlan.load(run.folder).modules]
        self._files = {name: SettingsFile(run.folder, name) for name in names}

    def _open(self) -> None:
        key = reveal(self.token)
        if not key and self.keep_token:
            folder = default_folder().parent
            make_private_folder(folder)
            key = token_of_run(folder, TOKEN_FILE)
        if not key and self._folder is not None:
            key = token_of_run(self._folder, FOXGLOVE_TOKEN_FILE)
        key = key or secrets.token_urlsafe(32)
        self._greeting_topic = f"/{secrets.token_urlsafe(24)}/"
        drives = any(one.lets_move for one in self._map.incoming)
        self.door = ClientDoor(
            self.host, self.port, key, self._greeting_topic, self.max_clients, pings=drives
        )
        try:
            self._serve_clients()
        except BaseException:
            self.door.close()
            raise
        self._is_open = True
        self.door.open(self.server.port)
        host = f"[{self.host}]" if ":" in self.host else self.host
        self.address = f"ws://{host}:{self.door.port}/"
        self.link = f"{self.address}?token={key}"
        if self._folder is not None:
            write_link(self._folder, self.link, FOXGLOVE_LINK_FILE)
        self.log.info("Foxglove: %s; `robbie foxglove` shows the link with the token", self.address)

    def _serve_clients(self) -> None:
        """Start the server, with the channel of what the run logs."""
        self.server = self._start_server()
        if self._trace is not None:
            self._rosout = self.server.open_channel(ROSOUT, Log.type_name, schema_text(Log))

    def _start_server(self) -> ClientServer:
        services = SERVICES if self.emergency_stop else {}
        name = f"Robbie-MP {self.run_id}".strip()
        options = ServerOptions(
            name,
            self._greeting_topic,
            self.queue_messages,
            self.max_message_bytes,
            services,
            self.assets,
            foreign_topics={
                form for one in self._map.incoming if one.is_foreign for form in _forms(one.name)
            },
            tells_time=self._surroundings.has_own_clock,
        )
        return ClientServer(options, self.tick_soon, self.clock.monotonic_ns, self._age_s)

    def _age_s(self, client: int) -> float:
        """Return how old what comes now from a client can be at most; the SDK's threads call this."""
        passage = self.door.passages.get(client)
        return math.inf if passage is None else passage.greatest_age_s

    def teardown(self) -> None:
        """Disconnect all clients."""
        if self._is_open:
            self.door.close()
            self.server.close()
            self.log.info("%s", self._summary())
        if self._folder is not None:
            remove_link(self._folder, FOXGLOVE_LINK_FILE)
        if self._observer is not None and self._run_clock is not None:
            self._observer.close()
            self._run_clock.close()

    # -- from this robot to the clients ------------------------------------------------------------------

    def tick(self) -> None:
        """Look at what clients want and have sent, and at what the run has."""
        if not self._is_open:
            return
        if self.server.is_breached:
            self._start_again()
        new_readers = self.server.take_new_readers()
        self._readers = self.server.readers()  # after the new ones, of whom it must know
        for number in new_readers:
            if number in self._by_id:
                self._begin(self._by_id[number])
        while (arrived := self.server.take()) is not None:
            self._on_arrived(arrived)
        self._tell_time()
        self._send_trace()
        now_ns = self.clock.monotonic_ns()
        if now_ns - self._look_at_ns >= LOOK_NS or not self._look_at_ns:
            self._look_at_ns = now_ns
            self._look()

    def _tell_time(self) -> None:
        """Tell clients a time that is not theirs; after a jump, which clears their views, what is latched."""
        clock = self._run_clock
        if clock is None or not self._surroundings.has_own_clock or not clock.has_begun:
            return
        jumps = clock.jumps
        self.server.tell_time(clock.now_ns())
        if self._is_cleared:  # a tick later, because times overtake messages
            for shown in self._shown.values():
                if shown.newest is not None:
                    self._log(shown, shown.newest[0], clock.now_ns())
        self._is_cleared, self._jumps = jumps != self._jumps, jumps

    def _send_trace(self) -> None:
        if self._trace is None or not (readers := self._readers.get(self._rosout.id())):
            return
        self._lines.extend(self._trace.read_new())
        for _ in range(min(len(self._lines), self.queue_messages // 4)):  # so that the SDK drops none
            line = self._lines.popleft()
            self._offered.update(readers)
            self._rosout.log(line.encode(), log_time=line.stamp.nanoseconds)

    def _show_graph(self, observer: RunObserver) -> None:
        """Show clients which modules publish and subscribe to what."""
        self._graph_at_ns = self.clock.monotonic_ns()
        shown = {one.name: one.channel.topic() for one in self._shown.values()}
        published: dict[str, set[str]] = {}
        for channel in observer.channels():
            topic = shown.get(ChannelName(channel.type_name, channel.version, channel.topic))
            if topic is not None:
                published.setdefault(topic, set()).update(channel.publishers)
        subscribed: dict[str, set[str]] = {}
        for module in observer.modules():
            for one in module.subscriptions:
                for name, topic in shown.items():
                    is_this = (one.type_name, one.version) == name[:2] and one.topic in ("", name.topic)
                    if is_this and one.is_open and not one.is_latch:
                        subscribed.setdefault(topic, set()).add(module.name)
        self.server.show_graph(published, subscribed)

    def _look(self) -> None:
        if self._observer is not None:
            latched = set(self._observer.latched())
            for figures in self._observer.channels():
                name = ChannelName(figures.type_name, figures.version, figures.topic)
                shown = self._show(name)
                if shown is not None:
                    shown.is_latched = name in latched
                    if not shown.is_latched:
                        shown.newest = None
            is_due = self.clock.monotonic_ns() - self._graph_at_ns >= GRAPH_NS
            if self.door.passages and is_due:
                self._show_graph(self._observer)
        self._look_at_settings()
        self._count_dropped()
        self.status = self._summary()

    def _show(self, name: ChannelName) -> ShownChannel | None:
        """Return a channel as clients see it; None if they do not."""
        shown = self._shown.get(name)
        if shown is not None or name in self._unknown:
            return shown
        text = self._name_for_clients(name)
        schema = self._schema(name)
        if text is None or schema is None or len(self._shown) >= MAX_CHANNELS:
            if len(self._unknown) < MAX_CHANNELS:
                self._unknown.add(name)
                if text is not None:
                    self.log.warning("%s on '%s' is not shown in Foxglove", name.type_name, name.topic)
            return None
        try:
            rename: Rename = (
                self._frames.outward(self._types.get(name.type_name, name.version)) if self.frames else bytes
            )
        except MessageError as error:
            self._unknown.add(name)
            self.log.warning("%s on '%s' is not shown in Foxglove: %s", name.type_name, name.topic, error)
            return None
        channel = self.server.open_channel(text, name.type_name, schema)
        shown = ShownChannel(name, channel, rename, self._on_message)
        self._shown[name] = self._by_id[shown.channel.id()] = shown
        return shown

    def _name_for_clients(self, name: ChannelName) -> str | None:
        """Return what clients call a channel. If its name belongs to another type, the type's follows."""
        sent = self._map.sent_as(name.type_name, name.topic)
        if sent is not None:
            return sent.name
        if not any(one.pair.matches(name.type_name, name.topic) for one in self._map.outgoing):
            return None
        return f"/{ros_topic(name.type_name, name.topic)}/{snake_case(name.type_name)}"

    def _schema(self, name: ChannelName) -> str | None:
        found = self._types.schema(name.type_name, name.version)
        if found is None:
            around = BridgeRun.of(self.run_id, self.name, CLASS_PATH)
            self._types = around.types  # the run may have learnt it
            found = self._types.schema(name.type_name, name.version)
        return found

    def _begin(self, shown: ShownChannel) -> None:
        """Begin to receive a channel when its first reader comes; later ones get what is latched."""
        if shown.is_subscribed:
            if shown.newest is not None:
                self._log(shown, *shown.newest)
            return
        name = shown.name
        is_newest_only = any(pair.matches(name.type_name, name.topic) for pair in self._newest_only)
        handling = MessageHandling.KEEP_ONLY_NEWEST if is_newest_only else MessageHandling.ALWAYS_DELIVER
        try:
            self.subscribe_encoded(
                name.type_name,
                shown.on_message,
                topic=name.topic,
                version=name.version,
                handling=handling,
            )
        except TooManyDeclarations as error:
            self.log.warning("%s", error)
        shown.is_subscribed = True

    def _on_message(self, shown: ShownChannel, message: EncodedMessage) -> None:
        if self.envelope.topic != shown.name.topic:
            return  # a subscription without a topic gets all topics
        if shown.channel.id() in self._readers or shown.is_latched:
            at_ns = self._log_time_ns()
            try:
                data = bytes(shown.rename(message.data))
            except MessageError as error:
                self._refuse(f"{message.type_name} of {self.envelope.sender}: {error}")
                return
            # The next look drops it unless the topic is latched, which it may be since the last one.
            shown.newest = data, at_ns
            self._log(shown, data, at_ns)

    def _on_unannounced(self, message: EncodedMessage) -> None:
        """Handle any message: in a test there is no run whose channels could be looked up."""
        shown = self._show(ChannelName(message.type_name, message.version, self.envelope.topic))
        if shown is not None:
            shown.is_subscribed = True
            self._on_message(shown, message)

    def _log(self, shown: ShownChannel, data: bytes, at_ns: int) -> None:
        readers = self._readers.get(shown.channel.id())
        if readers and not self.server.is_breached:
            self._offered.update(readers)
            self._bytes[shown.channel.topic()] += len(data)
            shown.channel.log(data, log_time=at_ns)

    def _log_time_ns(self) -> int:
        """Return when the message was published, in the run's time."""
        if self._run_clock is not None and self._run_clock.has_begun:
            return self._run_clock.now_ns()
        return self.clock.now_ns() - self.clock.monotonic_ns() + self.envelope.published_ns

    def _start_again(self) -> None:
        """Start another server: somebody on this machine came in behind the door."""
        self.strangers += 1
        self.log.warning("a client without the token found the inner port; all clients are disconnected")
        self.server.close()
        self._greeting_topic = f"/{secrets.token_urlsafe(24)}/"
        self._serve_clients()
        self.door.move(self.server.port, self._greeting_topic)
        self._by_id.clear()
        self._readers = {}
        for name, shown in self._shown.items():
            text, schema = shown.channel.topic(), self._schema(name)
            assert schema is not None
            shown.channel = self.server.open_channel(text, name.type_name, schema)
            self._by_id[shown.channel.id()] = shown

    # -- from clients to this robot ----------------------------------------------------------------------

    def _on_arrived(self, arrived: Arrived) -> None:
        if isinstance(arrived, FromClient):
            self._publish(arrived)
        elif isinstance(arrived, ParameterWish):
            self._change(arrived)
        else:
            self._serve(arrived)

    def _publish(self, arrived: FromClient) -> None:
        """Publish a message of a client, if it is accepted and is what it says."""
        channel = arrived.channel
        name = channel.topic if channel.topic.startswith("/") else f"/{channel.topic}"
        type_name = full_name(channel.type_name)
        accepted = self._accepted.get(name)
        if accepted is None or not accepted.matches(type_name):
            self._refuse(f"{type_name:.200} on {name:.200}: `accept` does not allow it")
            return
        try:
            message = self._decode(accepted, arrived)
            check_well_formed(message)
            if not accepted.drives:
                message = renamed(message, self._frames.name_here)
        except IllFormed as error:
            self.ill_formed.count(error, f"on {name:.200}")
            self._refuse(f"{type_name:.200} on {name:.200}: {error}")
            return
        except (RobbieError, ValueError) as error:
            self._refuse(f"{type_name:.200} on {name:.200}: {error}")
            return
        if accepted.drives:
            assert isinstance(message, Twist | TwistStamped)
            command = self._drive(name, message, arrived)
            if command is None:
                return
            message = command
        if accepted.is_foreign:
            self.publish_encoded(message.type_name, message.version, message.encode(), topic=accepted.topic)
        elif accepted.becomes is not None and not accepted.drives:
            waited_s = arrived.age_s + max(0, self.clock.monotonic_ns() - arrived.arrived_ns) / 1e9
            data = message.encode()
            if problem := self._gate.refuses(accepted):
                self.refused[f"goals on {accepted.name}, while the robot does not drive by itself"] += 1
                self.server.show_problem(f"refused a goal on {accepted.name}: {problem}")  # each time
            elif not hand_over(self, accepted, type(message), data, self.drive_valid_for_s, waited_s):
                self._refuse(f"{type_name:.200} on {name:.200}: it is too old, or the robot has no room")
        else:
            self.publish(message, topic=accepted.topic)

    def _drive(self, name: str, velocity: Twist | TwistStamped, arrived: FromClient) -> DriveCommand | None:
        """Return the command that a velocity stands for; None if it is too old, which its sender is told."""
        waited_s = arrived.age_s + max(0, self.clock.monotonic_ns() - arrived.arrived_ns) / 1e9
        command = drive_command(velocity, self._now(), self.drive_valid_for_s, waited_s)
        was_too_slow, self._is_too_slow = self._is_too_slow, command is None
        if command is None:
            limit = f"older than {self.drive_valid_for_s:g} s"
            what = f"velocities on {name:.200}: they are not finite, or may be {limit} when they arrive"
            self.refused[what] += 1
            if not was_too_slow:
                delay = f"{waited_s:.1f} s" if math.isfinite(waited_s) else "not known yet"
                self.log.warning("refused %s; the delay of the network is %s", what, delay)
                self.server.show_problem(f"refused {what}; the delay of the network is {delay}")
        return command

    def _decode(self, accepted: Incoming, arrived: FromClient) -> Message:
        if accepted.is_foreign:
            message_type = self._foreign_type(accepted, arrived.channel)
        else:
            message_type = self._types.get(accepted.type_name)
        if arrived.channel.encoding == CDR:
            return message_type.decode(arrived.data)
        if arrived.channel.encoding == JSON:
            fields = json.loads(arrived.data)
            if isinstance(fields, dict):
                return from_dict(message_type, fields)
        raise ValueError(f"expected a message in {CDR} or {JSON}")

    def _foreign_type(self, accepted: Incoming, channel: ClientChannel) -> type[Message]:
        """Return a type that a client has described; its first message makes it known in the run.

        Raises:
            ForeignTypeRefused: it is not taken.
        """
        if channel not in self._foreign:
            if len(self._foreign) >= MAX_FOREIGN:
                raise ForeignTypeRefused(f"clients have described {MAX_FOREIGN} types, which is the limit")
            try:
                self._foreign[channel] = self._learn(accepted, channel)
            except (RobbieError, SyntaxError, ValueError, RecursionError, MemoryError) as error:
                self._foreign[channel] = str(error)
        made = self._foreign[channel]
        if isinstance(made, str):
            raise ForeignTypeRefused(made)
        return made

    def _learn(self, accepted: Incoming, channel: ClientChannel) -> type[Message]:
        if channel.schema_encoding != ROS2MSG or channel.schema is None:
            raise ForeignTypeRefused(
                f"the robot does not know it, and learns types only from a schema in {ROS2MSG}; the client "
                f"sends {f'one in {channel.schema_encoding:.40}' if channel.schema_encoding else 'none'}"
            )
        made = message_type_from_schema(full_name(channel.type_name), channel.schema.decode())
        described = TypeDescription(made.type_name, made.version, schema_text(made))
        learnt = [
            TypeDescription(one.type_name, one.version, schema_text(one))
            for one in self._foreign.values()
            if not isinstance(one, str)
        ]
        try:
            learn_foreign(self._surroundings, accepted, described, learnt)
        except RecordersDoNotLearn as error:
            self.log.warning("%s: %s", made.type_name, error)
        self.log.info("%s on %s is a type that a client has described", made.type_name, accepted.name)
        return made

    def _refuse(self, what: str) -> None:
        key = what if what in self.refused or len(self.refused) < MAX_CHANNELS else "others"
        self.refused[key] += 1
        if self.refused[key] == 1:
            self.log.warning("refused %s", what)
            self.server.show_problem(f"refused {what}")

    def _change(self, wish: ParameterWish) -> None:
        module, _, name = wish.name.partition(".")
        entry = self._files[module].read_changeable().get(name) if module in self._files else None
        if entry is None or not self.change_settings:
            self._refuse(f"a value for {wish.name}: clients cannot change it")
            return
        request = secrets.randbits(63)
        self._wishes[request] = None
        while len(self._wishes) > MAX_WISHES:
            del self._wishes[next(iter(self._wishes))]
        value = NULL if wish.value == NULL else inline(wish.value)
        change = SettingChange(request=request, setting=name, value=value)
        self.publish(change, topic=module)

    def _on_setting_changed(self, answer: SettingChanged) -> None:
        self._look_at_settings()
        if answer.request in self._wishes:
            del self._wishes[answer.request]
            if answer.error:
                self.server.show_problem(f"{answer.module} refuses: {answer.error}")

    def _look_at_settings(self) -> None:
        values: dict[str, Any] = {}
        for module, file in self._files.items():
            for name, entry in file.read().items():
                values[f"{module}.{name}"] = _plain(entry["value"])
        self.server.show_parameters(values)

    def _serve(self, call: ServiceCall) -> None:
        """Press or release the emergency stop; a late release is refused."""
        engaged = call.name == STOP or call.data[4:5] == b"\x01"
        if call.name == STOP_OR_RELEASE and len(call.data) < 5:
            self._refuse(f"a call of {call.name}: the request is too short")
            return
        waited_s = (self.clock.monotonic_ns() - call.arrived_ns) / 1e9
        is_late = not engaged and waited_s > RELEASE_WITHIN_S
        header = Header(stamp=self._now())
        is_sent = not is_late and self.publish(
            EmergencyStop(header=header, engaged=engaged, reason="Foxglove"), topic=STOP_TOPIC
        )
        text = "sent; emergency_stop_state says what the base does" if is_sent else "refused: no memory"
        if is_late:
            text = (
                f"refused: the order to release has waited {waited_s:.1f} s, which is too long; send it again"
            )
        encoded = String(data=text).encode()
        # The bool before the text stands where CDR puts it: at the beginning, then three bytes of padding.
        call.answer(encoded[:4] + bytes([is_sent, 0, 0, 0]) + encoded[4:])

    def _now(self) -> Time:
        if self._run_clock is not None and self._run_clock.has_begun:
            return Time.from_nanoseconds(self._run_clock.now_ns())
        return self.now()

    # -- figures -----------------------------------------------------------------------------------------

    def _count_dropped(self) -> None:
        """Count what the clients were too slow for, and forget those that have gone."""
        passages = self.door.passages
        for number in list(self._offered):
            passage = passages.get(number)
            if passage is None:
                self._dropped_before += self._dropped.pop(number, 0)
                self._told_dropped.pop(number, None)
                del self._offered[number]
            else:
                missing = self._offered[number] - passage.messages - self.queue_messages
                self._dropped[number] = max(0, missing, self._dropped.get(number, 0))
                self._tell_slow(number, passage)

    def _tell_slow(self, number: int, passage: Passage) -> None:
        """Tell a client that it loses messages: the 1st, the 10th, the 100th …, as apps keep each text."""
        dropped = self._dropped[number]
        if dropped < self._told_dropped.get(number, 1):
            return
        self._told_dropped[number] = 10 ** len(str(dropped))
        largest = ", ".join(topic for topic, _ in self._bytes.most_common(2))
        passage.notice = (
            f"this connection is too slow: at least {dropped} messages have not been sent to you; most bytes "
            f"are those of {largest}"
        )

    @property
    def dropped(self) -> int:
        """Messages that clients were too slow for, at least: those that wait are not counted."""
        return self._dropped_before + sum(self._dropped.values())

    def _summary(self) -> str:
        server, door = self.server, self.door
        counts = {
            "dropped for slow clients": self.dropped,
            "refused": self.refused.total() + server.overflowed + server.oversized,
            "turned away": door.refused,
            "strangers": self.strangers,
        }
        said = [f"{count} {what}" for what, count in counts.items() if count]
        return ", ".join([self.address, f"{len(door.passages)} clients", *said])


def _forms(name: str) -> tuple[str, str]:
    """Return a topic as clients may write it."""
    return name, name.removeprefix("/")


def _plain(value: object) -> object:
    """Return a value of a setting as Foxglove can show it."""
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if value is None:
        return NULL
    return value if isinstance(value, bool | int | float | str) else str(value)
