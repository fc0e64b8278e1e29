"""Modules for tests that behave well or badly; copied into each test's workspace."""

import json
import logging
import mmap
import os
import threading
import time
from pathlib import Path
from random import Random

import numpy as np

from robbie_mp import (
    DEFAULT,
    CallRefused,
    Duration,
    EncodedMessage,
    Header,
    MessageHandling,
    Module,
    Reply,
    Request,
    SettingError,
    Time,
    int32,
    setting,
)
from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.messages import DriveCommand, EmergencyStop, Image, ModuleState


class Journal(Module):
    """Writes numbers into a file, one per line, which survive the death of the process."""

    def note(self, number: int) -> None:
        with open(self.output_directory / f"{self.name}.journal", "a") as journal:
            journal.write(f"{number}\n")


class Counter(Journal):
    """Publishes a number of numbered messages as fast as they are handled, then ends."""

    count: int = setting(100, "messages")
    limit: int = setting(50, "messages on their way at once")
    period_s: float = setting(0.01, "between looks")

    def setup(self) -> None:
        self.number = 0

    def tick(self) -> None:
        while self.number < self.count:
            if self.outstanding >= self.limit:
                self.wake_after_freed(self.limit // 2)
                return
            if not self.publish(
                DriveCommand(header=Header(stamp=Time(sec=self.number)), valid_for=Duration(sec=1))
            ):
                return
            self.number += 1
        if self.outstanding == 0:
            self.stop()


class Listener(Journal):
    """Journals the number of every message it handles."""

    newest: bool = setting(False, "keep only the newest")
    die_at: int = setting(-1, "the number at which the first incarnation kills itself in its handler")

    def setup(self) -> None:
        handling = MessageHandling.KEEP_ONLY_NEWEST if self.newest else MessageHandling.ALWAYS_DELIVER
        self.subscribe(DriveCommand, self.on_command, handling)

    def on_command(self, command: DriveCommand) -> None:
        number = command.header.stamp.sec
        if number == self.die_at and not Path(self.output_directory, "died").exists():
            Path(self.output_directory, "died").touch()
            os.kill(os.getpid(), 9)
        self.note(number)


class PatternListener(Journal):
    """Journals the number of every encoded message on the topic of the wheels."""

    patience_s = 0.1

    def setup(self) -> None:
        self.subscribe_encoded("robbie_msgs/*", self.on_message, topic="wh*")
        self.subscribe_encoded("*", self.on_message, topic="*s")

    def on_message(self, message: EncodedMessage) -> None:
        assert (message.type_name, message.version) == (DriveCommand.type_name, DriveCommand.version)
        self.note(DriveCommand.decode(message.data).header.stamp.sec)


class Idle(Module):
    """Does nothing."""


class Camera(Module):
    """Publishes one loaned image, and journals where its pages are mapped."""

    period_s = 0.05

    def tick(self) -> None:
        if getattr(self, "sent", False):
            if self.outstanding == 0:
                self.stop()
            return
        with self.loan(Image, height=1000, width=1000, encoding="mono8", step=1000, data=1_000_000) as image:
            image.data[:] = np.arange(1_000_000) % 251
            (self.output_directory / "camera.json").write_text(json.dumps(where(image.data)))
        self.sent = True


class Viewer(Module):
    """Journals where an image's pages are, and whether they are writable."""

    def setup(self) -> None:
        self.subscribe(Image, self.on_image)

    def on_image(self, image: Image) -> None:
        found = where(image.data)
        found["sum"] = int(image.data.sum())
        try:
            image.data[0] = 99
        except ValueError as error:
            found["refused"] = str(error)
        try:
            image.data.flags.writeable = True
        except ValueError as error:
            found["refused_flag"] = str(error)
        (self.output_directory / f"{self.name}.json").write_text(json.dumps(found))


def where(array: np.ndarray) -> dict[str, object]:
    """File, offset in it and rights of the memory that an array lies in."""
    address = array.__array_interface__["data"][0]
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, rights, offset, _device, inode, *name = line.split()
        start, end = (int(part, 16) for part in span.split("-"))
        if start <= address < end:
            return {
                "inode": int(inode),
                "offset": int(offset, 16) + address - start,
                "rights": rights,
                "name": name[0],
                "pid": os.getpid(),
            }
    raise LookupError(hex(address))


class CrashInSetup(Module):
    """Never becomes ready."""

    def setup(self) -> None:
        raise RuntimeError("the device is not there")


class CrashInHandler(Module):
    """Fails at the third message."""

    def setup(self) -> None:
        self.seen = 0
        self.subscribe(DriveCommand, self.on_command)

    def on_command(self, _command: DriveCommand) -> None:
        self.seen += 1
        if self.seen == 3:
            raise ZeroDivisionError("third message")


class CrashWithThread(Module):
    """Crashes while one of its threads still runs."""

    period_s = 0.05

    def tick(self) -> None:
        threading.Thread(target=threading.Event().wait).start()
        raise RuntimeError("crashed beside a thread")


class NotText(Module):
    """Uses a text that cannot be encoded in UTF-8 wherever a module can use a text."""

    period_s = 0.01
    topic: bool = setting(False, "also publishes on a topic of that name")

    def tick(self) -> None:
        name = os.fsdecode(b"m\xfcll.txt")
        self.status = f"reads {name}"
        self.show_state(f"READ {name}", name)
        self.log.warning("logs %s", name)
        logging.getLogger(name).warning("by another name")
        print(f"prints {name}")
        if self.topic:
            self.publish(DriveCommand(), topic=name)
        self.stop()


class Computing(Journal):
    """Journals the requested and the actual number of threads of its numerical libraries."""

    def setup(self) -> None:
        self.note(int(os.environ["OMP_NUM_THREADS"]))
        self.note(len(os.listdir("/proc/self/task")))


class StateWatcher(Journal):
    """Journals every change of state of the module that it watches."""

    def setup(self) -> None:
        self.subscribe(ModuleState, self.on_state)

    def on_state(self, state: ModuleState) -> None:
        with open(self.output_directory / "states", "a") as file:
            file.write(f"{state.module} {state.state}\n")


class Holder(Journal):
    """Keeps every image it gets, and releases all when it has three."""

    def setup(self) -> None:
        self.kept: list[np.ndarray] = []
        self.subscribe(Image, self.on_image)

    def on_image(self, image: Image) -> None:
        self.kept.append(image.data)
        self.note(len(self.kept))


class Flood(Module):
    """Publishes as many messages as possible."""

    period_s = 0.001

    def tick(self) -> None:
        for _ in range(200):
            self.publish(Image(data=np.zeros(100_000, np.uint8)))


class Pulse(Journal):
    """Publishes numbered messages at a constant rate; journals their number when it is stopped.

    It pauses while too many of its messages are on their way. A module may have 4096: if listeners get no
    processor time for seconds, the core would drop some, and further ones would be refused.
    """

    period_s: float = setting(0.02, "between bursts")
    burst: int = setting(10, "messages in each")
    limit: int = setting(2000, "messages on their way")

    def setup(self) -> None:
        self.number = 0

    def tick(self) -> None:
        for _ in range(self.burst):
            if self.outstanding >= self.limit:
                return
            sent = self.publish(DriveCommand(header=Header(stamp=Time(sec=self.number))), topic="wheels")
            assert sent, "it was refused"
            self.number += 1

    def teardown(self) -> None:
        self.note(self.number)


def writable_segments(only: str = "") -> list[mmap.mmap]:
    """Map all of the run's memory again that this process may write, where a wild pointer may write, too.

    Args:
        only: how the names of the files begin.
    """
    lines = [line.split(maxsplit=5) for line in Path("/proc/self/maps").read_text().splitlines()]
    paths = {
        line[5] for line in lines if line[1] == "rw-s" and line[5].startswith(f"{SHARED_MEMORY}/robbie-")
    }
    paths = {path for path in paths if Path(path).name.startswith(only)}
    found = []
    for path in sorted(paths):
        with open(path, "r+b") as file:
            found.append(mmap.mmap(file.fileno(), 0))
    return found


class Scribbler(Module):
    """Fills all memory that it may write with random bytes, again and again, until somebody stops it."""

    period_s = 0.02
    only: str = setting("", "beginning of the names of what it overwrites; '' for everything")

    def setup(self) -> None:
        self.subscribe(DriveCommand, self.on_command)
        self.checkpoint({"number": 1})

    def on_command(self, _command: DriveCommand) -> None:
        self.publish(Image(data=np.zeros(100, np.uint8)))

    def tick(self) -> None:
        for segment in writable_segments(self.only):
            for at in range(0, len(segment), 4096):
                segment[at : at + 4096] = os.urandom(4096)


class Scrawler(Journal):
    """Overwrites some of the memory that it may write, other places in each of its lives, and dies soon."""

    period_s = 0.02
    seed: int = setting(0, "what it overwrites")

    def setup(self) -> None:
        self.note(1)
        lives = len((self.output_directory / f"{self.name}.journal").read_text().split())
        self.random = Random(1000 * self.seed + lives)
        self.subscribe(DriveCommand, self.on_command)
        self.checkpoint({"number": 1})

    def on_command(self, _command: DriveCommand) -> None:
        self.publish(Image(data=np.zeros(100, np.uint8)))

    def tick(self) -> None:
        draw = self.random
        for segment in writable_segments():
            if draw.random() < 0.3:
                size = min(len(segment), draw.choice([1, 8, 64, 4096, len(segment)]))
                at = draw.randrange(0, len(segment) - size + 1)
                fill = draw.choice([b"\x00", b"\xff", b"\x7f", draw.randbytes(1), None])
                segment[at : at + size] = draw.randbytes(size) if fill is None else fill * size
            segment.close()
        if draw.random() < 0.1:
            os._exit(1)


class Viewing(Module):
    """Looks at each image."""

    def setup(self) -> None:
        self.subscribe(Image, self.on_image)

    def on_image(self, image: Image) -> None:
        self.status = f"{len(image.data)} bytes"


class Staring(Viewing):
    """Looks at the newest image again and again."""

    period_s = 0.005

    def on_image(self, image: Image) -> None:
        self.image = image

    def tick(self) -> None:
        if hasattr(self, "image"):
            self.status = f"sum {self.image.data.sum()}"


class Watching(Staring):
    """Reads the figures of all modules, as the operator station does."""

    def setup(self) -> None:
        super().setup()
        self.observer = RunObserver(self.run_id)

    def tick(self) -> None:
        super().tick()
        self.observer.modules()


class Truncator(Module):
    """Cuts off segments of the run, by their names."""

    period_s = 0.2
    names: str = setting("*-1-*", "pattern of the files")

    def tick(self) -> None:
        for path in Path(f"{SHARED_MEMORY}/robbie-{self.run_id}").glob(self.names):
            os.truncate(path, 0)


class Tunable(Journal):
    """Has a changeable setting, and journals each value that it applies."""

    gain: int = setting(1, "how much", minimum=0, maximum=100, changeable=True)

    def setup(self) -> None:
        self.note(self.gain)

    def setting_changed(self, name: str) -> None:
        if self.gain == 13:
            raise SettingError("13 brings bad luck", name)
        self.note(self.gain)


class Ticker(Journal):
    """Publishes its time at each tick; many of them do so at the same time."""

    period_s: float = setting(0.05, "between ticks")

    def setup(self) -> None:
        self.number = 0

    def tick(self) -> None:
        self.number += 1
        now = self.now()
        header = Header(stamp=now, frame_id=self.name)
        self.publish(DriveCommand(header=header, linear_m_per_s=self.number / 1000))  # at most 100 m/s


class Sleeper(Ticker):
    """Ticks only after it has received a message."""

    period_s = None  # type: ignore[assignment]

    def setup(self) -> None:
        super().setup()
        self.subscribe(DriveCommand, self.on_command, topic="relayed")

    def on_command(self, _command: DriveCommand) -> None:
        self.period_s = 0.5


class Relay(Module):
    """Forwards received messages with its own name, at its own time."""

    def setup(self) -> None:
        self.subscribe(DriveCommand, self.on_command, topic="")

    def on_command(self, command: DriveCommand) -> None:
        if "/" not in command.header.frame_id:
            now = self.now()
            frame = f"{self.name}/{command.header.frame_id}"
            self.publish(
                DriveCommand(header=Header(stamp=now, frame_id=frame), linear_m_per_s=command.linear_m_per_s),
                topic="relayed",
            )


class Chronicle(Module):
    """Records all received messages in order, with times; may kill its first incarnation at a line."""

    die_at: int = setting(-1, "the line at which the first incarnation kills itself")
    period_s: float = setting(0.3, "between lines of its own")

    def setup(self) -> None:
        self.file = self.output_directory / "chronicle.txt"
        self.subscribe(DriveCommand, self.on_command)

    def on_command(self, command: DriveCommand) -> None:
        lines = self.file.read_text().count("\n") if self.file.exists() else 0
        if lines == self.die_at and not Path(self.output_directory, "died").exists():
            Path(self.output_directory, "died").write_text(self.line(command))
            os.kill(os.getpid(), 9)
        self.write(self.line(command))

    def line(self, command: DriveCommand) -> str:
        header, number = command.header, 1000 * command.linear_m_per_s
        return f"{header.stamp.nanoseconds} {header.frame_id} {number:g} {self.envelope.published_ns}"

    def tick(self) -> None:
        order = "-".join({"a", "set", "of", "some", "texts"})
        self.write(f"{self.clock.now_ns()} {self.clock.monotonic_ns()} {order} tick")

    def write(self, line: str) -> None:
        with open(self.file, "a") as file:
            file.write(line + "\n")


class Detector(Journal):
    """Journals the messages that it sees; each takes it a while."""

    work_s: float = setting(0.12, "time for each")

    def setup(self) -> None:
        self.subscribe(DriveCommand, self.on_command, MessageHandling.KEEP_ONLY_NEWEST)

    def on_command(self, command: DriveCommand) -> None:
        time.sleep(self.work_s)
        self.note(round(1000 * command.linear_m_per_s))


class StandingBase(Module):
    """Answers emergency stops as a base does."""

    period_s = 0.05

    def setup(self) -> None:
        self.engaged = False
        self.status = "StandingBase is ready"
        self.subscribe(EmergencyStop, self.on_request, topic="emergency_stop")

    def on_request(self, request: EmergencyStop) -> None:
        self.engaged = request.engaged
        self.status = f"STOPPED: {request.reason}" if self.engaged else "StandingBase is ready"

    def tick(self) -> None:
        self.publish(EmergencyStop(engaged=self.engaged), topic="emergency_stop_state")


class LateSource(Module):
    """Is the run's clock source, but never sets the clock."""

    def setup(self) -> None:
        while True:
            time.sleep(0.01)


class Sum(Reply, name="zoo_msgs/srv/Add_Response"):
    """A sum."""

    total: int32


class Add(Request[Sum], name="zoo_msgs/srv/Add_Request"):
    """Two numbers."""

    a: int32 = DEFAULT
    b: int32 = DEFAULT


class Adder(Module):
    """Adds numbers for others, but no negative ones."""

    def setup(self) -> None:
        self.serve(Add, self.on_add, topic="sums")

    def on_add(self, request: Add) -> Sum:
        if request.a < 0:
            raise CallRefused(f"{request.a} is negative")
        return Sum(total=request.a + request.b)


class Writer(Module):
    """Writes a result as any program does, and ends."""

    period_s = 0.05

    def tick(self) -> None:
        (self.output_directory / "result.txt").write_text("42")
        self.stop()
