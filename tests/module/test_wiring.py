"""Topics renamed by the profile: the module's code does not see it, all others see the new names."""

from collections.abc import Callable
from contextlib import suppress

import pytest

from robbie_mp import EncodedMessage, Module, ModuleHarness
from robbie_mp.bus.transport.tables import ChannelName, takes_topic
from robbie_mp.messages import DriveCommand, Image, LaserScan, Odometry
from robbie_mp.module.harness import NotSubscribed
from robbie_mp.module.wiring import TopicsMeet, Wiring
from tests._support.robot import Ended, Robot, wait_until

SCAN = LaserScan.type_name


@pytest.mark.parametrize(
    ("own", "topics", "namespace", "actual"),
    [
        ("scan", {}, "", "scan"),
        ("scan", {"scan": "front"}, "", "front"),
        ("scan", {"other": "front"}, "", "scan"),
        ("scan", {"scan": ""}, "", ""),
        ("", {"": "front"}, "", "front"),
        ("", {}, "", ""),
        ("scan", {}, "red", "red/scan"),
        ("scan", {"scan": "front"}, "red", "red/front"),
        ("scan", {"scan": "/front"}, "red", "front"),
        ("/scan", {}, "red", "/scan"),
        ("", {}, "red", "red/"),
        ("", {"": "/"}, "red", ""),
        ("scan", {"scan": "scan2", "scan2": "scan"}, "", "scan2"),
        ("*", {}, "red", "red/*"),
    ],
)
def test_name_in_the_run(own: str, topics: dict[str, str], namespace: str, actual: str) -> None:
    wiring = Wiring(topics, namespace)
    assert wiring.actual(SCAN, own) == actual
    assert wiring.own(SCAN, actual) == own


def test_messages_about_the_run_keep_their_topics() -> None:
    wiring = Wiring({"mapping": "x"}, "red")
    assert wiring.actual("robbie_msgs/msg/SettingChange", "mapping") == "mapping"
    assert wiring.actual("robbie_msgs/msg/ModuleState", "") == ""


@pytest.mark.parametrize(
    ("type_name", "own", "actual"),
    [
        ("a/srv/Plan_Request", "call", "call/red"),
        ("a/srv/Plan_Request", "call/route", "call/red/way"),
        ("a/action/Go_Goal", "call/other", "call/red/other"),
        ("a/srv/Plan_Response", "planner", "planner"),
        ("a/action/Go_Feedback", "planner", "planner"),
        ("a/action/Go_Result", "planner", "planner"),
        ("robbie_msgs/msg/CallsQuestion", "planner", "planner"),
        ("a/msg/Plan", "call/route", "red/call/route"),
    ],
)
def test_services_are_renamed_and_answers_go_to_the_caller(type_name: str, own: str, actual: str) -> None:
    assert Wiring({"route": "way"}, "red").actual(type_name, own) == actual
    assert Wiring().actual(type_name, own) == own


def test_name_that_was_never_looked_up_is_translated_back_too() -> None:
    assert Wiring({"camera": "front"}, "red").own(SCAN, "red/front") == "camera"
    assert Wiring({}, "red").own(SCAN, "red/other") == "other"
    assert Wiring({}, "red").own(SCAN, "blue/other") == "blue/other"


def test_two_topics_of_different_types_may_get_the_same_name() -> None:
    wiring = Wiring({"left": "camera"})
    for type_name, own in ((SCAN, "left"), (Image.type_name, "camera")):
        assert wiring.subscribed(type_name, own) == "camera"
    wiring.actual(SCAN, "camera")  # what it publishes does not matter
    assert (wiring.own(SCAN, "camera"), wiring.own(Image.type_name, "camera")) == ("left", "camera")


@pytest.mark.parametrize(
    ("subscribed", "topic", "takes"),
    [
        ("", "any", True), ("red/", "red/", True), ("red/", "red/a/b", True), ("red/", "red", False),
        ("red/", "redder/a", False), ("red", "red/", False), ("red", "red", True),
    ],
)  # fmt: skip
def test_topic_with_a_slash_at_its_end_takes_all_below_it(subscribed: str, topic: str, takes: bool) -> None:
    assert takes_topic(subscribed, topic) is takes
    assert ChannelName(SCAN, 1, subscribed).takes(ChannelName(SCAN, 1, topic)) is takes


class Detector(Module):
    """Notes what it gets, with its own names of the topics, and answers on the same topic."""

    def setup(self) -> None:
        self.seen: list[str] = []
        self.subscribe(Image, self.on_image, topic="camera")
        self.subscribe(LaserScan, self.on_scan)
        self.subscribe_encoded("nav_msgs/*", self.on_bytes, topic="odo*")

    def on_image(self, _image: Image) -> None:
        self.seen.append(f"image {self.envelope.topic}")
        self.publish(DriveCommand(), topic="drive")
        self.publish(DriveCommand())
        self.publish_encoded(DriveCommand.type_name, 1, DriveCommand().encode(), topic="drive")
        with self.loan(LaserScan, topic="scan", ranges=3):
            pass

    def on_scan(self, _scan: LaserScan) -> None:
        self.seen.append(f"scan {self.envelope.topic}")

    def on_bytes(self, message: EncodedMessage) -> None:
        self.seen.append(f"bytes {self.envelope.topic}")


def test_module_sees_its_own_names_and_the_others_see_the_new_ones() -> None:
    wired = {"camera": "front/camera", "drive": "/drive"}
    with ModuleHarness(Detector, topics=wired, namespace="red") as harness:
        for topic in ("camera", "red/camera", "front/camera", "red/front/camera"):
            with suppress(NotSubscribed):
                harness.send(Image(), topic=topic)
        for topic in ("", "blue/laser", "red/", "red/laser"):
            with suppress(NotSubscribed):
                harness.send(LaserScan(), topic=topic)
        harness.send(Odometry(), topic="red/odom")
        with suppress(NotSubscribed):
            harness.send(Odometry(), topic="odom")
        assert harness.module.seen == ["image camera", "scan ", "scan laser", "bytes odom"]
        assert [one.topic for one in harness.published] == ["drive", "red/", "red/scan"]
        assert [one.topic for one in harness.published_encoded] == ["drive"]


class TwoCameras(Module):
    """Subscribes to two topics of one type."""

    def setup(self) -> None:
        self.subscribe(Image, print, topic="left")
        self.subscribe(Image, print, topic="right")


def test_two_subscriptions_cannot_get_the_same_name() -> None:
    with pytest.raises(TopicsMeet, match="calls both 'left' and 'right' of this module 'camera'"):
        ModuleHarness(TwoCameras, topics={"left": "camera", "right": "camera"}).__enter__()


TWO_ROBOTS = """
modules:
  red_listener: {class: 'zoo.modules:Listener', namespace: red}
  red_counter: {class: 'zoo.modules:Counter', settings: {count: 30}, namespace: red}
  blue_listener: {class: 'zoo.modules:Listener', namespace: blue}
  blue_counter: {class: 'zoo.modules:Counter', settings: {count: 40}, namespace: blue}
  all: {class: 'zoo.modules:Listener'}
"""


@pytest.mark.slow
@pytest.mark.parametrize("python_only", [False, True])
def test_two_copies_of_a_robot_in_one_run_do_not_hear_each_other(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, *, python_only: bool
) -> None:
    if python_only:
        monkeypatch.setenv("ROBBIE_PURE_PYTHON", "1")
    robot.write_profile(TWO_ROBOTS)
    process = robot.start()
    wait_until(lambda: len(robot.journal("all")) == 70)
    wait_until(lambda: len(robot.journal("red_listener")) == 30 and len(robot.journal("blue_listener")) == 40)
    listed = robot.command("list", "modules").stdout
    assert "'' → red/" in listed
    figures = robot.top()
    assert figures["red_listener"]["renamed"] == {"": "red/"}
    assert "renamed" not in robot.command("list", "topics").stdout
    process.send_signal(2)
    Ended.wait_for(process)
    assert robot.journal("red_listener") == list(range(30))
    assert robot.journal("blue_listener") == list(range(40))


RENAMED: Callable[[str], str] = """
modules:
  listener: {{class: 'zoo.wired:Hearer', topics: {{heard: {0}}}}}
  counter: {{class: 'zoo.wired:Talker', topics: {{said: shared, sayd: nothing}}}}
""".format
HEARER = """
from zoo.modules import Journal, Counter
from robbie_mp.messages import DriveCommand


class Hearer(Journal):
    def setup(self):
        self.subscribe(DriveCommand, self.on_command, topic="heard")

    def on_command(self, command):
        assert self.envelope.topic == "heard", self.envelope
        self.note(command.header.stamp.sec)


class Talker(Journal):
    period_s = 0.01
    number = 0

    def tick(self):
        from robbie_mp.messages import Header, Time
        self.publish(DriveCommand(header=Header(stamp=Time(sec=self.number))), topic="said")
        self.number += 1
"""


@pytest.mark.slow
@pytest.mark.every_turn
def test_two_modules_with_different_names_are_connected_by_the_profile(robot: Robot) -> None:
    (robot.folder / "zoo" / "wired.py").write_text(HEARER)
    robot.write_profile(RENAMED("shared"))
    process = robot.start()
    wait_until(lambda: len(robot.journal("listener")) > 3)
    topics = robot.command("list", "topics").stdout
    assert "shared" in topics
    assert "said" not in topics
    assert "said → shared" in robot.command("list", "modules").stdout
    process.send_signal(2)
    assert Ended.wait_for(process).exit_code == 0


@pytest.mark.slow
def test_topic_renamed_in_vain_is_a_warning_with_the_nearest_name(robot: Robot) -> None:
    (robot.folder / "zoo" / "wired.py").write_text(HEARER)
    robot.write_profile(RENAMED("shared"))
    process = robot.start()
    wait_until(lambda: "topics: counter has not used" in robot.log("supervisor"), 30)
    process.send_signal(2)
    Ended.wait_for(process)
    text = "modules.counter.topics: counter has not used a topic 'sayd' so far; did you mean 'said'?"
    assert text in robot.log("supervisor")


SERVICES = """
from robbie_mp import Module, Reply, Request, uint32


class Answer(Reply, name="zoo_msgs/srv/Ask_Response"):
    number: uint32


class Ask(Request[Answer], name="zoo_msgs/srv/Ask_Request"):
    number: uint32


class Server(Module):
    def setup(self):
        self.serve(Ask, self.on_ask, topic="served")

    def on_ask(self, request):
        return Answer(number=len(self.name) + request.number)


class Client(Module):
    period_s = 0.1

    def tick(self):
        self.call(Ask(number=100), self.on_reply, self.on_error, timeout_s=20.0, topic="asked")
        self.period_s = None

    def on_reply(self, reply):
        self.status = f"reply {reply.number}"

    def on_error(self, error):
        self.status = f"error {error}"
"""
TWO_SERVERS = """
modules:
  red_server: {class: 'zoo.services:Server', namespace: red}
  red_client: {class: 'zoo.services:Client', namespace: red, topics: {asked: served}}
  blue: {class: 'zoo.services:Server', namespace: blue}
  blue_client: {class: 'zoo.services:Client', namespace: blue, topics: {asked: served}}
  lost_client: {class: 'zoo.services:Client'}
"""


@pytest.mark.slow
def test_services_are_renamed_and_separated_like_topics(robot: Robot) -> None:
    (robot.folder / "zoo" / "services.py").write_text(SERVICES)
    robot.write_profile(TWO_SERVERS)
    process = robot.start()
    figures = robot.until(
        lambda modules: all(modules[name]["status"] for name in ("red_client", "blue_client", "lost_client"))
    )
    assert figures["red_client"]["status"] == "reply 110"
    assert figures["blue_client"]["status"] == "reply 104"
    assert figures["lost_client"]["status"].startswith("error Ask on topic 'asked': no module serves it")
    process.send_signal(2)
    Ended.wait_for(process)
