"""A module that gets again what a capsule holds: messages, ticks, times, answers and random numbers."""

import json
import random
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from robbie_mp.base.device_links import using_links
from robbie_mp.base.errors import RobbieError
from robbie_mp.base.stock_robots import ROBOTS
from robbie_mp.bus.checkpoint.errors import CheckpointDamaged, CheckpointTooNew
from robbie_mp.bus.checkpoint.image import decode
from robbie_mp.bus.transport.history import Event, Reading
from robbie_mp.bus.transport.tables import ChannelName
from robbie_mp.logs.capsule.form import ChannelForm
from robbie_mp.logs.capsule.outside import TimeOfThen
from robbie_mp.logs.capsule.read import Capsule, CapsuleUnreadable, Step
from robbie_mp.logs.capsule.replayed_links import ReplayedLinks
from robbie_mp.messages.errors import MessageError
from robbie_mp.messages.message import Message
from robbie_mp.module.bus import CopyingBus
from robbie_mp.module.calls.peers import Server
from robbie_mp.module.clock import ManualClock
from robbie_mp.module.envelope import EncodedMessage, Envelope
from robbie_mp.module.harness import HarnessBus, ModuleHarness
from robbie_mp.module.module import Module, calls_of
from robbie_mp.module.recorded import number_of
from robbie_mp.module.wiring import Wiring
from robbie_mp.run.profile.check import load_class

OWN_PACKAGES = ("robbie_mp", "robbie_robots")


class ForeignClass(RobbieError, ImportError):
    """A capsule names a class that is neither in the workspace nor in Robbie-MP: it is not imported.

    Example scenarios:
      - the workspace is another one than the robot's: give it with `--with`
    """


@dataclass(frozen=True)
class PublicationDifference:
    """The first publication that was another one than before."""

    step: int
    text: str


class Told:
    """What the module was told in the present step; each answer is given once, in order."""

    def __init__(self) -> None:
        self.later: set[str] = set()
        """Questions that were not asked then."""
        self._answers: dict[Any, deque[Any]] = {}
        self._last: dict[Any, Any] = {}
        self.now_ns = 0

    def begin(self, step: Step) -> None:
        """Take the answers of a step."""
        answers: dict[Any, deque[Any]] = defaultdict(deque)
        for kind, event in step.told:
            if kind is Event.CLOCK:
                answers[event.values[0]].append(event.values[1])
            elif kind is Event.ANSWER and event.data is not None:
                question, answer = json.loads(event.data)
                answers[question].append(answer)
            elif kind is Event.RANDOM and event.data is not None:
                _set_random(event.data)
        self._answers = answers
        if step.event is not None and step.event.time_ns:
            self.now_ns = step.event.time_ns

    def ask(self, question: Any, name: str, otherwise: Any = None) -> Any:
        """Return the next answer; if it was not asked so often, the last one."""
        queue = self._answers.get(question)
        if queue:
            self._last[question] = queue.popleft()
        elif question not in self._last:
            self.later.add(name)
            return otherwise
        else:
            self.later.add(name)
        return self._last[question]


class ReplayedClock:
    """Gives the answers that the clock gave then."""

    follows_machine = True

    def __init__(self, told: Told, epoch_ns: int, *, follows_machine: bool):
        self._told = told
        self._epoch_ns = epoch_ns
        self.follows_machine = follows_machine

    def now_ns(self) -> int:
        """See `Clock`."""
        return int(self._told.ask(Reading.NOW_NS, "clock.now_ns", self._epoch_ns + self._told.now_ns))

    def monotonic_ns(self) -> int:
        """See `Clock`."""
        return int(self._told.ask(Reading.MONOTONIC_NS, "clock.monotonic_ns", self._told.now_ns))

    @property
    def jumps(self) -> int:
        """See `Clock`."""
        return 0 if self.follows_machine else int(self._told.ask(Reading.JUMPS, "clock.jumps", 0))

    def at(self, machine_ns: int) -> int:
        """See `Clock`."""
        return machine_ns if self.follows_machine else int(self._told.ask(Reading.AT, "clock.at", machine_ns))

    def machine_s_until(self, _monotonic_ns: int) -> float:
        """See `Clock`."""
        return number_of(int(self._told.ask(Reading.MACHINE_S_UNTIL, "clock.machine_s_until", 0)))


class ReplayedPeers:
    """Gives the answers that the other modules gave then; see `Peers`."""

    can_serve = True

    def __init__(self, told: Told, name: str, incarnation: int):
        self._told = told
        self.name = name
        self.incarnation = incarnation
        self.kept: set[int] = set()

    def now_ns(self) -> int:
        """See `Peers`."""
        return int(self._told.ask(Reading.MACHINE_NS, "the machine's time", self._told.now_ns))

    def find_server(self, _service: ChannelName) -> Server | None:
        """See `Peers`."""
        found = self._told.ask("find_server", "find_server")
        if found is None:
            return None
        module, slot, service, row = found
        return Server(module, slot, ChannelName(*service), row)

    def serves(self, _server: Server) -> bool:
        """See `Peers`."""
        return bool(self._told.ask("serves", "serves", True))

    def is_same(self, _server: Server, _incarnation: int) -> bool:
        """See `Peers`."""
        return bool(self._told.ask("is_same", "is_same", True))

    def incarnation_of(self, _server: Server) -> int:
        """See `Peers`."""
        return int(self._told.ask("incarnation_of", "incarnation_of", 1))

    def end_of(self, _server: Server) -> str:
        """See `Peers`."""
        return str(self._told.ask("end_of", "end_of", ""))

    def rival(self, _service: ChannelName) -> str | None:
        """See `Peers`."""
        answer: str | None = self._told.ask("rival", "rival")
        return answer


class ReplayedBus(HarnessBus):
    """A bus on which everything comes from a capsule."""

    def __init__(self, told: Told, name: str, incarnation: int, wiring: Wiring):
        super().__init__(ManualClock(), name, wiring)
        self._own_topic = wiring.own
        self.peers = ReplayedPeers(told, name, incarnation)  # type: ignore[assignment]
        self.difference: PublicationDifference | None = None
        self._step = 0
        self._expected: dict[tuple[str, str], deque[bytes | None]] = {}
        self._refusals = 0

    def begin(self, number: int, step: Step) -> None:
        """Expect the publications of a step."""
        self._step = number
        self._expected = defaultdict(deque)
        self._refusals = sum(channel is None for channel, _ in step.published)
        for channel, data in step.published:
            if channel is not None:
                self._expected[channel.type_name, channel.topic].append(data)

    def end(self) -> None:
        """Note what was published then and is not now."""
        for (type_name, topic), left in self._expected.items():
            if left:
                self._differ(f"{_name(type_name, topic)} was published {len(left)} times more then")

    def _differ(self, text: str) -> None:
        if self.difference is None:
            self.difference = PublicationDifference(self._step, text)

    def publish(self, message: Message | EncodedMessage, topic: str, latched: bool = False) -> bool:
        """Compare a message with the one that was published then."""
        before = len(self.published), len(self.published_encoded)
        if message.type_name.endswith("/CallsQuestion"):
            actual, data, is_done = topic, message.encode(), True  # type: ignore[union-attr]
        else:
            is_done = super().publish(message, topic, latched)
            actual, data = self._newest(before)
        expected = self._expected[message.type_name, actual]
        if not expected:
            if self._refusals:
                self._refusals -= 1
                return False
            self._differ(f"{_name(message.type_name, actual)} is published, which it was not then")
        elif (then := expected.popleft()) is not None and not _is_same(message, data, then):
            self._differ(_describe(message, data, then, actual))
        return is_done

    def _newest(self, before: tuple[int, int]) -> tuple[str, bytes]:
        if len(self.published_encoded) > before[1]:
            encoded = self.published_encoded[-1]
            return encoded.topic, encoded.data
        entry = self.published[-1]
        return entry.topic, entry.message.encode()

    def lose(self, error: MessageError) -> None:
        """Count a message that could not be decoded, as in a robot."""
        CopyingBus.lose(self, error)

    def deliver_step(self, step: Step, published_ns: int) -> None:
        """Run the handler that got the message of a step then."""
        if step.channel is None or step.data is None or step.event is None:
            return
        name = ChannelName(step.channel.type_name, step.channel.version, step.channel.topic)
        for subscription in self.subscriptions:
            if step.subscription is not None and _is_meant(subscription.name, step.subscription):
                topic = self._own_topic(name.type_name, name.topic)
                envelope = Envelope(topic, step.event.values[1], step.sender, published_ns)
                self.hand_over(subscription, name, envelope, step.data)
                return


def _is_meant(name: ChannelName, subscription: ChannelForm) -> bool:
    return (name.type_name, name.topic) == (subscription.type_name, subscription.topic)


def _name(type_name: str, topic: str) -> str:
    return f"{type_name.rpartition('/')[2]}{f' on {topic}' if topic else ''}"


def _is_same(message: Message | EncodedMessage, data: bytes, then: bytes) -> bool:
    if data == then:
        return True
    if isinstance(message, EncodedMessage):
        return False
    try:
        return type(message).decode(then).encode() == data  # bytes between fields may differ
    except MessageError:
        return False


def _describe(message: Message | EncodedMessage, data: bytes, then: bytes, topic: str) -> str:
    name = _name(message.type_name, topic)
    if isinstance(message, EncodedMessage):
        return f"{name} has {len(data)} bytes, {len(then)} then"
    try:
        before = type(message).decode(then)
    except MessageError:
        return f"{name} is of another version"
    for field in type(message).__annotations__:
        now, past = getattr(message, field, None), getattr(before, field, None)
        if repr(now) != repr(past):
            return f"{name}: {field} is {now!r:.80}, it was {past!r:.80}"
    return f"{name} differs"


class ReplayHarness(ModuleHarness[Module]):
    """Runs the module of a capsule.

    Args:
        capsule: the capsule.
        workspace: the folder with the module's code.
        time: what Python's own clocks say meanwhile; None: the machine's time.
    """

    checks_class = False  # it does what it does in a robot, which has checked it

    def __init__(self, capsule: Capsule, workspace: Path, time: TimeOfThen | None = None):
        start = capsule.manifest.start
        self._capsule = capsule
        self._time = time
        self.told = Told()
        self.told.begin(capsule.steps[0])
        self.links = ReplayedLinks(capsule.steps)
        seed_random(start.seed)
        module_class = load_capsule_class(capsule, workspace)
        super().__init__(
            module_class,
            relocated(start.settings, start.workspace, workspace),
            name=start.module,
            restored=base_state(capsule),
            checkpoint_lost=start.lost > 0,
            topics=start.topics,
            namespace=start.namespace,
            folder=workspace,
        )
        calls_of(self.module).is_granted = start.lockstep

    def make_clock(self) -> Any:
        """Return the clock that gives the answers of then."""
        start = self._capsule.manifest.start
        asked = {
            event.values[0]
            for step in self._capsule.steps
            for kind, event in step.told
            if kind is Event.CLOCK
        }
        follows_machine = not asked & {Reading.JUMPS, Reading.AT}
        return ReplayedClock(
            self.told, start.started_ns - start.monotonic_ns, follows_machine=follows_machine
        )

    def make_bus(self, name: str, wiring: Wiring) -> HarnessBus:
        """Return the bus on which everything comes from the capsule."""
        incarnation = self._capsule.manifest.start.incarnation
        self.replayed = ReplayedBus(self.told, name, incarnation, wiring)
        self.replayed.begin(0, self._capsule.steps[0])
        return self.replayed

    def run(self, before: Callable[[int, Step], None], wanted: set[int] | None = None) -> None:
        """Run all steps.

        Args:
            before: called before each step.
            wanted: run only these steps; None: all.
        """
        for number, step in enumerate(self._capsule.steps):
            if wanted is not None and number not in wanted and step.kind is Event.MESSAGE:
                continue
            before(number, step)
            if self._time is not None:
                self._time.begin(self._begins_ns(number, step))
            if number:
                self.told.begin(step)
                self.replayed.begin(number, step)
            self.links.begin(step)
            with using_links(self.links):
                self._do(step)
            self.replayed.end()

    def _begins_ns(self, number: int, step: Step) -> int:
        """Return when a step began; 0: not known."""
        if number:
            return step.event.time_ns if step.event is not None else 0
        begun = self._capsule.steps[1].event if len(self._capsule.steps) > 1 else None
        return begun.values[0] if begun is not None and begun.kind == Event.BEGUN.name else 0

    def _do(self, step: Step) -> None:
        calls = calls_of(self.module)
        match step.kind:
            case Event.PADDING:
                self._loop.set_up()
            case Event.BEGUN:
                self._loop.begin()
            case Event.MESSAGE:
                stamp_ns = step.event.values[3] if step.event else 0
                self.replayed.deliver_step(step, self.clock.at(stamp_ns))
                if calls.is_granted:
                    calls.end_handling()
            case Event.TICK:
                self.module.tick()
            case Event.CALLS:
                (calls.run_granted if calls.is_granted else calls.run)()
            case Event.TEARDOWN:
                self._loop.tear_down()


def base_state(capsule: Capsule) -> Any:
    """Return the state with which the module of a capsule began; None: it began fresh.

    Raises:
        CapsuleUnreadable: it is damaged.
    """
    if capsule.base is None:
        return None
    try:
        return decode(capsule.base).state
    except (CheckpointDamaged, CheckpointTooNew) as error:
        raise CapsuleUnreadable(f"{capsule.path}: its checkpoint is damaged: {error}") from error


def load_capsule_class(capsule: Capsule, workspace: Path) -> type[Module]:
    """Import the class of a capsule from a workspace.

    Raises:
        ForeignClass: it lies neither there nor in Robbie-MP.
        NotAModule: it is no module.
    """
    path = capsule.manifest.start.class_path
    folder = str(workspace)
    if folder not in sys.path:
        sys.path.insert(0, folder)
    top = path.partition(":")[0].partition(".")[0]
    if top not in OWN_PACKAGES and not any(_lies_in(place, workspace) for place in _places(top)):
        raise ForeignClass(
            f"{path} is not in {workspace}; go to the robot's workspace, or name it: --with FOLDER"
        )
    return load_class(path, Module)


def _places(top: str) -> Iterator[Path]:
    try:
        spec = find_spec(top) if top else None
    except (ImportError, ValueError):
        return
    if spec is not None:
        yield from (Path(one) for one in [spec.origin, *(spec.submodule_search_locations or [])] if one)


def _lies_in(place: Path, workspace: Path) -> bool:
    return any(
        place.resolve().is_relative_to(folder) for folder in (workspace.resolve(), Path(ROBOTS).resolve())
    )


def relocated(value: Any, before: str, workspace: Path) -> Any:
    """Return settings in which paths in the robot's workspace are those in this one."""
    if isinstance(value, dict):
        return {key: relocated(one, before, workspace) for key, one in value.items()}
    if isinstance(value, list):
        return [relocated(one, before, workspace) for one in value]
    if isinstance(value, str) and before and (value == before or value.startswith(before + "/")):
        return str(workspace) + value[len(before) :]
    return value


def seed_random(seed: int | None) -> None:
    """Begin the same random numbers as then."""
    if seed is not None:
        random.seed(seed)
        np.random.seed(seed & 0xFFFFFFFF)


def _set_random(data: bytes) -> None:
    """Continue the random numbers from a state."""
    try:
        (version, words, gauss), (name, keys, *rest) = json.loads(data)
        random.setstate((version, tuple(words), gauss))
        np.random.set_state((name, np.array(keys, np.uint32), *rest))
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise CapsuleUnreadable(f"the state of random numbers is damaged: {error}") from error
