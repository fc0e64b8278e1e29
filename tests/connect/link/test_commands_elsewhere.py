"""`robbie param`, `call`, `log` and `top` with --robot, over the link between two runs."""

import json
import signal
import subprocess
from collections.abc import Iterator
from subprocess import CompletedProcess

import pytest

from tests._support.left_behind import leaving_nothing_behind
from tests._support.robot import COMMAND, robot_in, wait_until
from tests.connect.link._support.pair import Pair

KITCHEN = """
from robbie_mp import CallRefused, Module, Reply, Request, float64, setting


class Cooked(Reply, name="kitchen/srv/Cook_Response"):
    eggs: float64


class Cook(Request[Cooked], name="kitchen/srv/Cook_Request"):
    eggs: float64


class Kitchen(Module):
    heat: float = setting(1.0, "of the stove", changeable=True, maximum=9.0)

    def setup(self):
        self.serve(Cook, self.on_cook)
        self.log.info("the stove is hot")

    def on_cook(self, request):
        if request.eggs < 0:
            raise CallRefused("there are no such eggs")
        return Cooked(eggs=request.eggs)
"""
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

ACCEPT = '{blue: ["ToolRequest param", "ToolRequest call", "ToolRequest log", "ToolRequest top"]}'


class Laptop:
    """Robot `red`, and a run `blue` that is linked with it."""

    def __init__(self, pair: Pair):
        self.pair = pair

    def robbie(self, *arguments: str, given: str | None = None) -> CompletedProcess[str]:
        """Run a command on the laptop, in a folder that knows nothing of red."""
        command = [*COMMAND, *arguments, "--run", "blue"]
        return subprocess.run(
            command, cwd="/", input=given, capture_output=True, text=True, timeout=60, check=False
        )


@pytest.fixture(autouse=True)
def nothing_left_behind() -> None:
    """Both runs are shared by the tests of this file, and looked at when they have ended."""


@pytest.fixture(scope="module")
def laptop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Laptop]:
    with leaving_nothing_behind(), robot_in(tmp_path_factory.mktemp("two")) as robot:
        (robot.folder / "kitchen.py").write_text(KITCHEN)
        pair = Pair(robot, '  kitchen: {class: "kitchen:Kitchen"}', "")
        pair._write("red", '  kitchen: {class: "kitchen:Kitchen"}', f"[{pair.address}]", "[]", "{}", ACCEPT)
        pair.start("red", "blue")
        wait_until(lambda: any(peer.is_up for state in [pair.state("blue")] if state for peer in state.peers))
        yield Laptop(pair)


def test_parameters_of_a_robot_are_read_and_set_from_the_laptop(laptop: Laptop) -> None:
    assert laptop.robbie("param", "get", "kitchen.heat", "--robot", "red").stdout == "1.0\n"
    done = laptop.robbie("param", "set", "kitchen.heat", "2.5", "--robot", "red")
    assert (done.returncode, done.stdout) == (0, "kitchen.heat is 2.5, was 1.0\n"), done.stderr
    wrong = laptop.robbie("param", "set", "kitchen.heat", "99", "--robot", "red")
    assert wrong.returncode == 1
    assert "kitchen refuses" in wrong.stderr
    near = laptop.robbie("param", "get", "kitchn.heat", "--robot", "red")
    assert (near.returncode, near.stderr) == (1, "no module is named 'kitchn'; did you mean 'kitchen'?\n")
    given = "modules: {kitchen: {settings: {heat: 3.0}}}"
    assert (
        "1 of 1 settings changed" in laptop.robbie("param", "load", "-", "--robot", "red", given=given).stdout
    )
    assert "heat: 3.0" in laptop.robbie("param", "dump", "--robot", "red").stdout


def test_services_of_a_robot_are_called_without_their_types_here(laptop: Laptop) -> None:
    done = laptop.robbie("call", "Cook", "{eggs: 2}", "--json", "--robot", "red")
    assert (done.returncode, json.loads(done.stdout or "{}")) == (0, {"eggs": 2.0}), done.stderr
    refused = laptop.robbie("call", "Cook", "{eggs: -2}", "--robot", "red")
    assert refused.returncode == 1
    assert "there are no such eggs" in refused.stderr


def test_log_and_figures_of_a_robot_are_read_from_the_laptop(laptop: Laptop) -> None:
    said = laptop.robbie("log", "--module", "kitchen", "--robot", "red")
    assert "the stove is hot" in said.stdout, said.stderr
    figures = json.loads(laptop.robbie("top", "--json", "--robot", "red").stdout)
    assert {"kitchen", "link"} <= {module["name"] for module in figures["modules"]}
    assert figures["profile"] == "red"


def test_figures_come_again_and_again_until_ctrl_c(laptop: Laptop) -> None:
    command = [*COMMAND, "top", "--interval", "100ms", "--run", "blue", "--robot", "red"]
    with subprocess.Popen(command, cwd="/", stdout=subprocess.PIPE, text=True) as shown:
        assert shown.stdout is not None
        heads = (line for line in shown.stdout if "messages" in line or "routed" in line)
        for _ in range(3):
            next(heads)
        shown.send_signal(signal.SIGINT)
        shown.communicate(timeout=30)
        assert shown.returncode == 130


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("param", "list", "--robot", "green"), "green cannot be reached; the link says: red "),
        (("log", "/tmp", "--robot", "red"), "/tmp would be a file on the robot"),
        (("param", "dump", "/tmp/x.yaml", "--robot", "red"), "would be a file on the robot; write -"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    laptop: Laptop, arguments: tuple[str, ...], said: str
) -> None:
    ended = laptop.robbie(*arguments)
    assert ended.returncode in (1, 2)
    assert said in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
