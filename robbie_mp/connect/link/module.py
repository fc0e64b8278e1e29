"""The link: sends messages of this robot to others over a network, and publishes theirs here."""

import hashlib
import math
import secrets
from collections import deque
from collections.abc import Iterator, Mapping
from fnmatch import fnmatchcase
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robbie_mp.attached.views.image_pixels import JPEG_ENCODINGS, NoPicture, jpeg, pixels_of
from robbie_mp.base.linux.freed_memory import keep_freed_memory
from robbie_mp.bus.observe.run_observer import RunObserver
from robbie_mp.bus.transport import names
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.bus.transport.endpoint import NameTooLong, TooManyDeclarations
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.connect.link.access import AccessError, LinkAccess, read_rules
from robbie_mp.connect.link.counts import ExchangeCounts, LinkCounts
from robbie_mp.connect.link.described_types import TYPES_TOPIC, LinkedTypes
from robbie_mp.connect.link.frames import prefixed
from robbie_mp.connect.link.header import ROBOT_NAME, VERSION, ChannelId, ReceivedPacket
from robbie_mp.connect.link.keys import Keys, KeysError
from robbie_mp.connect.link.node import LinkNode, NodeSettings, Offered
from robbie_mp.connect.link.operators import (
    MANUAL_TOPIC,
    ORDERS,
    REQUEST_TOPIC,
    STATE_TOPIC,
    LinkOperators,
    driver_text,
    read_commanding,
)
from robbie_mp.connect.link.peer import Peer
from robbie_mp.connect.link.receiving import Arrived, Fate
from robbie_mp.connect.link.safety import EXPIRING, Ages, expires, shortened
from robbie_mp.connect.link.sending import SendLimits
from robbie_mp.connect.link.tools import EXPIRES_S, LinkTools
from robbie_mp.connect.link.traffic import TrafficClass
from robbie_mp.connect.link.wire import Endpoints, InboxLimits, Wire, only_own_names
from robbie_mp.logs.capture.selection import TypeAndTopic
from robbie_mp.messages import (
    CompressedImage,
    ControlState,
    DriveCommand,
    EmergencyStop,
    Image,
    LinkChannel,
    LinkPeer,
    LinkRefusal,
    LinkState,
    LinkTypes,
    Message,
    MessageError,
    OperatorRequest,
    OperatorState,
    SetControl,
    ToolReply,
    ToolRequest,
    UnknownType,
)
from robbie_mp.messages.descriptions import KnownTypes, TypeDescription
from robbie_mp.messages.frames import has_frames
from robbie_mp.messages.stock.registry import class_with_rules
from robbie_mp.module.envelope import EncodedMessage, Envelope
from robbie_mp.module.module import Module, setting
from robbie_mp.module.settings import REQUIRED, SettingError
from robbie_mp.run.plan import RunPlan
from robbie_mp.run.run_directory import list_runs

CLASS_PATH = "robbie_mp.connect.link.module:Link"
STATE_NS = 1_000_000_000
MAX_PATTERNS = 32
KEPT_BYTES = 16 << 20
"""Memory of packets that is used again; the kernel takes longer to give it out than the link to fill it."""
MAX_REMEMBERED = 4096
MAX_ORDERS = 8
"""Of operators; of more that come between two ticks, the newest count."""
NS = 1e-9


_FOR_LINK = (OperatorRequest.type_name, LinkTypes.type_name, ToolRequest.type_name)
MAX_TOOL_REQUESTS = 16
"""Requests to run commands that wait until the next tick; more are refused."""
TOOL_REPLY_TOPIC = "tool_reply"


class LinkOutgoing(NamedTuple):
    """How the messages of one channel of this robot are sent."""

    name: ChannelId
    traffic: TrafficClass
    is_latched: bool
    type_hash: int
    may_be_jpeg: bool


class ToolCall(NamedTuple):
    """A request of another robot's side to run a command here, as `LinkTools.take` takes it."""

    client: str
    tool: str
    request: ToolRequest
    refusal: str


class LinkIncoming(NamedTuple):
    """What becomes of the messages of one channel of another robot."""

    topic: str
    """On which they are published."""
    is_for_link: bool
    """Whether they are for the link alone: requests of operators and tools, and descriptions of types."""
    tells_driver: bool
    """Whether they tell who drives that robot."""
    commands: bool
    """Whether they are obeyed only from the operator who has control."""
    framed: type[Message] | None
    """Their type, if the names of their frames get a prefix."""


class Link(Module):
    """Exchanges messages with the links of other robots; see docs/link.md.

        link:
          class: robbie_mp.connect.link.module:Link
          settings:
            robot: red
            listen: [tcp/127.0.0.1:7447]
            send:
              state: [Odometry odom]
              reliable: [OccupancyGrid map]
            accept:
              laptop: [DriveCommand manual, EmergencyStop emergency_stop]

    It publishes `LinkState` once a second. The link of a robot that accepts commands publishes
    `OperatorState`, which says who may drive, and follows `OperatorRequest`.
    """

    period_s = 0.01
    follows_run_clock = False
    plays = False
    """Whether the run has a time of its own, as when a log is played: it commands no other robot."""
    withheld = 0
    """Messages that were not sent for that reason."""
    _log_source: str | None = None
    """The module from which the run has that time."""

    robot: str = setting(REQUIRED, "the name of this robot, which no other robot has")
    mode: str = setting("peer", "how links find one another", choices=("peer", "client"))
    listen: list[str] = setting(
        ["tcp/127.0.0.1:7447"], "addresses to listen on; others than 127.0.0.1 are open"
    )
    connect: list[str] = setting([], "addresses of other robots, or of a router of Zenoh")
    robots: list[str] = setting([], "robots for which messages wait even before they have been met")
    others: list[str] = setting(["*"], "robots to exchange messages with, as shell patterns of their names")
    multicast: bool = setting(False, "look for other robots by multicast")
    datagrams: bool = setting(True, "also use UDP at the same ports, for what must not wait behind the rest")
    keys: Path | None = setting(
        None, "folder of the keys of `robbie keys`; then only trusted robots connect, over TLS"
    )
    send: dict[str, list[str]] = setting({}, "what is sent, by class: a type, or a type and a topic")
    accept: dict[str, list[str]] = setting({}, "what is accepted, by robot: a type, or a type and a topic")
    commanding: list[str] = setting(
        ["DriveCommand", "JointCommand", "PanTiltCommand", "PoseStamped goal", "ToolRequest call"],
        "what is obeyed only from the operator who has control: a type, or a type and a topic",
    )
    jpeg_quality: int = setting(
        0, "of images in the class bulk, which are sent as JPEG; 0: as they are", minimum=0, maximum=95
    )
    prefix_topics: bool = setting(
        False, "publish what comes from robot `red` on topics `red/…`, and send what is on these only there"
    )
    prefix_frames: bool = setting(
        False, "put `red/` before the names of frames in what comes from robot `red`; needs `prefix_topics`"
    )
    command_expires_s: float = setting(0.3, "age at which a command is dropped", minimum=0.01)
    state_hz: float = setting(20.0, "most states of a channel in a second", minimum=0.01)
    store_messages: int = setting(1000, "messages that may wait, of each robot and class", minimum=1)
    store_bytes: int = setting(64 << 20, "their total size", minimum=1)
    max_message_bytes: int = setting(64 << 20, "size of the largest message that is accepted", minimum=1)
    inbox_packets: int = setting(4096, "packets that may wait until this module takes them", minimum=16)
    inbox_bytes: int = setting(64 << 20, "their total size", minimum=4 << 20)

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the robot's name, and the patterns."""
        robots = settings["robots"]
        assert isinstance(robots, list)
        for setting_name, robot in [("robot", settings["robot"]), *(("robots", one) for one in robots)]:
            if not ROBOT_NAME.fullmatch(str(robot)):
                raise SettingError(
                    f"a robot cannot be called {robot!r}: up to 32 letters, digits, - and _", setting_name
                )
        others = settings["others"]
        assert isinstance(others, list)
        left_out = [one for one in robots if not any(fnmatchcase(str(one), other) for other in others)]
        if left_out:
            raise SettingError(f"{left_out[0]!r} is in `robots`, but `others` leaves it out", "others")
        if settings["prefix_frames"] and not settings["prefix_topics"]:
            raise SettingError("frames get a prefix only if topics do: set `prefix_topics`", "prefix_frames")
        _check_encryption(settings)
        for name in ("send", "accept"):
            try:
                _rules(settings[name])
            except AccessError as error:
                raise SettingError(str(error), name) from error
        commanding = settings["commanding"]
        assert isinstance(commanding, list)
        try:
            read_commanding(commanding)
        except AccessError as error:
            raise SettingError(str(error), "commanding") from error
        if settings["jpeg_quality"] and find_spec("PIL") is None:
            raise SettingError("JPEG needs Pillow: pip install pillow", "jpeg_quality")
        sent = _rules(settings["send"])
        unknown = [one for one, _ in sent if one.upper() not in TrafficClass.__members__ or not one.islower()]
        if unknown:
            classes = ", ".join(one.name.lower() for one in TrafficClass)
            raise SettingError(f"there is no class {unknown[0]!r}; the classes are {classes}", "send")
        if sum(len(pairs) for _, pairs in sent) > MAX_PATTERNS:
            raise SettingError(f"there are more than {MAX_PATTERNS} patterns; use wider ones", "send")

    # -- begin and end ---------------------------------------------------------------------------------

    def setup(self) -> None:
        """Open the network and the counts, and subscribe."""
        session = secrets.randbits(63) | 1
        keep_freed_memory(KEPT_BYTES)
        self.access = LinkAccess(self.accept, self.log)
        self.rules = [
            (pair, TrafficClass[name.upper()]) for name, pairs in _rules(self.send) for pair in pairs
        ]
        self._commanding = read_commanding(self.commanding)
        # An older state may name an operator from whom another one has taken over.
        self.operators = LinkOperators(self.robot, None if self.checkpoint_lost else self.restored)
        self._orders: deque[tuple[SetControl, int]] = deque(maxlen=MAX_ORDERS)
        """Orders of operators, and when each arrived."""
        self._tool_requests: deque[ToolCall] = deque()
        self._tools = LinkTools(self.robot, self.run_id, LinkClients(self))
        self._asked: set[str] = set()
        """Robots that tools on this machine have asked to run commands."""
        self._drivers: dict[str, str] = {}
        """The operators who have control of other robots, as far as those have said."""
        self.late = 0
        self.mismatched = 0
        self._outgoing: dict[tuple[str, int, str], LinkOutgoing] = {}
        """How the messages of a type, version and topic are sent."""
        self._hashes: dict[tuple[str, int], int] = {}
        self._incoming: dict[tuple[str, ChannelId, int], LinkIncoming] = {}
        """What becomes of the messages that may come in, by robot, channel and hash of the type."""
        self._latched: set[ChannelId] = set()
        self._state_at_ns = 0
        self._observer: RunObserver | None = None
        self._links = {self.name}
        folder, at_once = None, False
        self._types = LinkedTypes([], None, self.log)
        if self.run_id:
            run_folder = next(run.folder for run in list_runs() if run.run_id == self.run_id)
            plan = RunPlan.load(run_folder)
            at_once, self.plays = not plan.clock.lockstep, plan.clock.source is not None
            self._log_source = plan.clock.source
            own_types = (TypeDescription(*one) for one in plan.types)
            self._types = LinkedTypes(own_types, run_folder, self.log)
            own = {one.class_path for one in plan.modules if one.name == self.name} | {CLASS_PATH}
            self._links |= {one.name for one in plan.modules if one.class_path in own}
            folder = SHARED_MEMORY / names.folder(self.run_id)
            self._observer = RunObserver(self.run_id)
        self.counts = LinkCounts(folder, self.name, session)
        endpoints = Endpoints(
            self.mode, self.listen, self.connect, self.multicast, self.datagrams, self._tls()
        )
        inbox = InboxLimits(self.inbox_packets, self.inbox_bytes)
        self.wire = Wire(self.robot, session, endpoints, inbox, self.tick_soon)
        limits = SendLimits(self.store_messages, self.store_bytes, round(1e9 / self.state_hz))
        settings = NodeSettings(limits, self.max_message_bytes, self.store_bytes, self._may_exchange)
        self.node = LinkNode(self.robot, session, self.counts, settings, self.wire, self.on_arrived)
        self._meet_robots()
        self._take_part()
        # Not where this module must do nothing between its ticks: in lockstep and in tests.
        self._begins_at_once = at_once

    def _take_part(self) -> None:
        """Say what this link publishes, and subscribe."""
        self.advertise(LinkState)
        # A side that sends drive commands is an operator's; the robots at its other ends decide who drives.
        self._is_operators = any(
            traffic is TrafficClass.COMMAND and fnmatchcase(DriveCommand.type_name, pair.type)
            for pair, traffic in self.rules
        )
        self.operators.is_news = not self._is_operators and self.access.may_send(None, DriveCommand.type_name)
        self.subscribe(OperatorRequest, self.on_request, topic=REQUEST_TOPIC, optional=True)
        self.advertise(OperatorState, topic=STATE_TOPIC)
        self.subscribe(ToolRequest, self.on_tool_request, optional=True)
        self.advertise(ToolReply, topic=TOOL_REPLY_TOPIC)
        for pair, _ in self.rules:
            self.subscribe_encoded(pair.type, self.on_message, topic=pair.topic)

    def _meet_robots(self) -> None:
        """Let messages wait for others, and first of all the types that they may not know."""
        for robot in self.robots:
            self.node.meet(robot)
        described = self._types.describe(self.robot, [pair.type for pair, _ in self.rules])
        if described.types:
            self._offer(described, TYPES_TOPIC, TrafficClass.RELIABLE, is_latched=True)

    def _may_exchange(self, robot: str) -> bool:
        """Whether this link exchanges messages with a robot, as far as `others` says."""
        return any(fnmatchcase(robot, pattern) for pattern in self.others)

    def _tls(self) -> dict[str, object]:
        """Return the settings of Zenoh with which only trusted robots connect, under their own names."""
        if self.keys is None:
            return {}
        try:
            own, settings = Keys(self.keys).own(), Keys(self.keys).zenoh_settings()
        except KeysError as error:
            raise SettingError(str(error), "keys") from error
        if own.robot != self.robot:
            raise SettingError(f"the keys in {self.keys} are of {own.robot}, not of {self.robot}", "keys")
        if self.mode != "peer":  # what a router sends on has the router's certificate
            return settings
        return settings | only_own_names(self.robot, [one.robot for one in Keys(self.keys).trusted()])

    def teardown(self) -> None:
        """Close the network and the counts."""
        self._tools.close()
        self.wire.take_at_once(None)
        self.wire.close()
        for account in self.counts.channels():
            self.log.info("%s", describe(account))
        self.counts.close()
        if self._observer is not None:
            self._observer.close()

    # -- from this robot to others -----------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Send a message of this robot; what another link has published goes nowhere."""
        envelope = self.envelope
        if envelope.sender not in self._links:
            with self.wire.turns:
                self._send(message, envelope)
        if self.wire.something_waits:
            with self.wire.turns:
                self._take_all()

    def _send(self, message: EncodedMessage, envelope: Envelope) -> None:
        key = (message.type_name, message.version, envelope.topic)
        outgoing = self._outgoing.get(key) or self._classify(ChannelId(*key))
        name, traffic, is_latched, type_hash, may_be_jpeg = outgoing
        if self.plays and self._is_of_the_past(name, traffic, envelope.sender):
            self.withheld += 1
            return
        data = bytes(message.data)
        offered = Offered(name, traffic, data, envelope.published_ns, is_latched, type_hash)
        if may_be_jpeg:
            offered = self._as_jpeg(offered)
        robot = name.topic.partition("/")[0]
        if self.prefix_topics and robot in self.node.peers and robot != name.topic:
            self.node.offer_to(robot, offered, self.clock.monotonic_ns())
        else:
            self.node.offer(offered, self.clock.monotonic_ns())

    def _is_of_the_past(self, name: ChannelId, traffic: TrafficClass, sender: str) -> bool:
        """Whether a message must not reach other robots from here, because a log may have published it.

        A stop by hand does reach them. A stop, a release or the state of a base in a log does not.
        """
        if name.type_name == EmergencyStop.type_name:
            return sender == self._log_source
        return traffic is TrafficClass.COMMAND or name.type_name == OperatorRequest.type_name

    def _as_jpeg(self, offered: Offered) -> Offered:
        """Return an image as it is sent: as JPEG, if nothing but sharpness is lost."""
        try:
            image = Image.decode(offered.data)
            is_picture = image.encoding in JPEG_ENCODINGS and pixels_of(image).size > 0
        except (MessageError, NoPicture):
            return offered
        if not is_picture:
            return offered
        name = ChannelId(CompressedImage.type_name, CompressedImage.version, offered.name.topic)
        type_hash = self._hash(name.type_name, name.version)
        return offered._replace(name=name, type_hash=type_hash, convert=self._jpeg)

    def _jpeg(self, data: bytes) -> bytes:
        image = Image.decode(data)
        picture = np.frombuffer(jpeg(image, self.jpeg_quality), np.uint8)
        return CompressedImage(header=image.header, format="jpeg", data=picture).encode()

    def _classify(self, name: ChannelId) -> LinkOutgoing:
        """Find out how the messages of a channel are sent."""
        self._find_latched()
        traffic = next(one for pair, one in self.rules if pair.matches(name.type_name, name.topic))
        is_latched = name in self._latched
        if is_latched and traffic in (TrafficClass.COMMAND, TrafficClass.STATE):
            traffic = TrafficClass.RELIABLE
        if name.type_name in EXPIRING:  # never stored, nor sent from a log that is played
            traffic, is_latched = TrafficClass.COMMAND, False
        type_hash = self._hash(name.type_name, name.version)
        may_be_jpeg = (
            self.jpeg_quality > 0 and traffic is TrafficClass.BULK and name.type_name == Image.type_name
        )
        if len(self._outgoing) >= MAX_REMEMBERED:
            self._outgoing.clear()
        found = self._outgoing[name] = LinkOutgoing(name, traffic, is_latched, type_hash, may_be_jpeg)
        return found

    def _find_latched(self) -> None:
        """Find the channels whose newest message the core keeps."""
        if self._observer is None:
            return
        latched = {ChannelId(one.type_name, one.version, one.topic) for one in self._observer.latched()}
        if latched != self._latched:
            self._latched = latched
            self._outgoing.clear()

    def _hash(self, type_name: str, version: int) -> int:
        """Return a hash of a type's schema; 0 if this robot does not know that version of the type."""
        key = (type_name, version)
        known = self._hashes.get(key)
        if known is None:
            if len(self._hashes) >= MAX_REMEMBERED:
                self._hashes.clear()
            known = self._hashes[key] = schema_hash(self._types.known, type_name, version)
        return known

    # -- from others to this robot -----------------------------------------------------------------------

    def tick(self) -> None:
        """Take what has arrived, and send what is due."""
        if self._begins_at_once:  # with the first tick, because all modules have subscribed by then
            self._begins_at_once = False
            self.wire.take_at_once(self._take_one)
        with self.wire.turns:
            self._do_what_is_due()

    def _do_what_is_due(self) -> None:
        for robot in self.wire.seen():
            self.node.meet(robot)
        self._take_all()
        now_ns = self.clock.monotonic_ns()
        self.wire.look_after(now_ns)
        self.node.look_after(now_ns)
        self._look_after_operators(now_ns)
        self._give_orders()
        self._run_tools()
        if now_ns - self._state_at_ns >= STATE_NS:
            self._state_at_ns = now_ns
            self._find_latched()
            self._show(now_ns)

    def _take_one(self, one: ReceivedPacket) -> None:
        """Take a packet in a thread of Zenoh, which has the turn."""
        if self.node.take_and_tell(one):
            self.tick_soon()  # this thread must not send what may be large

    def _take_all(self) -> None:
        for one in self.wire.received():
            self.node.take(one)
        self.node.tell_all(self.clock.monotonic_ns())

    def on_arrived(self, message: Arrived) -> Fate:
        """Publish a message of another robot, unless it is late, not allowed, or of another type."""
        incoming = self._may_come_in(message)
        if incoming is None or not self._is_well_formed(message):
            why = "does not accept this from here, as the setting `accept` of its link says"
            return self._refuse(message, f"{self.robot} {why}, or has another version of Robbie-MP")
        if (data := self._in_time(message)) is None:
            return self._refuse(message, f"{self.robot} got this more than {EXPIRES_S:g} s late; try again")
        if incoming.is_for_link:
            return self._take_for_itself(message, data, incoming)
        is_wrong = incoming.tells_driver and not self._note_driver(message.robot, data)
        name = message.name
        is_by_hand = MANUAL_TOPIC in (name.topic, incoming.topic)
        if incoming.commands and name.type_name == DriveCommand.type_name and is_by_hand:
            self._see_drive(message.robot, data)
        if is_wrong or (incoming.commands and not self._is_obeyed(message.robot)):
            return Fate.REFUSED
        return self._publish_arrived(message, data, incoming)

    def _publish_arrived(self, message: Arrived, data: bytes, incoming: LinkIncoming) -> Fate:
        name = message.name
        try:
            if incoming.framed is not None:
                data = prefixed(incoming.framed.decode(data), f"{message.robot}/").encode()
            done = self.publish_encoded(
                name.type_name, name.version, data, topic=incoming.topic, latched=message.is_latched
            )
        except (MessageError, MessageTooLarge, NameTooLong, TooManyDeclarations) as error:
            self.log.warning("a message of %s cannot be published: %s", message.robot, error)
            return Fate.REFUSED
        if done:
            return Fate.PUBLISHED
        return Fate.NO_ROOM if self._may_wait(message) else Fate.REFUSED

    def _may_wait(self, message: Arrived) -> bool:
        """Whether what comes after a message may wait until there is room for it.

        A stop may come after something urgent, which therefore waits no longer than a command is valid.
        """
        if message.traffic is not TrafficClass.URGENT or message.name.type_name == EmergencyStop.type_name:
            return True
        ages = self.node.peers[message.robot].clock.age_ns(message.stamp_ns, self.clock.monotonic_ns())
        return ages is not None and ages[1] <= self.command_expires_s / NS

    def _take_for_itself(self, message: Arrived, data: bytes, incoming: LinkIncoming) -> Fate:
        if message.name.type_name == OperatorRequest.type_name:
            return self._follow_encoded(message.robot, data)
        if message.name.type_name == ToolRequest.type_name:
            if incoming.commands and not self._is_obeyed(message.robot):
                return self._refuse(message, f"{self.operators.text}; take over first")
            return self._queue_tool(message)
        is_taken = self._types.learn(
            message.robot, data, lambda type_name: self.access.may_send(message.robot, type_name)
        )
        self._hashes.clear()
        self._incoming.clear()
        return Fate.PUBLISHED if is_taken else Fate.REFUSED

    def _is_well_formed(self, message: Arrived) -> bool:
        name = message.name
        origin = f"from {message.robot} on topic '{name.topic}'"
        return self.ill_formed.admits_encoded(class_with_rules(*name[:2]), message.data, origin)

    def _may_come_in(self, message: Arrived) -> LinkIncoming | None:
        """Find out what becomes of a message; None: it may not come in."""
        key = (message.robot, message.name, message.type_hash)
        return self._incoming.get(key) or self._admit(message)

    def _admit(self, message: Arrived) -> LinkIncoming | None:
        """Find out what becomes of the messages of a channel; None: they may not come in.

        They are refused one by one, so that each is counted.
        """
        name, robot = message.name, message.robot
        needs_none = (
            name.type_name == LinkTypes.type_name
            or self._is_about_operators(message)
            or (name.type_name == ToolReply.type_name and robot in self._asked)
        )
        if not needs_none and not self.access.allows(robot, name.type_name, name.topic):
            return None
        known = self._hash(name.type_name, name.version)
        if known and message.type_hash and known != message.type_hash:
            self.mismatched += 1
            return None
        topic = self._topic_here(robot, name.topic)
        if name.type_name == OperatorRequest.type_name and REQUEST_TOPIC not in (name.topic, topic):
            return None  # it is for another robot, which its sender has not met yet
        if len(self._incoming) >= MAX_REMEMBERED:
            self._incoming.clear()
        found = self._incoming[robot, name, message.type_hash] = LinkIncoming(
            topic,
            is_for_link=name.type_name in _FOR_LINK,
            tells_driver=name.type_name == OperatorState.type_name,
            commands=any(pair.matches(name.type_name, topic) for pair in self._commanding),
            framed=self._with_frames(name) if self.prefix_frames else None,
        )
        return found

    def _topic_here(self, robot: str, topic: str) -> str:
        """Return the topic on which to publish what a robot has sent on a topic."""
        if not self.prefix_topics:
            return topic
        own = f"{self.robot}/"
        return topic.removeprefix(own) if topic.startswith(own) else f"{robot}/{topic}".rstrip("/")

    def _with_frames(self, name: ChannelId) -> type[Message] | None:
        """Return the type of a channel's messages if they have frames and this robot knows that version."""
        # The hash is 0 if the type is not known in that version.
        known = self._types.known.get(name.type_name) if self._hash(name.type_name, name.version) else None
        return known if known is not None and has_frames(known) else None

    def _in_time(self, message: Arrived) -> bytes | None:
        """Return the message as it is to be published; None if it is too late, or nobody knows."""
        is_state, may_expire = message.traffic is TrafficClass.STATE, expires(message)
        if not (is_state or may_expire):
            return message.data
        peer, now_ns = self.node.peers[message.robot], self.clock.monotonic_ns()
        ages = peer.clock.age_ns(message.stamp_ns, now_ns)
        if ages is not None and is_state:
            peer.newest_state_ns = now_ns - sum(ages) // 2
        if not may_expire:
            return message.data
        is_tool = message.name.type_name == ToolRequest.type_name
        data, max_age_ns = None, round((EXPIRES_S if is_tool else self.command_expires_s) * 1e9)
        if ages is not None and ages[1] <= max_age_ns:
            data = shortened(message, Ages(*ages), self.clock.now_ns(), max_age_ns)
        self.late += data is None
        return data

    # -- commands of `robbie` that robots run for others --------------------------------------------------

    def on_tool_request(self, request: ToolRequest) -> None:
        """Send a request of a tool on this machine to its robot, or say at once that it cannot be reached."""
        if self.envelope.sender in self._links:
            return
        with self.wire.turns:
            peer = self.node.peers.get(request.robot)
            if peer is not None and peer.is_up(self.clock.monotonic_ns()):
                self._asked.add(request.robot)
                self._offer(request, self.envelope.topic, TrafficClass.RELIABLE, to=request.robot)
                return
        if peer is None and len(self._links - {self.name}):
            return  # another link may know it
        problem = f"{request.robot} cannot be reached; the link says: {self.status or 'nothing yet'}\n"
        reply = ToolReply(
            request=request.request, robot=request.robot, error=problem, is_over=True, exit_code=1
        )
        self.publish(reply, topic=TOOL_REPLY_TOPIC)

    def _refuse(self, message: Arrived, why: str) -> Fate:
        """Refuse a message; somebody who waits for a command gets to know why."""
        if message.name.type_name == ToolRequest.type_name:
            self._queue_tool(message, why)
        return Fate.REFUSED

    def _queue_tool(self, message: Arrived, refusal: str = "") -> Fate:
        """Leave a request to the module's thread: a process dies with the thread that has started it."""
        try:
            request = ToolRequest.decode(message.data)
        except MessageError:
            return Fate.REFUSED
        if len(self._tool_requests) == MAX_TOOL_REQUESTS:
            return Fate.REFUSED
        self._tool_requests.append(ToolCall(message.robot, message.name.topic, request, refusal))
        return Fate.PUBLISHED

    def _run_tools(self) -> None:
        while self._tool_requests:
            self._tools.take(*self._tool_requests.popleft())
        self._tools.look_after()

    # -- who drives ------------------------------------------------------------------------------------

    def on_request(self, request: OperatorRequest) -> None:
        """Follow a wish of this robot's own page; that of an operator's side goes to the robot."""
        if self.envelope.sender in self._links:
            return
        if self.plays:
            self.withheld += 1
            return
        with self.wire.turns:
            # A wish is as old as its publication: this module may have been stopped while it waited.
            waited_ns = self.clock.monotonic_ns() - self.envelope.published_ns
            if self._is_operators:
                self._offer(request, REQUEST_TOPIC, TrafficClass.URGENT, waited_ns=waited_ns)
            elif waited_ns <= self.command_expires_s / NS or request.wish == OperatorRequest.HOLD:
                self._follow(self.robot, request)
            else:
                self.late += 1

    def _see_drive(self, operator: str, data: bytes) -> None:
        """Notice an operator who holds on to a control since before the link was down."""
        command, peer = DriveCommand.decode(data), self.node.peers[operator]
        moves = bool(command.linear_m_per_s or command.angular_rad_per_s)
        self.operators.see_drive(operator, peer.up_ns, *self._now(), moves=moves)

    def _is_obeyed(self, operator: str) -> bool:
        """Whether a command is from the operator who has control."""
        before = self.operators.holder
        is_obeyed = self.operators.obeys(operator, *self._now())
        if not is_obeyed or before != self.operators.holder:
            self._tell_operators()
        return is_obeyed

    def _follow_encoded(self, operator: str, data: bytes) -> Fate:
        try:
            return self._follow(operator, OperatorRequest.decode(data))
        except MessageError:
            return Fate.REFUSED

    def _follow(self, operator: str, request: OperatorRequest) -> Fate:
        if request.wish not in ORDERS:
            self.operators.request(operator, request, *self._now())
            self._tell_operators()
        elif request.wish == OperatorRequest.GO_ON and not self._is_obeyed(operator):
            return Fate.REFUSED
        else:
            order = SetControl(mode=ORDERS[request.wish], reason=f"ordered by {operator}")
            self._orders.append((order, self.clock.monotonic_ns()))
        return Fate.PUBLISHED

    def _give_orders(self) -> None:
        """Order for operators how the robot is controlled: in the module's thread, which alone may call."""
        while self._orders:
            order, arrived_ns = self._orders.popleft()
            waited_ns = self.clock.monotonic_ns() - arrived_ns
            if order.mode != ControlState.HOLD and waited_ns > self.command_expires_s / NS:
                self.late += 1  # this module stood still
                continue
            self.call(
                order,
                lambda _reply: None,
                lambda error: self.log.warning("an operator's order was not followed: %s", error),
            )

    def _is_about_operators(self, message: Arrived) -> bool:
        """Whether it says who drives, or is a request of somebody who may: these need no `accept`."""
        type_name = message.name.type_name
        if type_name == OperatorRequest.type_name:
            return self.access.may_send(message.robot, DriveCommand.type_name)
        return type_name == OperatorState.type_name

    def _note_driver(self, robot: str, data: bytes) -> bool:
        """Say who drives another robot. Return whether that robot itself has reported it."""
        try:
            state = OperatorState.decode(data)
        except MessageError:
            return False
        if state.robot != robot:
            return False
        text = driver_text(state.operator)
        if self._drivers.get(robot) != text:
            self._drivers[robot] = text
            self.log.info("%s: %s", robot, text)
        return True

    def _look_after_operators(self, now_ns: int) -> None:
        """Free the command if its holder is gone, and tell what is new."""
        peer = self.node.peers.get(self.operators.holder)
        is_heard = self.operators.holder == self.robot or (peer is not None and peer.is_up(now_ns))
        self.operators.look_after(is_heard, *self._now())
        self._tell_operators()

    def _tell_operators(self) -> None:
        """Publish and send who drives this robot, if the others must be told."""
        operators = self.operators
        is_refusing, state = operators.is_refusing, operators.news(self.clock.monotonic_ns())
        if state is None:
            return
        if is_refusing and state.refused_operator:
            self.log.warning("%s; commands of %s are refused", operators.text, state.refused_operator)
        else:
            self.log.info("%s", operators.text)
        self.checkpoint(operators.as_data())
        self.publish(state, topic=STATE_TOPIC, latched=True)
        self._offer(state, STATE_TOPIC, TrafficClass.RELIABLE, is_latched=True)

    def _offer(
        self,
        message: Message,
        topic: str,
        traffic: TrafficClass,
        *,
        is_latched: bool = False,
        waited_ns: int = 0,
        to: str = "",
    ) -> None:
        """Send a message of the link itself, or one that has waited for it, to all robots or to one."""
        name = ChannelId(message.type_name, message.version, topic)
        now_ns = self.clock.monotonic_ns()
        type_hash = self._hash(message.type_name, message.version)
        offered = Offered(name, traffic, message.encode(), now_ns - waited_ns, is_latched, type_hash)
        if to:
            self.node.offer_to(to, offered, now_ns)
        else:
            self.node.offer(offered, now_ns)

    def _now(self) -> tuple[int, int]:
        """Return the module's time, and the clock's."""
        return self.clock.monotonic_ns(), self.clock.now_ns()

    # -- figures -----------------------------------------------------------------------------------------

    def _show(self, now_ns: int) -> None:
        self.publish(self.link_state(now_ns))
        shown = [_summary(peer, now_ns) for peer in self.node.peers.values()]
        shown += [f"{robot}: {driver}" for robot, driver in self._drivers.items()]
        if self.operators.holder:
            shown.append(self.operators.text)
        if self.ill_formed.total:
            shown.append(self.ill_formed.summary)
        if self._tools.started or self._tools.refused:
            shown.append(f"{self._tools.started} commands run for others, {self._tools.refused} refused")
        if self.withheld:
            shown.append(f"{self.withheld} commands of a run with a time of its own withheld")
        self.status = "; ".join(shown) or "no other robot has been found"

    def link_state(self, now_ns: int) -> LinkState:
        """Return how this link is doing.

        Args:
            now_ns: the module's time.
        """
        node, wire = self.node, self.wire
        impossible = sum(peer.strange + peer.uncounted for peer in node.peers.values())
        return LinkState(
            stamp=self.now(),
            robot=self.robot,
            session=node.session,
            malformed=node.malformed + wire.oversized + impossible,
            strangers=node.strangers,
            overflowed=wire.overflowed,
            refused=self.access.refused_total,
            late=self.late,
            mismatched=self.mismatched,
            peers=[_peer_state(peer, now_ns) for peer in node.peers.values()],
            channels=list(_channels(self.counts)),
            ill_formed=[
                LinkRefusal(message_type=type_name, field=field, refused=count)
                for (type_name, field), count in self.ill_formed.by_kind.most_common()
            ],
        )


class LinkClients:
    """Those for whom a link runs commands."""

    def __init__(self, link: Link):
        self._link = link

    def is_up(self, robot: str) -> bool:
        """Whether one is heard."""
        return self._link.node.peers[robot].is_up(self._link.clock.monotonic_ns())

    def has_room(self, robot: str, name: ChannelId) -> bool:
        """Whether the last reply on a channel has been sent."""
        return self.is_up(robot) and not self._link.node.holds(robot, name, TrafficClass.RELIABLE)

    def reply(self, robot: str, reply: ToolReply, name: ChannelId) -> None:
        """Send a reply."""
        self._link._offer(reply, name.topic, TrafficClass.RELIABLE, to=robot)


def schema_hash(types: KnownTypes, type_name: str, version: int) -> int:
    """Return a hash of a type's schema; 0 if that version of the type is not known.

    Args:
        types: the types that this robot knows.
        type_name: full name of the type.
        version: its version.
    """
    try:
        described = types.describe(type_name)
    except UnknownType:
        return 0
    if described.version != version:
        return 0
    return int.from_bytes(hashlib.sha256(described.schema.encode()).digest()[:8], "little")


def describe(account: ExchangeCounts) -> str:
    """Return the counts of a channel as a line of text.

    Args:
        account: the counts.
    """
    what = f"{account.channel.type_name} {account.channel.topic}".strip()
    if not account.is_sent:
        return f"from {account.peer}: {what}: received {account.received}, dropped {account.dropped}"
    return (
        f"to {account.peer}: {what}: sent {account.sent} = received {account.received} + "
        f"replaced {account.replaced} + dropped {account.dropped} + lost {account.lost} + "
        f"under way {account.under_way}"
    )


def _check_encryption(settings: Mapping[str, object]) -> None:
    """Check that with keys every address is encrypted, and without keys none.

    Raises:
        SettingError: one is not.
    """
    for name in ("listen", "connect"):
        addresses = settings[name]
        assert isinstance(addresses, list)
        for address in addresses:
            is_encrypted = address.startswith(("tls/", "quic/"))
            if settings["keys"] is None and is_encrypted:
                problem = f"{address} needs keys: make them with `robbie keys new`, and set `keys`"
                raise SettingError(problem, name)
            if settings["keys"] is not None and not is_encrypted:
                encrypted = f"tls/{address.partition('/')[2]}"
                problem = f"{address} is not encrypted, but `keys` is set; write {encrypted}"
                raise SettingError(problem, name)


def _rules(value: object) -> list[tuple[str, list[TypeAndTopic]]]:
    assert isinstance(value, Mapping)
    return read_rules(value)


def _channels(counts: LinkCounts) -> Iterator[LinkChannel]:
    for account in counts.channels():
        yield LinkChannel(
            robot=account.peer,
            is_sent=account.is_sent,
            traffic=account.traffic.name.lower(),
            message_type=account.channel.type_name,
            topic=account.channel.topic,
            sent=account.sent,
            received=account.received,
            replaced=account.replaced,
            dropped=account.dropped,
            lost=account.lost,
            under_way=max(0, account.under_way),
        )


def _peer_state(peer: Peer, now_ns: int) -> LinkPeer:
    offset = peer.clock.at(now_ns)
    trip_ns = peer.clock.round_trip_ns
    return LinkPeer(
        robot=peer.name,
        is_up=peer.is_up(now_ns),
        session=peer.session,
        sessions=peer.sessions,
        round_trip_s=math.nan if trip_ns is None else trip_ns * NS,
        loss=peer.loss,
        bandwidth_bytes_per_s=peer.bytes_per_s,
        under_way_bytes=peer.under_way_bytes,
        newest_state_age_s=(now_ns - peer.newest_state_ns) * NS if peer.newest_state_ns else math.nan,
        clock_offset_s=offset.offset_ns * NS if offset else math.nan,
        clock_uncertainty_s=offset.uncertainty_ns * NS if offset else math.nan,
        duplicates=peer.duplicates,
        stale=peer.stale,
    )


def _summary(peer: Peer, now_ns: int) -> str:
    if not peer.is_up(now_ns):
        if peer.other_version:
            versions = f"its link has version {peer.other_version}, and this one {VERSION}"
            return f"{peer.name} DOWN: {versions}; install the same Robbie-MP on both"
        return f"{peer.name} DOWN"
    trip_ns = peer.clock.round_trip_ns or 0
    return f"{peer.name} {trip_ns / 1e6:.1f} ms, {peer.bytes_per_s / 1e6:.1f} MB/s, loss {peer.loss:.1%}"
