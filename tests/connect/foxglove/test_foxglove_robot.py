"""Foxglove's server in a run: latched topics, settings, what nobody reads, and who does not read."""

import json
import socket
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from robbie_mp.cli.foxglove import LAYOUT
from robbie_mp.connect.foxglove.frames import FrameCounter, greeting
from tests._support.robot import Robot
from tests.connect.foxglove._support.foxglove_client import PROTOCOL, Client, connected

MODULES = Path(__file__).parent / "_support" / "foxglove_modules.py"
PROFILE = """
parents: ["robbie:foxglove"]
modules:
  sign: {class: "crew.modules:Sign"}
  film: {class: "crew.modules:Film"}
  tunable: {class: "zoo.modules:Tunable"}
  foxglove: {settings: {port: 0, queue_messages: 8}, optional: false}
"""


def subscribed(modules: dict[str, Any], topic: str) -> dict[str, Any] | None:
    """The server's subscription to a topic."""
    rows = modules["foxglove"]["subscriptions"]
    return next((row for row in rows if row["topic"] == topic), None)


@pytest.fixture
def link(robot: Robot) -> str:
    """The link of a robot's server."""
    (robot.folder / "crew").mkdir()
    (robot.folder / "crew" / "__init__.py").write_text("")
    (robot.folder / "crew" / "modules.py").write_text(MODULES.read_text())
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda modules: modules["foxglove"]["status"] != "" and modules["film"]["published"] > 3)
    return robot.command("foxglove").stdout.strip()


@pytest.mark.slow
def test_robot_in_foxglove(robot: Robot, link: str) -> None:
    assert not [row for row in robot.top()["foxglove"]["subscriptions"] if row["topic"] == "film"]
    with connected(link) as early:
        early.subscribe("/sign")
        early.until(lambda: early.of("/sign"))
        with connected(link) as late:
            late.subscribe("/sign")
            late.until(lambda: late.of("/sign"))
            assert late.of("/sign")[0].decode().data == "this way"
        check_parameters(early)
        check_graph_and_log(early)
        early.subscribe("/film")
        early.until(lambda: len(early.of("/film")) > 2)
    assert robot.journal("tunable") == [1, 5]
    check_stopped_client(robot, link)


LATE = """
from robbie_mp import Message, float64
class Gas(Message, name="nose_msgs/msg/Gas"):
    ppm: float64
"""
LAZY = """
from pathlib import Path
from robbie_mp import Module
class Lazy(Module):
    period_s = 0.05
    def tick(self) -> None:
        if Path("is_asked").exists():
            from crew.late import Gas
            self.publish(Gas(ppm=1.0), topic="gas")
"""


@pytest.mark.slow
def test_a_type_that_a_client_describes_is_refused_if_the_code_of_the_robot_has_its_own(robot: Robot) -> None:
    crew = robot.folder / "crew"
    crew.mkdir()
    for name, text in (("__init__", ""), ("late", LATE), ("lazy", LAZY)):
        (crew / f"{name}.py").write_text(text)
    robot.write_profile(
        """
        parents: ["robbie:foxglove"]
        modules:
          lazy: {class: "crew.lazy:Lazy"}
          foxglove: {settings: {port: 0, accept: {/gas: nose_msgs/* gas}}, optional: false}
        """
    )
    robot.start()
    robot.until(lambda top: top["foxglove"]["status"] != "" and top["lazy"]["state"] == "RUNNING")
    with connected(robot.command("foxglove").stdout.strip()) as client:
        client.advertise(1, "/gas", "nose_msgs/Gas", schemaEncoding="ros2msg", schema="uint16 ppm")
        client.publish(1, b"\0\1\0\0\7\0")
        client.until(client.problems)
        assert "crew/late.py declares a type of that name" in client.problems()[0]
        (robot.folder / "is_asked").touch()
        top = robot.until(lambda top: top["lazy"]["published"] > 3)
        assert top["lazy"]["restarts"] == 0
        robot.until(lambda top: "1 refused" in top["foxglove"]["status"])


def check_parameters(client: Client) -> None:
    client.send("getParameters", parameterNames=[], id="all")
    client.until(lambda: client.parameters)
    assert client.parameters["tunable.gain"] == 1
    client.send("subscribeParameterUpdates", parameterNames=["tunable.gain"])
    client.send("setParameters", parameters=[{"name": "tunable.gain", "value": 5}])
    client.until(lambda: client.parameters["tunable.gain"] == 5)
    client.send("setParameters", parameters=[{"name": "tunable.gain", "value": 13}])
    client.until(lambda: any("brings bad luck" in problem for problem in client.problems()))
    client.send("setParameters", parameters=[{"name": "foxglove.port", "value": 1}])
    client.until(lambda: any("cannot change it" in problem for problem in client.problems()))


def check_graph_and_log(client: Client) -> None:
    client.subscribe("/rosout")
    client.until(lambda: any("Foxglove: ws://" in one.decode().msg for one in client.of("/rosout")))
    client.send("subscribeConnectionGraph")

    def published() -> dict[str, list[str]]:
        updates = [one for one in client.told if one["op"] == "connectionGraphUpdate"]
        topics = [topic for update in updates for topic in update["publishedTopics"]]
        return {topic["name"]: topic["publisherIds"] for topic in topics}

    client.until(lambda: published().get("/film") == ["film"])


def check_stopped_client(robot: Robot, link: str) -> None:
    """A client that reads nothing gets nothing more; the others get all, and the film goes on."""
    place = urlsplit(link)
    assert place.hostname and place.port
    with socket.create_connection((place.hostname, place.port)) as stopped, connected(link) as other:
        stopped.sendall(
            f"GET /?{place.query} HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            f"Sec-WebSocket-Protocol: {PROTOCOL}\r\n\r\n".encode()
        )
        other.subscribe("/film")
        stopped.sendall(client_frame(json.dumps(subscription(other))))
        robot.until(lambda modules: "dropped for slow clients" in modules["foxglove"]["status"])
        before = len(other.of("/film"))
        other.until(lambda: len(other.of("/film")) > before + 20)
        row = subscribed(robot.top(), "film")
    assert row is not None
    assert row["dropped"] == 0


def subscription(client: Client) -> dict[str, Any]:
    return {"op": "subscribe", "subscriptions": [{"id": 1, "channelId": client.channels["/film"]["id"]}]}


def client_frame(text: str) -> bytes:
    """A masked text frame with a mask of zeros."""
    assert len(text) < 126
    return b"\x81" + bytes([0x80 | len(text)]) + bytes(4) + text.encode()


def test_frames_with_messages_are_counted_however_they_are_cut() -> None:
    stream = b"".join(
        [
            b"\x82\x05\x01abcd",
            b"\x81\x02{}",
            b"\x82\x7e" + (300).to_bytes(2, "big") + b"\x01" + bytes(299),
            b"\x82\x7f" + (70000).to_bytes(8, "big") + b"\x01" + bytes(69999),
            b"\x89\x00",
            b"\x82\x03\x04ab",
            b"\x82\x01\x01",
        ]
    )
    for step in (1, 2, 7, 1000, len(stream)):
        counter = FrameCounter()
        for at in range(0, len(stream), step):
            counter.feed(stream[at : at + step])
        assert counter.messages == 4


def test_greeting_is_a_masked_frame() -> None:
    frame = greeting("/secret/7")
    size, mask = int.from_bytes(frame[2:4], "big"), frame[4:8]
    text = bytes(byte ^ mask[at % 4] for at, byte in enumerate(frame[8:]))
    assert (frame[0], frame[1], size) == (0x81, 0xFE, len(text))
    assert json.loads(text)["channels"][0]["topic"] == "/secret/7"


def test_layout_is_written_once(robot: Robot) -> None:
    said = robot.command("foxglove", "--layout", LAYOUT)
    assert said.returncode == 0
    layout = json.loads((robot.folder / LAYOUT).read_text())
    assert layout["configById"]["Teleop!robbie"]["topic"] == "/cmd_vel"
    assert robot.command("foxglove", "--layout", LAYOUT).returncode == 2
