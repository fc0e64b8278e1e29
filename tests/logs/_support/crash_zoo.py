"""Modules that crash in many ways; copied into the workspace of a test as `crashes.py`."""

import asyncio
import contextlib
import ctypes
import faulthandler
import logging
import mmap
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import tty
import warnings
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path

import numpy as np
import yaml

from robbie_mp import (
    ActiveGoal,
    Array,
    CallRefused,
    EncodedMessage,
    Feedback,
    Goal,
    Header,
    Input,
    Message,
    MessageHandling,
    Module,
    Procedure,
    Reply,
    Request,
    Result,
    StateMachine,
    Synchronizer,
    Time,
    float64,
    int32,
    pause,
    setting,
)
from robbie_mp.messages import (
    DriveCommand,
    Image,
    ModuleState,
    PoseStamped,
    Quaternion,
    SettingChange,
    TFMessage,
    Transform,
    TransformStamped,
    Twist,
    TwistStamped,
    Vector3,
)
from robbie_mp.scene import SceneGraphListener
from robbie_robots.hw.connection.device import PluggableDevice
from robbie_robots.hw.connection.errors import DeviceSilent as DeviceNotThere
from robbie_robots.hw.connection.port import Port, PortError
from robbie_robots.modules.devices.pluggable import PluggableDeviceModule

FEED_S = 0.01
QUIET_S = 20.0
"""Longest time between two crashes; one that failed in its setup was not seen."""


class Number(Message, name="crashes/msg/Number"):
    value: int32
    weights: Array[float64]


class Latched(Message, name="crashes/msg/Latched", latched=True):
    value: int32


class ManyNumbers(Message, name="crashes/msg/ManyNumbers"):
    numbers: list[Number]


class Climbed(Feedback, name="crashes/action/Climb_Feedback"):
    steps: int32


class Top(Result, name="crashes/action/Climb_Result"):
    steps: int32


class Climb(Goal[Climbed, Top], name="crashes/action/Climb_Goal"):
    steps: int32


Climbing = ActiveGoal[Climb, Climbed, Top]


class Answer(Reply, name="crashes/srv/Ask_Response"):
    value: int32


class Ask(Request[Answer], name="crashes/srv/Ask_Request"):
    value: int32


class Feeder(Module):
    """Publishes numbers on two topics, one latched message, and many others; it answers and asks."""

    period_s = FEED_S

    def setup(self) -> None:
        self.n = 0
        self.serve(Ask, self.on_ask)
        self.serve_goals(Climb, self.on_climb)

    def on_climb(self, climbing: Climbing) -> None:
        climbing.feedback(Climbed(steps=1))
        climbing.succeed(Top(steps=0))

    def on_ask(self, ask: Ask) -> Answer:
        if ask.value < 0:
            raise CallRefused("negative")
        return Answer(value=2 * ask.value)

    def tick(self) -> None:
        self.n += 1
        topic = "b" if self.n % 7 == 3 else "a"
        self.publish(Number(value=self.n, weights=np.arange(self.n % 5, dtype=float)), topic=topic)
        if self.n == 1:
            self.publish(Latched(value=42), topic="map")
        if self.n == 20:
            self.publish(Number(value=self.n, weights=np.ones(100_000)), topic="large")
            change = SettingChange(request=1, setting="gain", value="0")
            self.publish(change, topic="setting")
        if self.n % 10 == 5:
            self.publish(Number(value=self.n, weights=np.full(100_000, self.n)), topic="image")
        if self.n == 25:
            self.call(Ask(value=13), lambda _reply: None, lambda _error: None, topic="server")
            self.send_goal(Climb(steps=3), lambda _top: None, lambda _error: None, topic="climber")
        numbers = [Number(value=number, weights=np.zeros(0)) for number in range(20 - self.n)]
        self.publish(ManyNumbers(numbers=numbers), topic="fewer")
        for _ in range(10):
            self.publish(Number(value=self.n, weights=np.zeros(75)), topic="many")
        self.move()

    def move(self) -> None:
        """Publish where the robot is, and twice a place and a speed; the last place is of long ago."""
        header = self.header("odom")
        pose = Transform(translation=Vector3(x=self.n / 10), rotation=Quaternion(w=1.0))
        moved = TransformStamped(header=header, child_frame_id="base_link", transform=pose)
        self.publish(TFMessage(transforms=[moved]), topic="tf")
        if self.n in (20, 40):
            self.publish(PoseStamped(header=header), topic="place")
            self.publish(TwistStamped(header=header, twist=Twist()), topic="speed")
        if self.n == 60:
            self.publish(PoseStamped(header=Header(stamp=Time(sec=5), frame_id="odom")), topic="old_place")


class Devices(Module):
    """Simulated devices at pseudo-terminals: they send lines. One is damaged, and one device hangs up."""

    period_s = 0.02
    names: list[str] = setting([], "whose devices there are")

    def setup(self) -> None:
        self.n = 0
        self.ends: dict[str, int] = {}
        for name in self.names:
            own, theirs = os.openpty()
            tty.setraw(theirs)
            os.set_blocking(own, False)
            self.ends[name] = own
            device_of(name).unlink(missing_ok=True)
            device_of(name).symlink_to(os.ttyname(theirs))

    def tick(self) -> None:
        self.n += 1
        for name, end in list(self.ends.items()):
            if name == "devicepulledout" and self.n == 40:
                os.close(self.ends.pop(name))
            elif name == "deviceanswer":
                with contextlib.suppress(BlockingIOError):
                    os.write(end, b"%d!\n" % (os.read(end, 100).count(b"?") * self.n))
            elif name != "devicesilent" or self.n < 40:
                os.write(end, b"7x\n" if self.n == 30 else b"%d\n" % self.n)

    def teardown(self) -> None:
        for name in self.names:
            device_of(name).unlink()


def device_of(name: str) -> Path:
    """Return the path of a device; it is there only while the robot runs."""
    return Path(__file__).parent / f"device-{name}"


class Conductor(Module):
    """Ends the run when all others have crashed for good, or no more do."""

    period_s = 1.0
    count: int = setting(1, "modules that will crash")

    def setup(self) -> None:
        self.failed: set[str] = set()
        self.quiet_s = 0.0
        self.subscribe(ModuleState, self.on_state)

    def on_state(self, state: ModuleState) -> None:
        self.quiet_s = 0.0
        if state.state == "FAILED":
            self.failed.add(state.module)

    def tick(self) -> None:
        self.quiet_s += self.period_s
        if len(self.failed) >= self.count or self.quiet_s > QUIET_S:
            self.stop()


class Crasher(Module):
    """Counts numbers; each subclass crashes in another way."""

    def setup(self) -> None:
        self.n = 0
        self.subscribe(Number, self.on_a, topic="a")

    def on_a(self, number: Number) -> None:
        self.n += 1


class FirstMessage(Crasher):
    def on_a(self, number: Number) -> None:
        raise ValueError(f"number {number.value}")


class NthMessage(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 15:
            raise RuntimeError("the fifteenth")


class FirstTick(Crasher):
    period_s = 0.05

    def tick(self) -> None:
        raise ValueError("tick")


class NthTick(Crasher):
    period_s = 0.02

    def tick(self) -> None:
        self.n += 1000
        if self.n > 6000:
            raise ValueError("tick")


class InSetup(Crasher):
    def setup(self) -> None:
        self.n = dict[str, int]()["none"]


class AfterTwoTopics(Crasher):
    """Crashes when a number of b comes right after one of a whose value is odd."""

    def setup(self) -> None:
        super().setup()
        self.last = 0
        self.subscribe(Number, self.on_b, topic="b")

    def on_a(self, number: Number) -> None:
        self.last = number.value

    def on_b(self, number: Number) -> None:
        if self.last == number.value - 1 and number.value > 9:
            raise AssertionError("b after a")


class EmptyArray(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += int(number.weights.max())


class ArrayIndex(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += int(number.weights[number.value])


class Shapes(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 3:
            self.n += int(np.dot(number.weights, np.ones(3)))


class ReadOnly(Crasher):
    def on_a(self, number: Number) -> None:
        if len(number.weights):
            number.weights[0] = 1.0


class KeptArray(Crasher):
    """Keeps arrays of messages, and crashes over the sum of all."""

    def setup(self) -> None:
        super().setup()
        self.kept: list[np.ndarray] = []

    def on_a(self, number: Number) -> None:
        self.kept.append(number.weights)
        if sum(float(one.sum()) for one in self.kept) > 30:
            raise OverflowError("too much")


class Division(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 10 // (number.value % 6)


class Cause(Crasher):
    def on_a(self, number: Number) -> None:
        try:
            dict[int, int]()[number.value]
        except KeyError as error:
            raise LookupError("not known") from error


class InHelper(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 5:
            sorted([1, 2], key=self.key)

    def key(self, one: int) -> int:
        return one // (one - 1)


class Recursion(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 5:
            self.on_a(number)


class TimeOfDay(Crasher):
    def on_a(self, number: Number) -> None:
        if self.clock.now_ns() // 1000 % 5 == 3:
            raise ValueError("bad time")


class Elapsed(Crasher):
    def setup(self) -> None:
        super().setup()
        self.begun_s = self.monotonic_s()

    def on_a(self, number: Number) -> None:
        if self.monotonic_s() - self.begun_s > 0.2:
            raise TimeoutError("too late")


class Random(Crasher):
    def on_a(self, number: Number) -> None:
        if random.random() < 0.2:
            raise ValueError("bad luck")


class NumpyRandom(Crasher):
    def on_a(self, number: Number) -> None:
        if np.random.rand() < 0.2:
            raise ValueError("bad luck")


class SetOrder(Crasher):
    """Which line crashes depends on the order in a set of strings."""

    def on_a(self, number: Number) -> None:
        first = next(iter({"red", "green", "blue"}))
        if first == "red":
            raise ValueError("red")
        if first == "green":
            raise ValueError("green")
        raise ValueError("blue")


class SettingChanged(Crasher):
    gain: int = setting(1, "how much", changeable=True)

    def on_a(self, number: Number) -> None:
        self.n += 10 // self.gain


class Restored(Crasher):
    """Saves what it counts; its second process crashes over what it restored."""

    def setup(self) -> None:
        super().setup()
        self.state = self.restored or {"n": 0}

    def on_a(self, number: Number) -> None:
        self.state["n"] += 1
        self.checkpoint(self.state)
        if self.restored and self.state["n"] == 12:
            raise ValueError("twelve in all")
        if self.state["n"] == 8:
            raise ValueError("eight in all")


class LatchedMessage(Crasher):
    def setup(self) -> None:
        super().setup()
        self.value = 0
        self.subscribe(Latched, self.on_map, topic="map")

    def on_map(self, message: Latched) -> None:
        self.value = message.value

    def on_a(self, number: Number) -> None:
        if self.value and number.value > 5:
            raise ValueError(self.value)


class ReplyHandler(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.call(Ask(value=self.n), self.on_reply)

    def on_reply(self, answer: Answer) -> None:
        raise ValueError(f"the answer is {answer.value}")


class NoServer(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.call(Ask(value=self.n), lambda _answer: None, self.on_error, topic="nobody")

    def on_error(self, error: Exception) -> None:
        raise RuntimeError("there is no server") from error


class CallTimeout(Crasher):
    def setup(self) -> None:
        super().setup()
        self.serve(Ask, self.on_ask, topic="slow")

    def on_ask(self, _ask: Ask) -> Answer:
        time.sleep(0.01)
        return Answer(value=1)

    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.call(Ask(value=1), lambda _answer: None, self.on_error, timeout_s=1e-6)

    def on_error(self, error: Exception) -> None:
        raise TimeoutError("no answer in time") from error


class ServiceHandler(Crasher):
    def setup(self) -> None:
        super().setup()
        self.serve(Ask, self.on_ask, topic="server")

    def on_ask(self, ask: Ask) -> Answer:
        raise ValueError(f"asked for {ask.value}")


class TimerCall(Crasher):
    def setup(self) -> None:
        super().setup()
        self.calls = 0
        self.every(0.03, self.on_timer)

    def on_timer(self) -> None:
        self.calls += 1
        if self.calls == 4:
            raise ValueError("fourth call")


class Late(Crasher):
    def setup(self) -> None:
        super().setup()
        self.subscribe(Number, self.on_a, topic="never", deadline_s=0.2, on_late=self.on_late, optional=False)

    def on_late(self) -> None:
        raise TimeoutError("nothing came")


class Pattern(Crasher):
    def setup(self) -> None:
        self.n = 0
        self.subscribe_encoded("crashes/msg/N*", self.on_encoded, topic="[ab]")

    def on_encoded(self, message: EncodedMessage) -> None:
        self.n += len(message.data)
        if self.n > 200:
            raise ValueError("too many bytes")


class Sender(Crasher):
    def on_a(self, number: Number) -> None:
        if self.envelope.sender == "feeder" and number.value > 6:
            raise PermissionError("not from you")


class WrongPublication(Crasher):
    def on_a(self, number: Number) -> None:
        self.publish(Number(value=number.value * 500_000_000, weights=number.weights), topic="out")


class LargeMessage(Crasher):
    def setup(self) -> None:
        super().setup()
        self.subscribe(Number, self.on_large, MessageHandling.KEEP_ONLY_NEWEST, topic="large")

    def on_large(self, number: Number) -> None:
        raise ValueError(f"{number.weights.sum():g}")


class ThirdImage(Crasher):
    """Messages that are too large to be kept; the third one is too many."""

    def setup(self) -> None:
        super().setup()
        self.images = 0
        self.subscribe(Number, self.on_image, topic="image")

    def on_image(self, number: Number) -> None:
        self.images += 1
        if self.images == 3:
            raise ValueError(f"a third image of {len(number.weights)}")


class AfterImages(ThirdImage):
    """The same, in another handler; the last message is not a large one."""

    def on_image(self, number: Number) -> None:
        self.images += 1

    def on_a(self, number: Number) -> None:
        if self.images == 3:
            raise ValueError("three images")


class ClockJump(Crasher):
    """The wall clock is set back while it runs."""

    def setup(self) -> None:
        super().setup()
        self.last_ns = 0
        self.true_ns, time.time_ns = time.time_ns, self.false_ns

    def false_ns(self) -> int:
        return self.true_ns() - 3_600_000_000_000 * (self.n > 9)

    def on_a(self, number: Number) -> None:
        self.n += 1
        now_ns = self.clock.now_ns()
        if now_ns < self.last_ns:
            raise ValueError("time went back")
        self.last_ns = now_ns


class Refused(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.call(Ask(value=-1), lambda _answer: None, self.on_error)

    def on_error(self, error: Exception) -> None:
        raise RuntimeError("refused") from error


class TimerAfterReply(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.call(Ask(value=4), self.on_reply)

    def on_reply(self, answer: Answer) -> None:
        self.every(0.03, self.on_timer)

    def on_timer(self) -> None:
        raise RuntimeError("after the answer")


class Allocations(Crasher):
    """Takes more and more memory: of its 4 GiB, a fourth piece never fits, and three always do."""

    def on_a(self, number: Number) -> None:
        self.n += 1
        self.kept = [*getattr(self, "kept", []), np.empty(1 << 27)]


class OnlyNewest(Crasher):
    def setup(self) -> None:
        self.n = 0
        self.subscribe(Number, self.on_a, MessageHandling.KEEP_ONLY_NEWEST, topic="a")

    def on_a(self, number: Number) -> None:
        if self.n >= 5 and number.value > self.n + 3:
            raise RuntimeError("too much is missing")
        self.n = number.value
        time.sleep(0.05)


class LongHistory(Crasher):
    """Saves its state now and then; the history does not reach back to the start."""

    def setup(self) -> None:
        super().setup()
        self.total = self.restored or 0
        self.subscribe(Number, self.on_many, topic="many")

    def on_many(self, number: Number) -> None:
        self.total += 1
        if self.total % 500 == 0:
            self.checkpoint(self.total)
        if self.total > 8010:
            raise KeyError(self.total)


class NestedMessages(Crasher):
    def setup(self) -> None:
        super().setup()
        self.subscribe(ManyNumbers, self.on_numbers, topic="fewer")

    def on_numbers(self, message: ManyNumbers) -> None:
        self.n += min(number.value for number in message.numbers)


class Pairs(Crasher):
    def setup(self) -> None:
        super().setup()
        place, speed = Input(PoseStamped, "place"), Input(TwistStamped, "speed")
        self.pairs = Synchronizer(self, place, speed, handler=self.on_pair)

    def on_pair(self, place: PoseStamped, speed: TwistStamped) -> None:
        self.status = f"{place.pose.position.x / speed.twist.linear.x}"


class OldPose(Crasher):
    def setup(self) -> None:
        super().setup()
        self.scene = SceneGraphListener(self)
        self.subscribe(PoseStamped, self.on_place, topic="old_place")

    def on_place(self, place: PoseStamped) -> None:
        self.scene.pose("odom", "base_link", place.header.stamp.nanoseconds)


class GoalServed(Crasher):
    period_s = 0.02

    def setup(self) -> None:
        super().setup()
        self.climbing: Climbing | None = None
        self.serve_goals(Climb, self.on_climb, topic="climber")

    def on_climb(self, climbing: Climbing) -> None:
        self.climbing, self.way = climbing, list(range(climbing.goal.steps))

    def tick(self) -> None:
        if self.climbing is not None:
            self.climbing.feedback(Climbed(steps=self.way.pop()))


class GoalResult(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 4:
            self.send_goal(Climb(steps=2), self.on_top, on_feedback=self.on_climbed)

    def on_climbed(self, climbed: Climbed) -> None:
        self.n += climbed.steps

    def on_top(self, top: Top) -> None:
        self.n //= top.steps


class ProfileSetting(Crasher):
    words: list[str] = setting(["a"], "some words")

    def on_a(self, number: Number) -> None:
        self.status = self.words[number.value % 5]


class SecondProcess(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.incarnation == 2:
            raise RuntimeError("a second process is one too many")
        if self.n == 4:
            raise ValueError("the first death")


class WarningAsError(Crasher):
    def on_a(self, number: Number) -> None:
        warnings.simplefilter("error")
        if number.value > 6:
            warnings.warn("old", DeprecationWarning, stacklevel=1)


class NumpyError(Crasher):
    def on_a(self, number: Number) -> None:
        with np.errstate(all="raise"):
            self.status = f"{np.float64(1.0) / np.float64(number.value - 9)}"


class DictChanged(Crasher):
    def on_a(self, number: Number) -> None:
        words = {"a": 1, "b": 2}
        for word in words:
            if number.value > 6:
                del words[word]


@dataclass(frozen=True)
class Span:
    begin: float
    end: float

    def __post_init__(self) -> None:
        if self.end < self.begin:
            raise ValueError(f"{self} ends before it begins")


class DataClass(Crasher):
    def on_a(self, number: Number) -> None:
        self.status = f"{Span(2.0, 9.0 - number.value)}"


@lru_cache
def once(value: int) -> list[int]:
    return []


class CachedState(Crasher):
    def on_a(self, number: Number) -> None:
        seen = once(number.value % 3)
        seen.append(number.value)
        if len(seen) > 4:
            raise RuntimeError(f"{seen} are too many")


class Library(Crasher):
    def on_a(self, number: Number) -> None:
        np.linalg.inv(np.diag([1.0, 9.0 - number.value]))


class Yaml(Crasher):
    def on_a(self, number: Number) -> None:
        yaml.safe_load("{a: 1" if number.value > 6 else "{a: 1}")


class Generator(Crasher):
    def setup(self) -> None:
        super().setup()
        self.steps = self.plan()

    def plan(self) -> Iterator[str]:
        yield "look"
        yield "go"

    def on_a(self, number: Number) -> None:
        self.status = next(self.steps)


class Coroutine(Crasher):
    def setup(self) -> None:
        super().setup()
        self.work = Procedure[Number]()
        self.work.begin(self.gather())

    async def gather(self) -> Number:
        heard: list[Number] = []
        while len(heard) < 6:
            heard.append(await pause())
        return heard[6]

    def on_a(self, number: Number) -> None:
        self.work.tell(number)


class Asyncio(Crasher):
    def on_a(self, number: Number) -> None:
        asyncio.run(self.both(number.value))

    async def both(self, value: int) -> None:
        await asyncio.gather(self.half(value), self.half(value + 1))

    async def half(self, value: int) -> None:
        await asyncio.sleep(0)
        self.n += 1 // (value - 9)


class Hand(Enum):
    OPEN = "is open"
    CLOSED = "is closed"


class States(Crasher):
    def setup(self) -> None:
        super().setup()
        ways = {Hand.OPEN: {Hand.CLOSED}, Hand.CLOSED: {Hand.OPEN}}
        self.machine = StateMachine(Hand.OPEN, ways, clock=self.monotonic_s)

    def on_a(self, number: Number) -> None:
        self.n += 1
        self.machine.go(Hand.CLOSED if self.n % 2 or self.n > 8 else Hand.OPEN, "told")


class Shouting(logging.Filter):
    def filter(self, record: logging.LogRecord) -> bool:
        return not isinstance(record.args, tuple) or bool(["low", "high"].index(str(record.args[0])))


class LogFilter(Crasher):
    def on_a(self, number: Number) -> None:
        alarms = logging.getLogger("alarms")
        alarms.addFilter(Shouting())
        alarms.warning("%s", "low" if number.value < 6 else "middle")


class IllFormedCommand(Crasher):
    def on_a(self, number: Number) -> None:
        self.publish(DriveCommand(linear_m_per_s=float("nan") if number.value == 9 else 0.0))


class Loan(Crasher):
    def on_a(self, number: Number) -> None:
        with self.loan(Image, height=4, width=4, step=4, encoding="mono8", data=16) as image:
            image.data[:] = 0
            image.data[number.value * 2] = 9


class InTeardown(Crasher):
    def on_a(self, number: Number) -> None:
        self.n += 1
        if self.n == 5:
            self.stop()

    def teardown(self) -> None:
        self.n //= self.n - 5


class ReadFile(Crasher):
    def on_a(self, number: Number) -> None:
        self.status = Path(__file__).read_text().splitlines()[number.value * 400]


class Pool(Crasher):
    def setup(self) -> None:
        super().setup()
        self.pool = ThreadPoolExecutor(2)

    def half(self, value: int) -> float:
        return 1 / (9 - value)

    def on_a(self, number: Number) -> None:
        self.status = f"{self.pool.submit(self.half, number.value).result()}"


class OtherProgram(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            subprocess.run(["false"], check=True)


class WildWrite(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            ctypes.memset(16, 0, number.value)


class BusError(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            with tempfile.TemporaryFile() as file:
                file.truncate(8192)
                view = mmap.mmap(file.fileno(), 8192)
                file.truncate(0)
                self.n += view[5000]


class Segfault(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            ctypes.string_at(0)


class Abort(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            os.abort()


class FloatingPoint(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            os.kill(os.getpid(), signal.SIGFPE)


class Killed(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            os.kill(os.getpid(), signal.SIGKILL)


class StackOverflow(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            faulthandler._stack_overflow()  # type: ignore[attr-defined]


class BusyLoop(Crasher):
    def on_a(self, number: Number) -> None:
        while number.value > 6:
            self.n += 1


class Sleeps(Crasher):
    period_s = 0.05

    def tick(self) -> None:
        if self.n > 6:
            time.sleep(1000)


class Memory(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            self.all = np.ones(2 << 30)


class Exit(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            sys.exit(3)


class HardExit(Crasher):
    def on_a(self, number: Number) -> None:
        if number.value > 6:
            os._exit(7)


class DeviceCrasher(Crasher):
    """Reads lines of a device."""

    period_s = 0.02

    def setup(self) -> None:
        super().setup()
        self.port: Port | None = None
        self.rest = b""
        self.heard_s = self.monotonic_s()

    def tick(self) -> None:
        if self.port is None:
            try:
                self.port = Port(str(device_of(self.name)))
            except PortError:
                return
        self.ask()
        data = self.port.read(0.02)
        if data:
            self.heard_s = self.monotonic_s()
        *lines, self.rest = (self.rest + data).split(b"\n")
        for line in lines:
            self.on_line(line)

    def ask(self) -> None:
        pass

    def on_line(self, line: bytes) -> None:
        self.n += 1


class DeviceLine(DeviceCrasher):
    def on_line(self, line: bytes) -> None:
        self.n += int(line)


class DeviceSilent(DeviceCrasher):
    def ask(self) -> None:
        if self.monotonic_s() - self.heard_s > 0.4:
            raise TimeoutError("the device is silent")


class DeviceAnswer(DeviceCrasher):
    def ask(self) -> None:
        assert self.port is not None
        self.port.write(b"?\n")

    def on_line(self, line: bytes) -> None:
        if line.endswith(b"7!"):
            raise ValueError(line)


class DevicePulledOut(DeviceCrasher):
    pass


class Lines(PluggableDevice[int]):
    """A driver of such a device."""

    rest = b""

    def _start(self, port: Port) -> None:
        port.drain(0.0, 0.1)
        if not port.read(0.5):
            raise DeviceNotThere("no line")

    def _take(self, data: bytes) -> list[int]:
        self.rest += data
        *lines, self.rest = self.rest.split(b"\n")
        return [int(line, 36) % 7 for line in lines if len(line) > 1]

    def _reset(self) -> None:
        self.rest = b""


class DeviceDriver(PluggableDeviceModule[int]):
    """The sum of what the device sends in a second has a limit."""

    def open_device(self) -> Lines:
        self.sum = 0
        return Lines(str(device_of(self.name)), silence_s=self.silence_s)

    def on_value(self, value: int) -> None:
        self.sum += value
        if self.sum > 60:
            raise OverflowError(self.sum)


KINDS = {
    name: kind
    for name, kind in list(globals().items())
    if isinstance(kind, type) and issubclass(kind, Crasher | DeviceDriver)
}
"""The ways to crash, by the names of their classes."""
del KINDS["Crasher"], KINDS["DeviceCrasher"]
RESTARTED = ("Restored", "SecondProcess")
"""Those whose second process crashes, too."""
SETTINGS = {"DeviceDriver": "port: unused", "ProfileSetting": "words: [a, b, c]"}


def profile(names: list[str]) -> str:
    """Return the profile of a robot whose modules crash."""
    lines = ["modules:"]
    for name in names:
        own, process = ["settings: {}"], ""
        if name in RESTARTED:
            own = ["restart: {policy: on-failure, max_restarts: 1, backoff_s: 0.01}"]
        elif name in SETTINGS:
            own = [f"settings: {{{SETTINGS[name]}}}"]
        elif name in ("Memory", "Allocations"):
            process = ", process_bytes: 4294967296"
        elif name in ("BusyLoop", "Sleeps"):
            own = ["handler_deadline_s: 2"]
        restart = [] if name in RESTARTED else ["restart: {policy: never}"]
        memory = f"memory: {{history_bytes: 4M{process}}}"
        options = ", ".join([f"class: 'crashes:{name}'", *own, memory, *restart])
        lines.append(f"  {module_name(name)}: {{{options}}}")
    devices = ", ".join(module_name(name) for name in names if name.startswith("Device"))
    lines.append(f"  devices: {{class: 'crashes:Devices', settings: {{names: [{devices}]}}}}")
    lines.append("  feeder: {class: 'crashes:Feeder'}")
    lines.append(
        f"  conductor: {{class: 'crashes:Conductor', ends_run: true, settings: {{count: {len(names)}}}}}"
    )
    return "\n".join(lines) + "\n"


def module_name(name: str) -> str:
    """Return the name of the module of a kind."""
    return "setting" if name == "SettingChanged" else name.lower()
