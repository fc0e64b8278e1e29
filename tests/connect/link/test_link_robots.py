"""Two robots, each a run of this machine, exchange messages over loopback."""

import json
import time

import pytest

from robbie_mp.cli.runs import live_runs
from robbie_mp.messages import LinkState
from tests._support.robot import Robot, kill, wait_until
from tests.connect.link._support.pair import CLASSES, Pair

COUNT = 60
RED = f'  talker: {{class: "crew.modules:Talker", settings: {{count: {COUNT}}}}}'
BLUE = '  listener: {class: "crew.modules:Listener"}'
LAPTOP = """
modules:
  link:
    class: robbie_mp.connect.link.module:Link
    settings: {{robot: blue, listen: [], connect: [{address}], accept: {{red: ["*"]}}}}
"""


@pytest.mark.slow
def test_messages_of_every_class_cross_in_order_and_the_books_balance(robot: Robot) -> None:
    pair = Pair(robot, RED, BLUE)
    pair.start("red", "blue")
    for journal in ("reliable", "urgent", "bulk"):
        pair.wait_for_all(journal, COUNT)
    for journal in CLASSES:
        found = pair.numbers("blue", f"got-{journal}")
        assert found == sorted(set(found))
    assert pair.numbers("blue", "got-map")[-1] == 7
    wait_until(lambda: counted(pair) == {one: len(pair.numbers("blue", f"got-{one}")) for one in CLASSES})
    wait_until(lambda: all(under_way == 0 for *_, under_way in counts(pair)))
    (peer,) = state(pair).peers
    assert peer.robot == "blue"
    assert peer.is_up
    assert 0 < peer.round_trip_s < 1


@pytest.mark.slow
def test_a_killed_link_continues_without_duplicates(robot: Robot) -> None:
    pair = Pair(robot, RED.replace(str(COUNT), "300"), BLUE)
    pair.start("red", "blue")
    wait_until(lambda: len(pair.numbers("blue", "got-reliable")) > 20)
    kill(pair.pid("blue"))
    wait_until(lambda: len(pair.numbers("red", "sent-reliable")) > 120)
    kill(pair.pid("red"))
    pair.wait_for_all("reliable", 300)
    for journal in CLASSES:
        found = pair.numbers("blue", f"got-{journal}")
        assert found == sorted(set(found)), journal


@pytest.mark.slow
def test_what_is_not_accepted_is_refused_and_counted(robot: Robot) -> None:
    pair = Pair(robot, RED, BLUE, accept='{red: ["String state"]}')
    pair.start("red", "blue")
    wait_until(lambda: COUNT in pair.numbers("blue", "got-state"))
    wait_until(lambda: (found := pair.state("blue")) is not None and found.refused >= COUNT)
    for journal in ("command", "reliable", "bulk", "urgent"):
        assert pair.numbers("blue", f"got-{journal}") == []


def state(pair: Pair) -> LinkState:
    found = pair.state("red")
    assert found is not None
    return found


def counts(pair: Pair) -> list[tuple[str, int, int, int]]:
    """Topic, sent, received and under way of each channel that red sends."""
    found = pair.state("red")
    channels = [one for one in found.channels if one.is_sent] if found is not None else []
    for one in channels:
        assert one.sent == one.received + one.replaced + one.dropped + one.lost + one.under_way
    return [(one.topic, one.sent, one.received, one.under_way) for one in channels]


def counted(pair: Pair) -> dict[str, int]:
    """How many messages of each topic blue has received, by red's counts."""
    return {topic: received for topic, _, received, _ in counts(pair) if topic in CLASSES}


@pytest.mark.slow
def test_own_types_of_a_robot_are_known_on_a_laptop_without_their_classes(robot: Robot) -> None:
    pair = Pair(robot, '  sampler: {class: "crew.modules:Sampler"}', "", send='{state: ["*"]}')
    robot.write_profile(LAPTOP.format(address=pair.address), "laptop")
    pair.start("red", "laptop")
    wait_until(lambda: len(live_runs()) == 2)
    run = ("--run", next(one.run_id for one in live_runs() if one.record and one.record.profile == "laptop"))
    wait_until(lambda: "crew/msg/Sample" in robot.command("list", "types", *run).stdout)
    echoed = robot.command("echo", "soil", "--once", "--json", *run)
    assert json.loads(echoed.stdout)["message"] == {"moisture_percent": 12.5}, echoed.stderr
    exported = robot.folder / "exported"

    def is_exported() -> bool:  # on a busy machine, a recording may end before its first message
        done = robot.command("record", "--duration", "0.5", "-o", f"recorded{time.monotonic_ns()}", *run)
        assert done.returncode == 0, done.stderr
        newest = max(path.name for path in robot.folder.glob("recorded*"))
        done = robot.command("export", newest, "exported", "--topics", "soil")
        assert done.returncode == 0, done.stderr
        return exported.exists()

    wait_until(is_exported)
    assert "12.5" in next(exported.iterdir()).read_text()
