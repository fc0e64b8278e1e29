"""Two robots, each a separate run on this machine, linked over loopback."""

import socket
from contextlib import closing
from pathlib import Path

from robbie_mp.bus.observe import RunObserver
from robbie_mp.bus.transport.segment import SegmentMissing
from robbie_mp.cli.runs import live_runs
from robbie_mp.messages import LinkState
from tests._support.robot import Robot, wait_until

MODULES = Path(__file__).with_name("robot_modules.py")
CLASSES = ("command", "state", "reliable", "bulk", "urgent")
SEND = """{
        urgent: ["String urgent", EmergencyStop], command: ["String command", DriveCommand],
        state: ["String state"], reliable: ["String reliable", OccupancyGrid], bulk: [Image]}"""
PROFILE = """
modules:
{modules}
  link:
    class: robbie_mp.connect.link.module:Link
    settings:
      robot: {name}
      listen: {listen}
      connect: {connect}
      robots: {robots}
      state_hz: 1000
      send: {send}
      accept: {accept}
    restart: {{policy: always, max_restarts: 10000, within_s: 60, backoff_s: 0.05}}
  counts: {{class: "crew.modules:Books"}}
"""


def free_port() -> int:
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        port: int = listening.getsockname()[1]
        return port


class Pair:
    """Robot `red` listens and sends; robot `blue` connects and receives.

    Args:
        robot: the workspace of both.
        red, blue: their modules besides the link, as lines of YAML.
        accept: what blue accepts.
        send: what red sends.
    """

    def __init__(self, robot: Robot, red: str, blue: str, accept: str = '{"*": ["*"]}', send: str = SEND):
        self.robot = robot
        crew = robot.folder / "crew"
        crew.mkdir()
        (crew / "__init__.py").write_text("")
        (crew / "modules.py").write_text(MODULES.read_text())
        self.address = f"tcp/127.0.0.1:{free_port()}"
        address = f"[{self.address}]"
        self._write("red", red, address, "[]", send, "{}")
        self._write("blue", blue, "[]", address, "{}", accept)

    def _write(self, name: str, modules: str, listen: str, connect: str, send: str, accept: str) -> None:
        text = PROFILE.format(
            modules=modules,
            name=name,
            listen=listen,
            connect=connect,
            robots="[blue]" if name == "red" else "[]",
            send=send,
            accept=accept,
        )
        self.robot.write_profile(text, name)

    def output(self, name: str) -> Path:
        """The output folder of a robot."""
        return self.robot.folder / f"out-{name}"

    def start(self, *names: str) -> None:
        """Start robots."""
        for name in names:
            self.robot.start("--another", profile=name, output=self.output(name))

    def pid(self, name: str, module: str = "link") -> int:
        """The process of a module; 0 if there is none now."""
        for run in live_runs():
            if run.record is not None and run.record.profile == name:
                try:
                    with closing(RunObserver(run.run_id)) as observer:
                        return next(one.pid for one in observer.modules() if one.name == module)
                except (SegmentMissing, StopIteration):
                    return 0
        return 0

    def numbers(self, name: str, journal: str) -> list[int]:
        """A journal of a robot."""
        path = self.output(name) / journal
        return [int(line) for line in path.read_text().split()] if path.exists() else []

    def state(self, name: str) -> LinkState | None:
        """The last state of a robot's link."""
        path = self.output(name) / "link.state"
        return LinkState.decode(path.read_bytes()) if path.exists() else None

    def wait_for_all(self, journal: str, count: int) -> None:
        """Wait until blue has received the last of red's messages."""
        wait_until(lambda: count in self.numbers("blue", f"got-{journal}"))
