"""Crashes by ticks, clocks and chance."""

from tests.logs.strangers_kinds.kind import CHANCE, Kind


def on_number(imports: str, setup: str, body: str, error: str, name: str, why_not: str = "") -> Kind:
    """Return a kind whose victim does this with each number."""
    victim = f"""
        {imports}
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                {setup}
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                {body}
        """
    return Kind(name, error, victim, why_not=why_not)


TICK_KINDS = [
    Kind(
        "tick",
        "ZeroDivisionError",
        """
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.left = 12

            def tick(self) -> None:
                self.left -= 1
                self.status = f"{1 / self.left}"  # here
        """,
    ),
    Kind(
        "one of two timers",
        "AttributeError",
        """
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.device = None
                self.every(0.01, self.look)
                self.every(0.15, self.close)

            def look(self) -> None:
                self.status = "looks"

            def close(self) -> None:
                self.device.close()  # here
        """,
    ),
    Kind(
        "timer that is begun and stopped",
        "RuntimeError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.blinks = 0
                self.timer = None
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                if number.value % 40 == 0:
                    self.timer = self.every(0.02, self.blink)
                elif number.value % 40 == 30 and self.timer:
                    self.timer.stop()

            def blink(self) -> None:
                self.blinks += 1
                if self.blinks == 15:
                    raise RuntimeError("the lamp is broken")  # here
        """,
    ),
    Kind(
        "tick after messages",
        "ValueError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.1

            def setup(self) -> None:
                self.values: list[float] = []
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                if number.value < 50:
                    self.values.append(number.value)

            def tick(self) -> None:
                if self.values or self.monotonic_s() > self.start_s + 0.5:
                    self.status = f"{max(self.values)}"  # here
                self.values.clear()

            @property
            def start_s(self) -> float:
                if not hasattr(self, "_start_s"):
                    self._start_s = self.monotonic_s()
                return self._start_s
        """,
    ),
]

CLOCK_KINDS = [
    on_number(
        "import time",
        "self.started_s = time.time()",
        """if time.time() - self.started_s > 0.3:
                    raise TimeoutError("it takes too long")  # here""",
        "TimeoutError",
        "wall clock: time.time",
        CHANCE,
    ),
    on_number(
        "from datetime import datetime, timezone",
        "self.rows = [1, 2, 3]",
        """if number.value > 10:
                    self.status = f"{self.rows[datetime.now(timezone.utc).microsecond % 7]}"  # here""",
        "IndexError",
        "wall clock: datetime.now",
        CHANCE,
    ),
    on_number(
        "import time",
        "self.last_s = time.monotonic()",
        """now_s, self.last_s = time.monotonic(), self.last_s
                if number.value > 20 and int(now_s * 1e6) % 3 == 0:
                    raise ValueError(f"a step of {now_s - self.last_s}")  # here""",
        "ValueError",
        "time.monotonic",
        CHANCE,
    ),
    on_number(
        "import time",
        "self.took_s = [0.0]",
        """begin_s = time.perf_counter()
                sorted(range(2000))
                if number.value > 20 and int((time.perf_counter() - begin_s) * 1e7) % 3 == 0:
                    raise RuntimeError("too slow")  # here""",
        "RuntimeError",
        "time.perf_counter",
        CHANCE,
    ),
    on_number(
        "",
        "self.started = self.now().nanoseconds",
        """age_ns = self.now().nanoseconds - self.started
                assert age_ns < 300_000_000, "too old"  # here""",
        "AssertionError",
        "run clock: now",
    ),
    on_number(
        "import math",
        "self.started_ns = self.clock.monotonic_ns()",
        """left_ns = 250_000_000 - (self.clock.monotonic_ns() - self.started_ns)
                self.status = f"{math.sqrt(left_ns):.1f}"  # here""",
        "ValueError",
        "run clock: monotonic",
    ),
]

CHANCE_KINDS = [
    on_number(
        "import random",
        "self.ways = {1: 'left', 2: 'right', 3: 'ahead', 4: 'back'}",
        "self.status = self.ways[random.randint(1, 6)]  # here",
        "KeyError",
        "random",
    ),
    on_number(
        "import random",
        "self.random = random.Random()",
        "assert self.random.gauss(0.0, 1.0) < 1.2  # here",
        "AssertionError",
        "random.Random without a seed",
        CHANCE,
    ),
    on_number(
        "import numpy as np",
        "pass",
        "assert np.random.rand(3, 3).max() < 0.97  # here",
        "AssertionError",
        "numpy.random",
    ),
    on_number(
        "import numpy as np",
        "self.random = np.random.default_rng()",
        "assert self.random.normal(size=3).max() < 1.5  # here",
        "AssertionError",
        "numpy default_rng without a seed",
        CHANCE,
    ),
    on_number(
        "from uuid import uuid4",
        "pass",
        'self.status = f"{int(str(uuid4())[:2])}"  # here',
        "ValueError",
        "uuid4",
        CHANCE,
    ),
    on_number(
        "import os",
        "pass",
        "self.status = os.urandom(4).decode()  # here",
        "UnicodeDecodeError",
        "os.urandom",
        CHANCE,
    ),
    on_number(
        "import secrets",
        "pass",
        'self.status = f"{int(secrets.token_hex(1))}"  # here',
        "ValueError",
        "secrets",
        CHANCE,
    ),
    on_number(
        "",
        "self.words: set[str] = set()",
        """self.words.add(f"word {number.value}")
                assert number.value < 5 or next(iter(self.words)) != f"word {number.value}"  # here""",
        "AssertionError",
        "hash order of a set of strings",
    ),
    on_number(
        "",
        "self.lanes = {n: f'lane {n}' for n in range(7)}",
        'self.status = self.lanes[hash(f"car {number.value}") % 8]  # here',
        "KeyError",
        "hash of a string",
    ),
]

TIME_KINDS = TICK_KINDS + CLOCK_KINDS + CHANCE_KINDS
