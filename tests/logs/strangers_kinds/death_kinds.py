"""Deaths without an exception, lack of memory, hangs, and exceptions of unusual forms."""

from tests.logs.strangers_kinds.kind import Kind
from tests.logs.strangers_kinds.time_kinds import on_number

DEATH_KINDS = [
    on_number(
        "import ctypes",
        "pass",
        """if number.value == 7:
                    ctypes.string_at(0)  # here""",
        "SIGSEGV",
        "SIGSEGV in C by ctypes",
    ),
    on_number(
        "import ctypes",
        "self.buffer = (ctypes.c_char * 16)()",
        """if number.value > 5:
                    ctypes.memset(16, 0, int(number.value))  # here""",
        "SIGSEGV",
        "SIGSEGV by a wild write",
    ),
    on_number(
        "import os",
        "pass",
        """if number.word == "w6":
                    os.abort()  # here""",
        "SIGABRT",
        "abort",
    ),
    on_number(
        "import os",
        "pass",
        """if number.word == "w6":
                    os._exit(3)""",
        "exit code 3",
        "os._exit",
    ),
    on_number(
        "import sys",
        "pass",
        """if number.word == "w6":
                    sys.exit(4)""",
        "exit code 4",
        "sys.exit",
    ),
    on_number(
        "import os\n        import signal",
        "pass",
        """if number.value == 9:
                    os.kill(os.getpid(), signal.SIGKILL)""",
        "SIGKILL",
        "SIGKILL",
    ),
    on_number(
        "import mmap\n        import tempfile",
        "self.file = tempfile.TemporaryFile()",
        """if number.value == 9:
                    self.file.truncate(8192)
                    view = mmap.mmap(self.file.fileno(), 8192)
                    self.file.truncate(0)
                    self.status = f"{view[5000]}"  # here""",
        "SIGBUS",
        "SIGBUS",
    ),
    Kind(
        "hang",
        "hung",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                left = number.value - 6.5
                while left != 3.5:
                    left += 1 if left < 0 else 0
                    if left < 0:
                        break
        """,
        feeder="""
        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.05

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.publish(Number(value=float(self.count - 5)))
                self.count += 1
        """,
        profile="handler_deadline_s: 1.5,",
    ),
    Kind(
        "hang of a lock",
        "hung",
        """
        from threading import Lock

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.lock = Lock()
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.lock.acquire()  # here
                if number.value != 8:
                    self.lock.release()
        """,
        profile="handler_deadline_s: 1.5,",
    ),
    on_number(
        "",
        "pass",
        """self.status = f"{self.depth(number.value)}"

            def depth(self, left: float) -> float:
                return 0.0 if 0 <= left < 8 else 1 + self.depth(left - 0.5)  # here""",
        "RecursionError",
        "recursion",
        why_not="sooner than then",  # the replay's own stack is a little deeper
    ),
    on_number(
        "import sys",
        "sys.setrecursionlimit(10**9)",
        """if number.value == 8:
                    self.sort(Key(self))

            def sort(self, key: "Key") -> bool:
                return key < key


        class Key:
            def __init__(self, victim: "Victim"):
                self.victim = victim

            def __lt__(self, other: "Key") -> bool:
                return sorted([self, other])[0] is self  # here""",
        "SIGSEGV",
        "stack overflow",
    ),
    on_number(
        "import numpy as np",
        "pass",
        """if number.value == 8:
                    self.grid = np.ones((1 << 25, 1 << 20))  # here""",
        "MemoryError",
        "MemoryError",
    ),
    Kind(
        "memory limit of the profile",
        "MemoryError",
        """
        import numpy as np
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.kept: list[np.ndarray] = []
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.kept.append(np.ones(25_000_000))  # here
        """,
        profile="memory:, process_bytes: 2G",
        why_not="sooner than then",  # the replay takes memory itself
    ),
]

FORM_KINDS = [
    on_number(
        "import warnings",
        'warnings.simplefilter("error")',
        """if number.value == 6:
                    warnings.warn("old", DeprecationWarning)  # here""",
        "DeprecationWarning",
        "warning as an error",
    ),
    on_number(
        "import numpy as np",
        'np.seterr(all="raise")',
        "self.status = f'{np.float64(1.0) / np.float64(number.value - 5)}'  # here",
        "FloatingPointError",
        "floating point error of numpy",
    ),
    on_number(
        "",
        "self.words: dict[str, int] = {}",
        """self.words[number.word] = 1
                for word in self.words:  # here
                    if word == "w2":
                        del self.words["w0"]""",
        "RuntimeError",
        "dict changed in a loop",
    ),
    on_number(
        "",
        "self.errors: list[Exception] = []",
        """self.errors.append(ValueError(f"bad {number.value}"))
                if len(self.errors) == 3:
                    raise ExceptionGroup("three are bad", self.errors)  # here""",
        "ExceptionGroup",
        "exception group",
    ),
    on_number(
        "",
        "self.rows = {'w0': 1, 'w1': 2}",
        """try:
                    self.status = f"{self.rows[number.word]}"
                except KeyError as error:
                    raise RuntimeError("no such row") from error  # here""",
        "RuntimeError",
        "chained exception",
    ),
    on_number(
        "",
        "self.width, self.area = 5.0, 10.0",
        """self.width -= 1
                self.status = f"{self.height}"

            @property
            def height(self) -> float:
                return self.area / self.width  # here""",
        "ZeroDivisionError",
        "property",
    ),
    on_number(
        "from dataclasses import dataclass",
        "pass",
        """self.status = f"{Span(2.0, 9.0 - number.value)}"


        @dataclass(frozen=True)
        class Span:
            begin: float
            end: float

            def __post_init__(self) -> None:
                if self.end < self.begin:
                    raise ValueError(f"{self} ends before it begins")  # here""",
        "ValueError",
        "data class",
    ),
    Kind(
        "helper module of the workspace",
        "KeyError",
        """
        from parts import Number
        from robbie_mp import Module
        from workers.names import name_of


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = name_of(number.word)
        """,
        files={
            "workers/__init__.py": "",
            "workers/names.py": """
            NAMES = {f"w{n}": f"word {n}" for n in range(6)}


            def name_of(word: str) -> str:
                return NAMES[word]  # here
            """,
        },
    ),
    Kind(
        "state of a helper module",
        "RuntimeError",
        """
        from parts import Number
        from robbie_mp import Module
        from workers.quota import take


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = f"{take(number.word)}"
        """,
        files={
            "workers/__init__.py": "",
            "workers/quota.py": """
            from collections import Counter
            from functools import lru_cache

            TAKEN: Counter[str] = Counter()


            @lru_cache
            def length(word: str) -> int:
                TAKEN[word] += 5
                return len(word)


            def take(word: str) -> int:
                TAKEN[word] += length(word)
                if TAKEN[word] > 10:
                    raise RuntimeError(f"{word} is used up")  # here
                return TAKEN[word]
            """,
        },
    ),
    on_number(
        "import numpy as np",
        "self.matrix = np.eye(2)",
        """self.matrix[1, 1] -= 0.25
                self.status = f"{np.linalg.inv(self.matrix)[0, 0]}"  # here""",
        "LinAlgError",
        "third-party library: numpy.linalg",
    ),
    on_number(
        "import yaml",
        "pass",
        """text = "{a: 1" if number.value == 6 else "{a: 1}"
                self.status = f"{yaml.safe_load(text)}"  # here""",
        "ParserError",
        "third-party library: yaml",
    ),
    on_number(
        "from collections.abc import Iterator",
        "self.steps = self.plan()",
        """self.status = next(self.steps)  # here

            def plan(self) -> Iterator[str]:
                yield "look"
                yield "go"
                yield "grasp\"""",
        "StopIteration",
        "generator",
    ),
    on_number(
        "from robbie_mp import Procedure, pause",
        "self.work = Procedure[str](); self.work.begin(self.fetch())",
        """self.work.tell(number)

            async def fetch(self) -> str:
                heard: list[str] = []
                while len(heard) < 6:
                    event = await pause()
                    heard.append(event.word)
                return heard[6]  # here""",
        "IndexError",
        "coroutine of a Procedure",
    ),
    on_number(
        "import asyncio",
        "self.values: list[float] = []",
        """self.values.append(number.value)
                self.status = f"{asyncio.run(self.work())}"

            async def work(self) -> float:
                results = await asyncio.gather(*(self.half(value) for value in self.values))
                return sum(results)

            async def half(self, value: float) -> float:
                await asyncio.sleep(0)
                return 1 / (value - 4)  # here""",
        "ZeroDivisionError",
        "asyncio in a handler",
    ),
    Kind(
        "state machine",
        "IllegalTransition",
        """
        from enum import Enum

        from parts import Number
        from robbie_mp import Module, StateMachine


        class Gripper(Enum):
            OPEN = "is open"
            CLOSED = "is closed"
            BROKEN = "is broken"


        class Victim(Module):
            def setup(self) -> None:
                self.machine = StateMachine(
                    Gripper.OPEN,
                    {Gripper.OPEN: {Gripper.CLOSED}, Gripper.CLOSED: {Gripper.OPEN}, Gripper.BROKEN: set()},
                    clock=self.monotonic_s,
                    on_change=self.show_state,
                )
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                closes = number.value % 2 == 0 and number.value != 10
                self.machine.go(Gripper.CLOSED if closes else Gripper.OPEN, "told")  # here
        """,
    ),
    Kind(
        "logging call",
        "ValueError",
        """
        import logging

        from parts import Number
        from robbie_mp import Module


        class Shouting(logging.Filter):
            def filter(self, record: logging.LogRecord) -> bool:
                record.level_of_alarm = ["low", "high"].index(record.args[0])  # here
                return True


        class Victim(Module):
            def setup(self) -> None:
                self.alarms = logging.getLogger("alarms")
                self.alarms.addFilter(Shouting())
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.alarms.warning("%s", "low" if number.value < 6 else "middle")
        """,
    ),
    Kind(
        "field of a message to publish",
        "FieldValueError",
        """
        from parts import Number, Other
        from robbie_mp import Module
        from robbie_mp.messages import RegionOfInterest


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.publish(RegionOfInterest(width=9 - int(number.value)))  # here
        """,
    ),
    Kind(
        "ill-formed command",
        "IllFormed",
        """
        from parts import Number
        from robbie_mp import Module
        from robbie_mp.messages import DriveCommand


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                speed = float("nan") if number.value == 9 else 0.0
                self.publish(DriveCommand(linear_m_per_s=speed))  # here
        """,
    ),
    on_number(
        "from robbie_mp.messages import Image",
        "pass",
        """with self.loan(Image, height=4, width=4, step=4, encoding="mono8", data=16) as image:
                    image.data[:] = number.value
                    image.data[int(number.value) * 2] = 9  # here""",
        "IndexError",
        "writing into a loan",
    ),
    Kind(
        "subclass of a stock module",
        "KeyError",
        """
        from parts import Number
        from robbie_robots.modules.devices.battery import SimulatedBatteryModule


        class Victim(SimulatedBatteryModule):
            period_s = 0.05

            def setup(self) -> None:
                super().setup()
                self.looks = {n: "ok" for n in range(6)}
                self.count = 0
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.battery.set_charge(number.value)

            def tick(self) -> None:
                super().tick()
                self.status = self.looks[self.count]  # here
                self.count += 1
        """,
        profile="settings: {arena: robbie:hw/simulation/arenas/demo.yaml},",
    ),
    Kind(
        "exception in setup",
        "ZeroDivisionError",
        """
        from robbie_mp import Module, setting


        class Victim(Module):
            rate_hz: int = setting(0, "how often")

            def setup(self) -> None:
                self.step_s = 1 / self.rate_hz  # here
        """,
    ),
    Kind(
        "exception on an ordered stop, in teardown",
        "AttributeError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.file = None
                self.count = 0
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.count += 1
                if self.count == 5:
                    self.stop()

            def teardown(self) -> None:
                self.file.close()  # here
        """,
    ),
]
