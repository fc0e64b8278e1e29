"""The bridge to ROS 2: the robot appears as a node, and messages pass both ways, byte for byte."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from robbie_mp.attached.profiler import system_profile
from robbie_mp.base.visible_text import one_line
from robbie_mp.bus.observe import RunReading, rates_between
from robbie_mp.bus.observe.run_observer import RunObserver
from robbie_mp.bus.transport.blocks import MessageTooLarge
from robbie_mp.connect.bridge.arrivals import AgeLog, GoalGate, hand_over
from robbie_mp.connect.bridge.diagnostics import DIAGNOSTICS, Diagnosis, TraceLines
from robbie_mp.connect.bridge.driving import drive_command
from robbie_mp.connect.bridge.frames import ForeignFrame, FrameMap
from robbie_mp.connect.bridge.mapping import NAME, BridgeMap, Incoming, MappingError, Quality
from robbie_mp.connect.bridge.orders import (
    STOP_TOPIC,
    OrderService,
    StopSwitch,
    carry_out,
    check_orders,
    orders_of,
)
from robbie_mp.connect.bridge.surroundings import BridgeRun
from robbie_mp.connect.ros2.action_types import STATUSES
from robbie_mp.connect.ros2.dds_side import LOOPBACK, DdsSide
from robbie_mp.connect.ros2.desk import Desk, RosRequest
from robbie_mp.connect.ros2.goal_desk import GoalDesk
from robbie_mp.connect.ros2.nodes import EVERY, Admission
from robbie_mp.connect.ros2.padding import unpadded
from robbie_mp.connect.ros2.parameters import NodeParameters
from robbie_mp.connect.ros2.ros_calls import (
    RosCall,
    RosCalls,
    SharedAction,
    actions_named,
    calls_named,
    check_calls,
)
from robbie_mp.connect.ros2.ros_goals import RosGoals
from robbie_mp.connect.ros2.ros_time import RosTime
from robbie_mp.connect.ros2.service_types import SET_BOOL, TRIGGER
from robbie_mp.connect.ros2.side import MAX_DOMAIN, MiddlewareInbox, NodeName, RosArrival, RosChannel, Side
from robbie_mp.connect.ros2.type_hash import type_hash
from robbie_mp.connect.ros2.zenoh_side import ROUTER, ZenohSide
from robbie_mp.messages import (
    Log,
    Message,
    MessageError,
    String,
    Time,
    Twist,
    TwistStamped,
    UnknownType,
    from_dict,
)
from robbie_mp.messages.descriptions import KnownTypes, own_types
from robbie_mp.messages.frames import Rename
from robbie_mp.messages.schema_parser import message_type_from_schema
from robbie_mp.messages.stock.robbie_msgs import MAX_VALID_FOR_S
from robbie_mp.module.envelope import EncodedMessage
from robbie_mp.module.module import calls_of, setting
from robbie_mp.module.settings import SettingError
from robbie_mp.run.lockstep import ClockSource
from robbie_mp.run.run_clock import ClockWriter, RunClock
from robbie_mp.run.trace.log_limit import LogLimit
from robbie_mp.scene.urdf import urdf_text

CLASS_PATH = "robbie_mp.connect.ros2.module:Ros2Bridge"
CLOCK_TOPIC, ROSOUT, DIAGNOSTICS_TOPIC = "/clock", "/rosout", "/diagnostics"
ROSOUT_DEPTH = 1000
"""As that of ROS's own nodes."""
TRACE_EVERY_NS = 500_000_000
CLOCK = message_type_from_schema(
    "rosgraph_msgs/msg/Clock",
    f"builtin_interfaces/Time clock\n{'=' * 80}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n",
)
DESCRIPTION = "robot_description"
SHOWN_EVERY_NS = 1_000_000_000
MAX_REMEMBERED = 4096
MAX_NAMED = 256
FAR = "the network is slow, or their sender's clock differs from this machine's; keep the clocks together"


class Ros2Bridge(ClockSource):
    """Makes the robot a node of ROS 2; ROS need not be installed. See docs/ros2.md.

        ros2:
          class: robbie_mp.connect.ros2.module:Ros2Bridge
          settings:
            node: red
            send:
              LaserScan laser: /scan best_effort depth=5
              OccupancyGrid map: /map latched
              TFMessage tf: /tf
              TFMessage tf_static: /tf_static latched
            accept:
              /goal_pose: PoseStamped goal
              /cmd_vel: Twist as DriveCommand ros

    What comes in is checked against the declaration of its type. What another bridge to ROS 2 has published
    on this robot is not sent back.

    Attributes:
        sent: messages handed to ROS 2.
        received: messages from ROS 2 that were published here.
        withheld: messages not sent because they came from ROS 2.
        unknown: messages not sent because their type, or that version of it, is not known here.
        malformed: messages dropped because they are not what their type declares.
        late: velocities that were too old when this module came to handle them.
        refused: messages that could not be published here, because memory was full.
    """

    period_s = 0.02
    handler_deadline_s = 1.2
    follows_run_clock = False

    middleware: str = setting("zenoh", "what the nodes of ROS 2 use", choices=("zenoh", "dds"))
    domain: int = setting(0, "the ROS_DOMAIN_ID", minimum=0, maximum=MAX_DOMAIN)
    node: str = setting("robbie", "name of the node")
    namespace: str = setting("", "its namespace, and that of names without a slash before them")
    nodes: list[str] = setting(
        [EVERY], "nodes that it deals with: shell patterns of full names, such as /slam/*; * stands for all"
    )
    connect: list[str] = setting([ROUTER], "addresses of Zenoh routers")
    listen: list[str] = setting(
        ["tcp/127.0.0.1:0"], "addresses where nodes reach this one; others than 127.0.0.1 are open"
    )
    interface: str = setting(LOOPBACK, "network interface of DDS; `lo` reaches nodes of this machine only")
    send: dict[str, str] = setting({}, "what is sent: a type, or a type and a topic, and its name in ROS")
    accept: dict[str, str] = setting({}, "what is accepted: a name in ROS, its type, and the topic here")
    frames: dict[str, str] = setting({}, "names of the robot's frames in ROS; `*` stands for all others")
    clock_topic: bool = setting(True, "send the time of a simulation or playback on /clock")
    urdf: Path | None = setting(
        None, "the robot's model, which is sent on robot_description", must_exist=True
    )
    rosout: bool = setting(True, "send what modules log on /rosout")
    diagnostics: bool = setting(True, "send the state of all modules on /diagnostics, once a second")
    parameters: str = setting(
        "change", "what ROS may do with the settings of modules", choices=("none", "read", "change")
    )
    services: dict[str, str] = setting(
        {}, "services in ROS: a name, a service of this robot, and the fields of its requests"
    )
    calls: dict[str, str] = setting(
        {},
        "services and actions of ROS that modules call: a name in ROS, the robot's type of it, and its topic",
    )
    actions: dict[str, str] = setting(
        {}, "actions of the robot in ROS: a name in ROS, the robot's type of goals, and its topic"
    )
    emergency_stop: str = setting(
        "engage", "what ROS may do with the emergency stop", choices=("none", "engage", "release")
    )
    drive_for_s: float = setting(
        0.3, "how long a velocity is followed after it was sent", minimum=0.05, maximum=MAX_VALID_FOR_S
    )
    inbox_messages: int = setting(1000, "messages that may wait until this module takes them", minimum=1)
    max_message_bytes: int = setting(64 << 20, "size of the largest message that is accepted", minimum=1024)
    max_memory_bytes: int = setting(
        1 << 30,
        "for DDS: memory that it may take until it starts again: CycloneDDS keeps all that nodes announce",
        minimum=128 << 20,
    )

    @classmethod
    def check(cls, settings: dict[str, object]) -> None:
        """Check the names."""
        node = str(settings["node"])
        if not NAME.fullmatch(node) or "/" in node:
            raise SettingError(f"a node cannot be called {node!r}: letters, digits and _", "node")
        nodes = settings["nodes"]
        assert isinstance(nodes, list)
        for one in nodes:
            if not one.startswith(("/", EVERY)):
                raise SettingError(f"the full name of a node begins with a slash, unlike {one!r}", "nodes")
        for name in ("send", "accept"):
            parts = {"send": {}, "accept": {}, name: settings[name]}
            _mapping(parts, str(settings["namespace"]), KnownTypes(own_types()), name)
        services, frames = settings["services"], settings["frames"]
        assert isinstance(services, Mapping)
        assert isinstance(frames, Mapping)
        try:
            FrameMap(frames)
        except MappingError as error:
            raise SettingError(str(error), "frames") from error
        try:
            check_orders(services)
        except MappingError as error:
            raise SettingError(str(error), "services") from error
        for name in ("calls", "actions"):
            lines = settings[name]
            assert isinstance(lines, Mapping)
            try:
                check_calls(lines, name)
            except MappingError as error:
                raise SettingError(str(error), name) from error

    # -- begin and end ---------------------------------------------------------------------------------

    def setup(self) -> None:
        """Join ROS 2, and subscribe."""
        around = BridgeRun.of(self.run_id, self.name, CLASS_PATH)
        self._types = around.types if self.run_id else KnownTypes(own_types())
        self._bridges = around.bridges
        self._observer = RunObserver(self.run_id) if self.run_id else None
        self.sent = self.received = self.withheld = self.unknown = 0
        self.malformed = self.late = self.refused = 0
        self._forget_channels()
        self._versions: dict[str, int] = {}
        """Which version of its type each name in ROS belongs to: nodes cannot tell others apart."""
        self._ages = AgeLog(self.log, FAR)
        self._frames = FrameMap(self.frames)
        self._named: set[str] = set()
        self._own_types = {one.type_name: one for one in (CLOCK, DIAGNOSTICS, STATUSES)}
        self._run_clock = RunClock.attach(self.run_id) if around.has_own_clock else None
        self.ros_time: RosTime | None = None
        self._is_described = self.urdf is None
        settings = {"send": self.send, "accept": self.accept}
        self.map = _mapping(settings, self.namespace, self._types)
        try:
            self._orders = orders_of(self.services, self._types)
        except MappingError as error:
            raise SettingError(str(error), "services") from error
        try:
            called = calls_named(self.calls, self._types)
        except MappingError as error:
            raise SettingError(str(error), "calls") from error
        try:
            offered = actions_named(self.actions, self._types)
        except MappingError as error:
            raise SettingError(str(error), "actions") from error
        self.side = self._join(NodeName(self.domain, f"/{self.namespace.strip('/')}", self.node))
        self._incoming: dict[RosChannel, tuple[Incoming, type[Message], Rename]] = {}
        for one in self.map.incoming:
            message_type = self._types.get(one.type_name)
            channel = RosChannel(one.name, one.type_name, type_hash(message_type), one.quality)
            self._incoming[channel] = one, message_type, self._frames.inward(message_type)
            self.side.listen(channel)
        if around.sets_clock:
            self._follow_time()
        self._offer_services()
        self._share_calls(called, offered)
        self.node_parameters: NodeParameters | None = None
        if self.parameters != "none":
            node = self.map.absolute(self.node)
            self.node_parameters = NodeParameters(
                self, self.desk, node, around.settings, self.parameters == "change"
            )
        self._observe(around)
        self._time = self._own(CLOCK, CLOCK_TOPIC, Quality(depth=1))
        for outgoing in self.map.outgoing:
            self.subscribe_encoded(outgoing.pair.type, self.on_message, topic=outgoing.pair.topic)
        self._log_limit = LogLimit()
        self.log.addFilter(self._log_limit)  # last: without a whole setup there is no teardown

    def _follow_time(self) -> None:
        """Let ROS's time set the run's."""
        if self.lockstep is not None:
            raise SettingError("ROS's time cannot be followed in lockstep", "clock_topic")
        self._clock_writer = ClockWriter.attach(self.run_id)
        self.ros_time = RosTime(self._clock_writer)
        channel = self._own(CLOCK, CLOCK_TOPIC, Quality(is_reliable=False))
        self.inbox.taps[channel] = partial(self.ros_time.take, CLOCK)
        self.side.listen(channel)

    def _look_at_time(self, ros_time: RosTime) -> None:
        """Tell of jumps, and of a time that was lost."""
        while ros_time.announced:
            self.publish(ros_time.announced.popleft())

    @property
    def _time_problem(self) -> str:
        return self.ros_time.problem if self.ros_time is not None else ""

    def _share_calls(self, called: list[RosCall | SharedAction], offered: list[SharedAction]) -> None:
        """Let modules call ROS, and nodes of ROS send goals to modules."""
        self.ros_calls = RosCalls(self, self.side, self.map.absolute)
        self.ros_goals = RosGoals(self, self.side, self._frames, self.log)
        client = calls_of(self).client
        self.goal_desk = GoalDesk(
            client, self.side, self.desk, self._frames, self.log, self._now_ns, lambda: self._time_problem
        )
        self._actions = [one._replace(name=self.map.absolute(one.name)) for one in offered]
        for action in self._actions:
            self._own_types[action.action.feedback.type_name] = action.action.feedback
            self.goal_desk.offer(action)
        for call in called:
            if isinstance(call, RosCall):
                self.ros_calls.offer(call)
            else:
                self._own_types[call.action.feedback.type_name] = call.action.feedback
                self.ros_goals.offer(call._replace(name=self.map.absolute(call.name)))
        self._looks_for_earlier_goals = True
        self.goal_desk.on_change = self.ros_goals.on_change = self._remember_goals

    def _remember_goals(self) -> None:
        """Save which goals have not ended: after a crash, the next process cancels them."""
        self.checkpoint({"served": self.goal_desk.memory, "sent": self.ros_goals.memory})

    def _end_earlier_goals(self) -> None:
        self._looks_for_earlier_goals, memory = False, self.restored
        if memory is not None:
            self.goal_desk.end_earlier(self._actions, memory["served"])
            self.ros_goals.end_earlier(memory["sent"])

    def _offer_services(self) -> None:
        self.desk = Desk(self.side, self.inbox, self.log)
        for order in self._orders:
            kind = TRIGGER if order.off is None else SET_BOOL
            self.desk.offer(self.map.absolute(order.name), kind, partial(self._order, order))
        self._stop: StopSwitch | None = None
        if self.emergency_stop != "none":
            self._stop = StopSwitch(self, "ROS 2", self._now_ns)
            name = self.map.absolute(STOP_TOPIC)
            self.desk.offer(f"{name}/engage", TRIGGER, partial(self._stop_or_release, self._stop))
            if self.emergency_stop == "release":
                self.desk.offer(name, SET_BOOL, partial(self._stop_or_release, self._stop))

    def _observe(self, around: BridgeRun) -> None:
        """Start watching who controls the robot, and what goes to /rosout and /diagnostics."""
        self._gate = GoalGate(self, self.map.incoming)
        self._trace: TraceLines | None = None
        self._diagnosis: Diagnosis | None = None
        self._before: RunReading | None = None
        self._looked_at_ns = self._shown_at_ns = 0
        if self.rosout and around.output is not None:
            self._trace = TraceLines(around.output)
            self._rosout = self._own(Log, ROSOUT, Quality(is_latched=True, depth=ROSOUT_DEPTH))
        if self.diagnostics and self._observer is not None:
            self._diagnosis = Diagnosis(self.node, self.run_id)
            self._diagnostics = self._own(DIAGNOSTICS, DIAGNOSTICS_TOPIC, Quality())

    def _join(self, node: NodeName) -> Side:
        self.inbox = MiddlewareInbox(self.inbox_messages, self.max_message_bytes, self.tick_soon)
        self.admission = Admission(self.nodes, self.max_message_bytes)
        if self.middleware == "dds":
            limit = self.max_memory_bytes
            return DdsSide(node, self.inbox, self._type, self.interface, self.admission, limit)
        limit, admission = self.max_message_bytes, self.admission
        return ZenohSide(node, self.inbox, self.listen, self.connect, limit, admission)

    def _now_ns(self) -> int:
        """Return the run's time; the machine's until that of a simulation or playback has begun."""
        clock = self._run_clock
        return clock.now_ns() if clock is not None and clock.has_begun else self.clock.now_ns()

    def _type(self, channel: RosChannel) -> type[Message]:
        own = self._own_types.get(channel.type_name) or self._sent_types.get(channel)
        return own or self._types.get(channel.type_name)

    def _own(self, message_type: type[Message], name: str, quality: Quality) -> RosChannel:
        """Return a channel of the bridge's own messages."""
        return RosChannel(name, message_type.type_name, type_hash(message_type), quality)

    def teardown(self) -> None:
        """Leave ROS 2."""
        self.log.removeFilter(self._log_limit)
        self.ros_goals.close()
        self.side.close()
        if self.ros_time is not None:
            self._clock_writer.close()
        if self._run_clock is not None:
            self._run_clock.close()
        if self._observer is not None:
            self._observer.close()

    # -- from this robot to ROS 2 ------------------------------------------------------------------------

    def on_message(self, message: EncodedMessage) -> None:
        """Send a message of this robot; what came from ROS 2 goes nowhere."""
        envelope = self.envelope
        if envelope.sender in self._bridges:
            self.withheld += 1
            return
        key = (message.type_name, message.version, envelope.topic)
        if key not in self._channels:
            if len(self._channels) >= MAX_REMEMBERED:
                self._forget_channels()
            self._channels[key] = self._channel(*key)
        found = self._channels[key]
        if found is None:
            self.unknown += 1
            return
        channel, rename = found
        try:
            data = rename(message.data)
        except MessageError as error:
            self.malformed += 1
            self.log.warning("%s of %s is not sent: %s", message.type_name, envelope.sender, error)
            return
        self.side.send(channel, data)
        self.sent += 1

    def _forget_channels(self) -> None:
        self._channels: dict[tuple[str, int, str], tuple[RosChannel, Rename] | None] = {}
        self._sent_types: dict[RosChannel, type[Message]] = {}

    def _channel(self, type_name: str, version: int, topic: str) -> tuple[RosChannel, Rename] | None:
        """Return how messages are sent, and what renames their frames; None if they cannot be sent."""
        sent_as = self.map.sent_as(type_name, topic)
        if sent_as is None:
            self._name(f"{type_name} on {topic!r} is not sent: its name in ROS belongs to another type")
            return None
        try:
            message_type = self._types.get(type_name, version)
        except (UnknownType, MessageError) as error:
            self._name(f"{type_name} on {topic!r} is not sent: {error}")
            return None
        if (first := self._versions.setdefault(sent_as.name, version)) != version:
            is_taken = f"its name in ROS belongs to version {first}, and this is version {version}"
            self._name(f"{type_name} on {topic!r} is not sent: {is_taken}")
            return None
        quality = sent_as.quality
        if self._observer is not None and not quality.is_latched:
            latched = {(one.type_name, one.version, one.topic) for one in self._observer.latched()}
            quality = replace(quality, is_latched=(type_name, version, topic) in latched)
        channel = RosChannel(sent_as.name, type_name, type_hash(message_type), quality)
        self._sent_types[channel] = message_type
        return channel, self._frames.outward(message_type)

    # -- from ROS 2 to this robot ------------------------------------------------------------------------

    def tick(self) -> None:
        """Take what has arrived, and show figures."""
        if self.ros_time is not None:
            self._look_at_time(self.ros_time)
        if self._looks_for_earlier_goals:
            self._end_earlier_goals()
        for arrived in self.inbox.take():
            if arrived.channel in self.ros_goals.channels:
                self.ros_goals.on_feedback(arrived.channel, arrived.data)
            else:
                self._take(arrived)
        while self.inbox.unnamed:
            self._name(f"a message was not asked for: {one_line(self.inbox.unnamed.popleft())}")
        while self.admission.unnamed:
            self._name(one_line(self.admission.unnamed.popleft()))
        self.desk.serve()
        self.ros_calls.tick()
        self.goal_desk.tick()
        self.ros_goals.tick()
        if self._stop is not None:
            self._stop.tick()
        if self.node_parameters is not None:
            self.node_parameters.tick()
        self._send_own()
        self.side.look_after()
        self.degraded = self._time_problem or self.side.refusal
        now_ns = self.clock.monotonic_ns()
        if now_ns - self._looked_at_ns >= TRACE_EVERY_NS:
            self._looked_at_ns = now_ns
            self._send_trace()
        if now_ns - self._shown_at_ns >= SHOWN_EVERY_NS:
            self._shown_at_ns = now_ns
            self.status = self._figures()
            self._send_diagnostics()

    def _take(self, arrived: RosArrival) -> None:
        incoming, message_type, rename = self._incoming[arrived.channel]
        try:
            message = message_type.decode(arrived.data)
            data = unpadded(message, arrived.data)
        except MessageError as error:
            self.malformed += 1
            self.log.warning("a message on %s was dropped: %s", incoming.name, one_line(str(error)))
            return
        is_barred = incoming.lets_move and (self._time_problem or self._gate.refuses(incoming))
        if is_barred or not self.ill_formed.admits(message, f"on {incoming.name}"):
            self.refused += 1
            return
        waited_s = arrived.waited_s
        if incoming.lets_move:
            self._ages.note(incoming, waited_s, self.drive_for_s)
        try:
            if incoming.drives:
                assert isinstance(message, Twist | TwistStamped)
                done = self._drive(incoming, message, waited_s)
            else:
                done = hand_over(self, incoming, message_type, rename(data), self.drive_for_s, waited_s)
        except (ForeignFrame, MessageError, MessageTooLarge) as error:
            self.log.warning("a message on %s cannot be published: %s", incoming.name, error)
            done = False
        self.received += done
        self.refused += not done

    def _drive(self, incoming: Incoming, velocity: Twist | TwistStamped, waited_s: float) -> bool:
        stamp = Time.from_nanoseconds(self._now_ns())
        command = drive_command(velocity, stamp, self.drive_for_s, waited_s)
        if command is None:
            self.late += 1
            return False
        return self.publish(command, topic=incoming.topic)

    # -- services for ROS 2 ------------------------------------------------------------------------------

    def _order(self, order: OrderService, asked: RosRequest) -> None:
        """Call a service of this robot; the response to ROS says what came of it."""
        is_on = order.off is None or asked.request.data

        def done(success: bool, message: str) -> None:
            asked.answer(success=success, message=message)

        carry_out(self, order, is_on, asked.waited_s, done)

    def _stop_or_release(self, stop: StopSwitch, asked: RosRequest) -> None:
        def done(success: bool, message: str) -> None:
            asked.answer(success=success, message=message)

        if getattr(asked.request, "data", True):
            stop.engage(done)
        else:
            stop.release(asked.waited_s, done)

    # -- what the bridge itself tells ROS 2 --------------------------------------------------------------

    def _send_own(self) -> None:
        """Send the run's time if it is not the machine's, and once the robot's model."""
        sends_time = self.clock_topic and self.ros_time is None
        if self._run_clock is not None and sends_time and self._run_clock.has_begun:
            now = Time.from_nanoseconds(self._run_clock.now_ns())
            told = from_dict(CLOCK, {"clock": {"sec": now.sec, "nanosec": now.nanosec}})
            self.side.send(self._time, told.encode())
        if not self._is_described and self.urdf is not None:
            self._is_described = True
            channel = self._own(String, self.map.absolute(DESCRIPTION), Quality(is_latched=True, depth=1))
            self.side.send(channel, String(data=urdf_text(self.urdf)).encode())

    def _send_trace(self) -> None:
        if self._trace is not None:
            for line in self._trace.read_new():
                self.side.send(self._rosout, line.encode())

    def _send_diagnostics(self) -> None:
        if self._diagnosis is None or self._observer is None:
            return
        before, self._before = self._before, self._observer.read()
        if before is not None:
            profile = system_profile(self._before, rates_between(before, self._before))
            self.side.send(self._diagnostics, self._diagnosis.of(profile).encode())

    # -- figures -----------------------------------------------------------------------------------------

    def _name(self, problem: str) -> None:
        """Log a problem, once."""
        if problem not in self._named and len(self._named) < MAX_NAMED:
            self._named.add(problem)
            self.log.warning("%s", problem)

    def _figures(self) -> str:
        lost = {
            "withheld": self.withheld,
            "unknown": self.unknown,
            "unsent": self.side.unsent,
            "incompatible": self.side.incompatible,
            "not asked for": self.inbox.strangers,
            "of other nodes refused": self.admission.refused,
            "other nodes seen": self.admission.others,
            "malformed": self.malformed + self.desk.malformed + self.ros_goals.malformed,
            "late": self.late,
            "refused": self.refused,
            "overflowed": self.inbox.overflowed,
            "too large": self.inbox.oversized,
            "calls of ROS failed": self.ros_calls.failed,
            "goals refused": self.goal_desk.refused,
            "goals for ROS failed": self.ros_goals.failed,
            "of the trace skipped": self._trace.skipped if self._trace is not None else 0,
        }
        served = f", {self.desk.handled} requests" if self.desk.handled else ""
        served += f", {self.ros_calls.asked} calls of ROS" if self.ros_calls.asked else ""
        served += f", {self.goal_desk.accepted} goals" if self.goal_desk.accepted else ""
        served += f", {self.ros_goals.sent} goals for ROS" if self.ros_goals.sent else ""
        if self.ros_time is not None:
            lost |= {"times malformed": self.ros_time.malformed, "times ignored": self.ros_time.ignored}
            served += f", time at {self.ros_time.rate:.2f} x"
        shown = served + "".join(f", {number} {what}" for what, number in lost.items() if number)
        return f"sent {self.sent}, received {self.received}{shown}"


def _mapping(
    settings: Mapping[str, object], namespace: str, types: KnownTypes, setting_name: str = ""
) -> BridgeMap:
    send, accept = settings["send"], settings["accept"]
    assert isinstance(send, Mapping)
    assert isinstance(accept, Mapping)
    try:
        return BridgeMap(send, accept, namespace, types)
    except MappingError as error:
        raise SettingError(str(error), setting_name) from error
