"""`robbie connect` and `robbie list --remote`, with a robot on this machine."""

import json
from pathlib import Path

import pytest

from tests._support.robot import Robot, wait_until
from tests.connect.link._support.pair import Pair

RED = '  talker: {class: "crew.modules:Talker"}'
WITNESS = '  listener: {class: "crew.modules:Listener"}'


@pytest.mark.slow
def test_a_laptop_finds_a_robot_and_sees_what_it_sends(robot: Robot) -> None:
    pair = Pair(robot, RED, WITNESS)
    pair.start("red")
    wait_until(lambda: len(pair.numbers("red", "sent-state")) > 0)
    listed = robot.command("list", "--remote", "--at", pair.address, "--json")
    assert json.loads(listed.stdout) == ["red"], listed.stderr
    laptop = pair.output("laptop")
    robot.start(
        "--at", pair.address, "--as", "laptop", "--without", "operator",
        profile="red", output=laptop, command=("connect",),
    )  # fmt: skip
    wait_until(lambda: any(peer.is_up for state in [pair.state("red")] if state for peer in state.peers))


@pytest.mark.slow
def test_a_robot_must_have_another_name_than_this_side(robot: Robot) -> None:
    ended = robot.command("connect", "red", "--as", "red")
    assert ended.returncode == 2
    assert "name this one with --as" in ended.stderr
    assert "cannot be called" in robot.command("connect", "red/blue").stderr


@pytest.mark.slow
def test_keys_and_encrypted_addresses_belong_together(robot: Robot, tmp_path: Path) -> None:
    ended = robot.command("list", "--remote", "--at", "tls/127.0.0.1:9")
    assert ended.returncode == 2
    assert "tls/127.0.0.1:9 needs keys" in ended.stderr
    keys = ("--keys", str(tmp_path / "keys"))
    assert "write tls/127.0.0.1:9" in robot.command("connect", "red", "--at", "tcp/127.0.0.1:9", *keys).stderr
    assert "robbie keys new" in robot.command("list", "--remote", "--at", "tls/127.0.0.1:9", *keys).stderr


@pytest.mark.slow
def test_no_robot_is_listed_where_none_is(robot: Robot) -> None:
    ended = robot.command("list", "--remote", "--at", "tcp/127.0.0.1:9")
    assert ended.stdout == "no robot can be reached at tcp/127.0.0.1:9\n"
