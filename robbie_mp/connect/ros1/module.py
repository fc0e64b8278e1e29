"""The bridge to ROS 1: robot and ROS nodes hear each other, and neither needs the other."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from robbie_mp.attached.profiler import system_profile
from robbie_mp.bus.checkpoint.errors import CheckpointTooLarge
from robbie_mp.bus.observe import RunReading, rates_between
from robbie_mp.bus.observe.run_observer import RunObserver
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.bus.transport.endpoint import TooManyDeclarations
from robbie_mp.connect.bridge.arrivals import AgeLog, GoalGate, hand_over
from robbie_mp.connect.bridge.diagnostics import DIAGNOSTICS, Diagnosis, TraceLines
from robbie_mp.connect.bridge.foreign import ForeignTypeRefused, RecordersDoNotLearn, learn_foreign
from robbie_mp.connect.bridge.frames import ForeignFrame, FrameMap
from robbie_mp.connect.bridge.mapping import BridgeMap, Incoming, MappingError, Quality
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.connect.ros1.conversion import ConversionError, Ros1Type, ros1_type
from robbie_mp.connect.ros1.foreign_types import DefinitionError, ForeignType, foreign_type
from robbie_mp.connect.ros1.log_lines import LOG, ros1_log
from robbie_mp.connect.ros1.markers import MARKER_ARRAY, MARKERS, ShownPlaces, can_be_markers
from robbie_mp.connect.ros1.process import AnnouncedType, RosAddress, RosProcess, TopicWish
from robbie_mp.connect.ros1.ros_node import ANY, MAX_ANNOUNCED
from robbie_mp.messages import Message, MessageError, TFMessage, TransformStamped, UnknownType
from robbie_mp.messages.descriptions import KnownTypes, own_types
from robbie_mp.messages.frames import Rename
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.module import Module, setting
from robbie_mp.module.settings import SettingError
from robbie_mp.scene.urdf import urdf_text
from robbie_mp.scene.warn_once import WarnOnce

CLASS_PATH = "robbie_mp.connect.ros1.module:Ros1Bridge"
ROBOT_DESCRIPTION = "/robot_description"
MAX_FRAMES = 4096
ANY_TYPE = Ros1Type(ANY, ANY, "", Message)
"""Stands for the types of a topic in ROS that the robot does not know yet."""
ROSOUT, DIAGNOSTICS_TOPIC = "/rosout", "/diagnostics"
FAR = "their publisher is far away or slow, or does not answer; docs/ros1.md says what it must do"
REPORT_NS = 1_000_000_000
"""Time between two reports of the state of all modules."""


class _Channel:
    """Messages of one type and topic that leave the robot."""

    def __init__(self, number: int, kind: Ros1Type, quality: Quality, rename: Rename):
        self.number = number
        self.rename = rename
        self.kind = kind
        self.quality = quality
        self.sequence = 0
        self.transforms: dict[str, TransformStamped] = {}
        self.places: ShownPlaces | None = None


class Ros1Bridge(Module):
    """Exchanges messages with ROS 1 nodes; see docs/ros1.md.

        ros1:
          class: robbie_mp.connect.ros1.module:Ros1Bridge
          settings:
            send:
              LaserScan: /scan
              OccupancyGrid map: /map latched
            accept:
              /cmd_vel: Twist as DriveCommand manual
              /gas: nose_msgs/* gas

    The ROS node is a process of its own, run by the Python that has rospy. A ROS master that is dead or
    starts again, and ROS nodes that are slow, cost the robot nothing.
    """

    period_s = 0.05
    handler_deadline_s = 1.2
    follows_run_clock = False

    master: str = setting("http://127.0.0.1:11311", "URI of the ROS master")
    ip: str = setting(
        "127.0.0.1", "address at which ROS nodes reach the bridge; others than 127.0.0.1 are open"
    )
    node: str = setting("robbie", "the bridge's name in ROS")
    python: Path = setting(Path("/usr/bin/python3"), "the Python that has rospy")
    namespace: str = setting("", "comes before names in ROS that do not begin with a slash")
    send: dict[str, str] = setting({}, "what ROS gets: a type, or a type and a topic, and the name in ROS")
    accept: dict[str, str] = setting({}, "what ROS may publish: its name, its type, and the robot's topic")
    frames: dict[str, str] = setting({}, "names of the robot's frames in ROS; `*` stands for all others")
    robot_description: Path | None = setting(
        None, "URDF of the robot, which becomes a parameter of ROS", must_exist=True
    )
    rosout: bool = setting(True, "send what modules log on /rosout")
    diagnostics: bool = setting(True, "send the state of all modules on /diagnostics, once a second")
    command_valid_s: float = setting(
        0.3, "how long a velocity from ROS is followed", minimum=0.01, maximum=MAX_VALID_FOR_S
    )
    max_waiting_bytes: int = setting(64 << 20, "size of the messages that may wait for ROS", minimum=1)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check what is sent and accepted."""
        try:
            given: Any = settings
            types = KnownTypes(own_types())
            _mapping(given["send"], given["accept"], given["namespace"], types)
        except MappingError as error:
            raise SettingError(str(error), "send") from error
        try:
            FrameMap(given["frames"])
        except MappingError as error:
            raise SettingError(str(error), "frames") from error
        if not str(settings["node"]).isidentifier():
            raise SettingError(f"a ROS node cannot be called {settings['node']!r}", "node")

    def setup(self) -> None:
        """Start the ROS node, and subscribe."""
        self.surroundings = BridgeRun.of(self.run_id, self.name, CLASS_PATH)
        self.map = _mapping(self.send, self.accept, self.namespace, self.surroundings.types)
        self.warnings = WarnOnce(self.log)
        self._ages = AgeLog(self.log, FAR)
        self._gate = GoalGate(self, self.map.incoming)
        self.sent = self.unheard = self.accepted = self.refused = 0
        self._channels: dict[tuple[str, int, str], _Channel | None] = {}
        self._incoming: dict[int, tuple[Incoming, Ros1Type]] = {}
        self._foreign: dict[int, ForeignType | None] = {}
        self._frames = FrameMap(self.frames)
        address = RosAddress(self.master, self.ip, self.node, self.python)
        self.ros = RosProcess(address, self.max_waiting_bytes, self.log, self.tick_soon)
        if self.robot_description is not None:
            self.ros.set_parameters({ROBOT_DESCRIPTION: urdf_text(self.robot_description)})
        for one in self.map.incoming:
            kind = ANY_TYPE if one.is_foreign else ros1_type(self.surroundings.types.get(one.type_name))
            number = self._next_number()
            self._incoming[number] = one, kind
            self.ros.subscribe_to(number, TopicWish(one.name, kind, not one.lets_move, one.quality.depth))
        for out in self.map.outgoing:
            self.subscribe_encoded(out.pair.type, self.on_message, topic=out.pair.topic)
        self._observe()
        self._show_again()
        self.ros.look_after()

    def _show_again(self) -> None:
        """Show the places that an earlier process of this module has shown: nobody may say them again."""
        for *key, places in self.restored or ():
            type_name, version, topic = key
            channel = self._channels[type_name, version, topic] = self._open(type_name, version, topic)
            if channel is not None and channel.places is not None:
                channel.places.restore(places)
                self.ros.send(channel.number, channel.kind.to_ros1(channel.places.markers()), keep=True)

    def _remember_places(self) -> None:
        """Keep all places for the next process of this module."""
        shown = [(key, one.places) for key, one in self._channels.items() if one is not None]
        try:
            self.checkpoint([[*key, places.state()] for key, places in shown if places is not None])
        except CheckpointTooLarge as error:
            self.warnings.say("places are lost if this module dies", error)

    def _observe(self) -> None:
        """Begin to watch the run, for /rosout and /diagnostics."""
        self._trace: TraceLines | None = None
        self._observer: RunObserver | None = None
        self._before: RunReading | None = None
        self._reported_at_ns = 0
        if self.rosout and self.surroundings.output is not None:
            self._trace = TraceLines(self.surroundings.output)
            self._lines = self._own(LOG, ROSOUT, depth=1000)
        if self.diagnostics and self.run_id:
            self._observer = RunObserver(self.run_id)
            self._diagnosis = Diagnosis(self.node, self.run_id)
            self._reports = self._own(DIAGNOSTICS, DIAGNOSTICS_TOPIC, depth=10)

    def _own(self, message_type: type[Message], name: str, depth: int) -> _Channel:
        """Return a channel of the bridge's own messages."""
        rename = self._frames.outward(message_type)
        channel = _Channel(self._next_number(), ros1_type(message_type), Quality(depth=depth), rename)
        self._channels[message_type.type_name, 0, name] = channel
        self.ros.publish_on(channel.number, TopicWish(name, channel.kind, False, depth))
        return channel

    def teardown(self) -> None:
        """End the ROS node."""
        self.ros.close()
        if self._observer is not None:
            self._observer.close()
        self.log.info("%s", self._counts())

    # -- from the robot to ROS ---------------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Send a message of this robot to ROS; what came from ROS goes nowhere."""
        envelope = self.envelope
        if envelope.sender in self.surroundings.bridges:
            return
        key = (message.type_name, message.version, envelope.topic)
        if key not in self._channels:
            self._channels[key] = self._open(*key)
        channel = self._channels[key]
        if channel is None:
            self.refused += 1
            return
        keep = channel.quality.is_latched
        if not (keep or self.ros.listeners.get(channel.number)):
            self.unheard += 1
            return
        try:
            fitted = _as_ros1_keeps_it(channel, channel.rename(message.data))
            if fitted is None:
                return
            data = channel.kind.to_ros1(fitted, channel.sequence)
        except (ConversionError, MessageError) as error:
            self.refused += 1
            self.warnings.ignore(f"{message.type_name} {envelope.topic} of {envelope.sender}", error)
            return
        channel.sequence = (channel.sequence + 1) & 0xFFFFFFFF
        self.sent += 1
        self.ros.send(channel.number, data, keep=keep)
        if channel.places is not None:
            self._remember_places()

    def _open(self, type_name: str, version: int, topic: str) -> _Channel | None:
        """Return the channel for a type and topic; None if they cannot be sent."""
        what = f"{type_name} {topic}".rstrip()
        found = self.map.sent_as(type_name, topic)
        if found is None:
            self.warnings.say(f"{what} is not sent", "its name in ROS belongs to another type")
            return None
        try:
            message_type = self.surroundings.types.get(type_name)
        except (UnknownType, MessageError) as error:
            self.warnings.say(f"{what} is not sent", error)
            return None
        if message_type.version != version:
            self.warnings.say(f"{what} is not sent", f"version {version} is not {message_type.version}")
            return None
        if found.becomes == MARKERS and not can_be_markers(message_type):
            self.warnings.say(f"{what} is not sent", "it has no places that could be markers")
            return None
        rename = self._frames.outward(message_type)
        if found.becomes == MARKERS:  # each message has all markers, so that who comes later sees all
            quality = replace(found.quality, is_latched=True)
            channel = _Channel(self._next_number(), ros1_type(MARKER_ARRAY), quality, rename)
            channel.places = ShownPlaces(message_type)
        else:
            channel = _Channel(self._next_number(), ros1_type(message_type), found.quality, rename)
        wish = TopicWish(found.name, channel.kind, channel.quality.is_latched, channel.quality.depth)
        self.ros.publish_on(channel.number, wish)
        return channel

    def _next_number(self) -> int:
        return len(self._channels) + len(self._incoming) + 1

    # -- from ROS to the robot ---------------------------------------------------------------------------

    def tick(self) -> None:
        """Look after the ROS node, and publish what has come from it."""
        self.ros.look_after()
        for number, data, waited_s in self.ros.received():
            if self._arrive(number, data, waited_s):
                self.accepted += 1
            else:
                self.refused += 1
        self._report()
        state = "connected" if self.ros.is_connected else "no ROS master"
        self.status = f"{state}; {self._counts()}"

    def _report(self) -> None:
        """Send ROS what modules have logged, and how they are."""
        now_ns = self.clock.monotonic_ns()
        if now_ns - self._reported_at_ns < REPORT_NS:
            return
        self._reported_at_ns = now_ns
        if self._trace is not None:
            for line in self._trace.read_new():
                self._send_own(self._lines, ros1_log(line))
        if self._observer is not None:
            before, self._before = self._before, self._observer.read()
            if before is not None:
                profile = system_profile(self._before, rates_between(before, self._before))
                self._send_own(self._reports, self._diagnosis.of(profile))

    def _send_own(self, channel: _Channel, message: Message) -> None:
        if self.ros.listeners.get(channel.number):
            self.ros.send(channel.number, channel.kind.to_ros1(message.encode()), keep=False)

    def _arrive(self, number: int, data: bytes, waited_s: float) -> bool:
        announced = self.ros.announced.get(number)
        if announced is None:
            incoming, kind = self._incoming[number]
            if incoming.is_foreign:
                reason = (
                    f"ROS has sent messages of more than {MAX_ANNOUNCED} types on topics without a fixed type"
                )
                self.warnings.say(f"a message on {incoming.name} is refused", reason)
                return False
            return self._take(incoming, kind, data, waited_s)
        incoming, _ = self._incoming[announced.channel]
        if number not in self._foreign:
            self._foreign[number] = self._learn(incoming, announced)
        found = self._foreign[number]
        return found is not None and self._take(incoming, found, data, waited_s)

    def _learn(self, incoming: Incoming, announced: AnnouncedType) -> ForeignType | None:
        """Return a type that ROS has announced; None if the robot does not take its messages."""
        learnt = [one.description for one in self._foreign.values() if one is not None]
        try:
            made = foreign_type(announced.type_name, announced.md5, announced.definition)
            learn_foreign(self.surroundings, incoming, made.description, learnt)
        except RecordersDoNotLearn as error:
            self.warnings.say(f"{made.description.name} on {incoming.name}", error)
        except (DefinitionError, ForeignTypeRefused) as error:
            self.warnings.say(f"{announced.type_name:.200} on {incoming.name} is refused", error)
            return None
        self.log.info("%s on %s is a type of ROS that the robot has learnt", made.kind.name, incoming.name)
        return made

    def _take(self, incoming: Incoming, kind: Ros1Type | ForeignType, data: bytes, waited_s: float) -> bool:
        message_type: type[Message] = kind.message_type
        try:
            encoded: bytes | memoryview = kind.from_ros1(data)
            if not incoming.drives:  # a velocity moves the robot, whatever frame its sender names
                encoded = self._frames.inward(message_type)(encoded)
            if not self.ill_formed.admits(message_type.decode(encoded), f"on {incoming.name}"):
                return False
            if incoming.lets_move:
                self._ages.note(incoming, waited_s, self.command_valid_s)
            if self._gate.refuses(incoming):
                return False
            return hand_over(self, incoming, message_type, encoded, self.command_valid_s, waited_s)
        except (ConversionError, ForeignFrame, MessageError, MessageTooLarge, TooManyDeclarations) as error:
            self.warnings.say(f"a message on {incoming.name} is refused", error)
            return False

    def _counts(self) -> str:
        return (
            f"sent {self.sent}, without subscriber {self.unheard}, accepted {self.accepted}, "
            f"refused {self.refused}, dropped {self.ros.dropped}"
        )


def _mapping(
    send: Mapping[str, str], accept: Mapping[str, str], namespace: str, types: KnownTypes
) -> BridgeMap:
    return BridgeMap(send, accept, namespace, types, (MARKERS,), takes_foreign=True)


def _as_ros1_keeps_it(channel: _Channel, data: bytes | memoryview) -> bytes | memoryview | None:
    """Return transforms that fit ROS 1, or places as markers; other messages as they are; None: nothing.

    ROS keeps only the last message of a latched topic, so that must have all fixed transforms so far. And it
    warns of every moving transform whose time it knows already, and ignores it.
    """
    if channel.places is not None:
        channel.places.add(bytes(data))
        return channel.places.markers()
    if channel.kind.message_type is not TFMessage:
        return data
    known = channel.transforms
    given = TFMessage.decode(bytes(data)).transforms
    is_fixed = channel.quality.is_latched
    new = [one for one in given if is_fixed or not _has_time(known.get(one.child_frame_id), one)]
    for one in new:
        if one.child_frame_id in known or len(known) < MAX_FRAMES:
            known[one.child_frame_id] = one
    sent = list(known.values()) if is_fixed else new
    return TFMessage(transforms=sent).encode() if sent or not given else None


def _has_time(known: TransformStamped | None, one: TransformStamped) -> bool:
    return known is not None and known.header.stamp == one.header.stamp
