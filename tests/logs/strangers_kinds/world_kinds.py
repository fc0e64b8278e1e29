"""Crashes by what is outside the module: devices, files, the environment, threads and processes."""

from tests.logs.strangers_kinds.kind import CHANCE, Kind
from tests.logs.strangers_kinds.time_kinds import on_number

PTY = """
import os
import pty
import tty
from pathlib import Path

from robbie_mp import Module


class Feeder(Module):
    period_s = 0.02

    def setup(self) -> None:
        self.count = 0
        self.mine, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        port = Path("port")
        port.unlink(missing_ok=True)
        port.symlink_to(os.ttyname(self.theirs))

    def tick(self) -> None:
        self.count += 1
        sign = SIGN if self.count == 15 else b""
        os.write(self.mine, b"range 9" + sign + bytes([48 + self.count % 10, 10]))

    def teardown(self) -> None:
        Path("port").unlink(missing_ok=True)
"""

DEVICE = """
from robbie_robots.hw.connection.device import PluggableDevice
from robbie_robots.hw.connection.port import Port


class Ranger(PluggableDevice[int]):
    def _start(self, port: Port) -> None:
        port.write(b"start")
        self.rest = b""

    def _take(self, data: bytes) -> list[int]:
        *lines, self.rest = (self.rest + data).split(b"\\n")
        return [int(line.removeprefix(b"range ")) for line in lines if line.startswith(b"range")]  # here

    def _reset(self) -> None:
        self.rest = b""

    def _stop(self) -> None:
        pass
"""

WORLD_KINDS = [
    Kind(
        "bytes of a device, by hw/connection",
        "ValueError",
        """
        from hw.ranger import Ranger
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.ranger = Ranger("port")

            def tick(self) -> None:
                for value in self.ranger.poll():
                    self.status = f"{value}"

            def teardown(self) -> None:
                self.ranger.close()
        """,
        feeder=PTY.replace("SIGN", 'b"?"'),
        files={"hw/__init__.py": "", "hw/ranger.py": DEVICE},
    ),
    Kind(
        "bytes of a port, by hw/connection",
        "UnicodeDecodeError",
        """
        from robbie_mp import Module
        from robbie_robots.hw.connection.port import Port, PortError


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.port: Port | None = None

            def tick(self) -> None:
                if self.port is None:
                    try:
                        self.port = Port("port")
                    except PortError as error:
                        self.status = f"{error}"
                        return
                self.status = self.port.read(0.01).decode()  # here
        """,
        feeder=PTY.replace("SIGN", r'b"\xff"'),
    ),
    Kind(
        "bytes of a device, by os.read",
        "ValueError",
        """
        import os

        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.port = -1

            def tick(self) -> None:
                if self.port == -1:
                    if not os.path.exists("port"):
                        return
                    self.port = os.open("port", os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                try:
                    data = os.read(self.port, 100)
                except BlockingIOError:
                    return
                for line in data.split():
                    if line != b"range":
                        self.status = f"{int(line)}"  # here
        """,
        feeder=PTY.replace("SIGN", 'b"?"'),
        why_not=CHANCE,
    ),
    Kind(
        "packet of a socket",
        "JSONDecodeError",
        """
        import json
        import socket

        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self.socket.setblocking(False)
                self.socket.bind(("127.0.0.1", 0))
                with open("udp_port", "w") as file:
                    file.write(f"{self.socket.getsockname()[1]}")

            def tick(self) -> None:
                try:
                    while True:
                        self.status = f"{json.loads(self.socket.recv(1000))}"  # here
                except BlockingIOError:
                    pass
        """,
        feeder="""
        import socket
        from pathlib import Path

        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.05

            def setup(self) -> None:
                self.count = 0
                self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

            def tick(self) -> None:
                if Path("udp_port").exists():
                    self.count += 1
                    data = b"[1, 2" if self.count == 6 else b"[1, 2]"
                    self.socket.sendto(data, ("127.0.0.1", int(Path("udp_port").read_text())))
        """,
        why_not=CHANCE,
    ),
    Kind(
        "file of the workspace",
        "KeyError",
        """
        import json
        from pathlib import Path

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.words = json.loads(Path("data/words.json").read_text())
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = self.words[number.word]  # here
        """,
        files={"data/words.json": '{"w0": "nought", "w1": "one", "w2": "two"}'},
    ),
    Kind(
        "file that the module itself writes",
        "RuntimeError",
        """
        from pathlib import Path

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.file = Path("numbers.txt")
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                with self.file.open("a") as file:
                    file.write(f"{number.value}\\n")
                if len(self.file.read_text().split()) == 9:
                    raise RuntimeError("the file is full")  # here
        """,
        why_not=CHANCE,
    ),
    Kind(
        "file that another module writes",
        "ValueError",
        """
        from pathlib import Path

        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.file = Path("speed.txt")

            def tick(self) -> None:
                if self.file.exists():
                    self.status = f"{float(self.file.read_text() or 0)}"  # here
        """,
        feeder="""
        from pathlib import Path

        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.05

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                Path("speed.txt").write_text("fast" if self.count == 8 else f"{self.count}")

            def teardown(self) -> None:
                Path("speed.txt").unlink(missing_ok=True)
        """,
        why_not=CHANCE,
    ),
    Kind(
        "environment variable",
        "ValueError",
        """
        import os

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.level = os.environ.get("STRANGE_LEVEL", "3")
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = f"{int(self.level) + number.value}"  # here
        """,
        environment={"STRANGE_LEVEL": "high"},
        why_not=CHANCE,
    ),
    Kind(
        "own thread, its error raised in a tick",
        "ZeroDivisionError",
        """
        from threading import Event, Thread

        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.ended = Event()
                self.error: Exception | None = None
                self.thread = Thread(target=self.read, daemon=True)
                self.thread.start()

            def read(self) -> None:
                try:
                    for left in range(10, -1, -1):
                        self.ended.wait(0.02)
                        self.speed = 1 / left  # here
                except Exception as error:
                    self.error = error

            def tick(self) -> None:
                if self.error:
                    raise self.error
        """,
        why_not=CHANCE,
    ),
    Kind(
        "own thread that reads what messages say",
        "KeyError",
        """
        from queue import Empty, SimpleQueue
        from threading import Thread

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.names = {f"w{n}": "name" for n in range(6)}
                self.tasks: SimpleQueue[str] = SimpleQueue()
                self.results: SimpleQueue[str | Exception] = SimpleQueue()
                Thread(target=self.work, daemon=True).start()
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.tasks.put(number.word)

            def work(self) -> None:
                while True:
                    try:
                        self.results.put(self.names[self.tasks.get()])  # here
                    except KeyError as error:
                        self.results.put(error)

            def tick(self) -> None:
                try:
                    result = self.results.get_nowait()
                except Empty:
                    return
                if isinstance(result, Exception):
                    raise result
                self.status = result
        """,
        why_not=CHANCE,
    ),
    on_number(
        "from concurrent.futures import ThreadPoolExecutor",
        "self.pool = ThreadPoolExecutor(2)",
        """self.status = f"{self.pool.submit(self.half, number.value).result()}"

            def half(self, value: float) -> float:
                return 1 / (6 - value)  # here""",
        "ZeroDivisionError",
        "worker of a pool of threads",
    ),
    on_number(
        "import subprocess",
        "pass",
        """if number.value > 5:
                    subprocess.run(["false"], check=True)  # here""",
        "CalledProcessError",
        "other program",
    ),
]
