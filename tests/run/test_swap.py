"""`robbie module swap` exchanges a module's code without losing a message, and puts back what dies."""

import importlib
import json
import sys
import threading
from pathlib import Path

import pytest

from robbie_mp.run.control import ControlRefused, control, converse
from robbie_mp.run.variant import InvalidVariant, Variant, put_first
from tests._support.robot import Robot, kill

SOURCE = """
from robbie_mp import Message, Module, int64


class Number(Message, name="swap/msg/Number", version=1):
    value: int64


class Source(Module):
    period_s = 0.005
    count = 0

    def tick(self):
        self.count += 1
        self.publish(Number(value=self.count))
"""
ADDER = """
from robbie_mp import Module, setting
from source import Number


class Adder(Module):
    factor: int = setting(1, "what each number is multiplied by")

    def setup(self):
        self.count, self.last, self.gaps = self.restored or (0, 0, 0)
        self.subscribe(Number, self.on_number)

    def on_number(self, number):
        self.gaps += number.value != self.last + 1
        self.last = number.value
        self.count += 1
        self.checkpoint((self.count, self.last, self.gaps))
        self.status = f"FIRST x{self.factor} {self.count} numbers, {self.gaps} gaps"
"""
PROFILE = """
modules:
  source: {class: "source:Source"}
  adder: {class: "adder:Adder", essential: true, restart: {policy: never}}
"""
MENDED = ADDER.replace("FIRST", "SECOND")


@pytest.fixture
def adding(robot: Robot) -> Robot:
    """A robot whose adder counts the numbers that it gets, and those that it missed."""
    (robot.folder / "source.py").write_text(SOURCE)
    (robot.folder / "adder.py").write_text(ADDER)
    (robot.folder / "mended").mkdir()
    (robot.folder / "mended" / "adder.py").write_text(MENDED)
    robot.write_profile(PROFILE)
    robot.start()
    robot.until(lambda top: "FIRST" in top["adder"]["status"])
    return robot


def counted(status: str) -> int:
    return int(status.split()[2])


def variant(robot: Robot, name: str, code: str) -> str:
    path = robot.folder / f"{name}.py"
    path.write_text(code)
    return str(path)


@pytest.mark.slow
def test_swap_and_back_lose_no_message_and_hand_over_the_checkpoint(adding: Robot) -> None:
    swapped = adding.command("module", "swap", "adder", "--with", "mended", "--set", "factor=3")
    assert swapped.returncode == 0, swapped.stderr
    assert "it runs the code of" in swapped.stdout
    assert swapped.stdout.endswith("messages that it missed meanwhile: none\n")
    second = adding.until(lambda top: "SECOND x3" in top["adder"]["status"])["adder"]
    assert second["status"].endswith(" 0 gaps")

    back = adding.command("module", "swap", "adder", "--back")
    assert (back.returncode, back.stderr) == (0, "")
    first = adding.until(lambda top: "FIRST x1" in top["adder"]["status"])["adder"]
    assert first["status"].endswith(" 0 gaps")
    assert counted(first["status"]) > counted(second["status"])
    assert adding.command("module", "swap", "adder", "--back").stderr == (
        "adder has not been swapped: it runs the code and settings of the profile\n"
    )


@pytest.mark.slow
def test_code_that_is_wrong_or_dies_is_put_back_and_said(adding: Robot) -> None:
    pid = adding.top()["adder"]["pid"]
    for code, said in {
        "class Adder(Module)\n": "SyntaxError: expected ':'",
        "x = 1\n": "has no class 'Adder'",
        MENDED.replace("factor: int", "other: int"): "factor",
        "raise SystemExit(3)\n": "SystemExit",
    }.items():
        wrong = adding.command("module", "swap", "adder", "--with", variant(adding, "wrong", code))
        assert (wrong.returncode, wrong.stdout) == (2, "")
        assert said in wrong.stderr
    assert adding.top()["adder"]["pid"] == pid, "what runs well was not touched"

    for code, said in {
        MENDED.replace("self.count +=", "self.numbers +="): "exit code 1",
        MENDED.replace("self.subscribe", "__import__('os')._exit(0); self.subscribe"): "before it was ready",
        MENDED.replace("self.gaps +=", "self.stop(); self.gaps +="): "exit code 0",
    }.items():
        dead = adding.command("module", "swap", "adder", "--with", variant(adding, "dead", code))
        assert (dead.returncode, dead.stdout) == (1, "")
        assert said in dead.stderr
        assert "is put back; it is RUNNING again" in dead.stderr
        adding.until(lambda top: "FIRST" in top["adder"]["status"] and top["adder"]["state"] == "RUNNING")


@pytest.mark.slow
def test_checkpoint_that_the_old_code_cannot_use_is_left_out_when_it_is_put_back(adding: Robot) -> None:
    code = MENDED.replace("self.checkpoint((self.count, self.last, self.gaps))", "self.checkpoint(7); 1/0")
    dead = adding.command("module", "swap", "adder", "--with", variant(adding, "foreign", code))
    assert dead.returncode == 1
    assert "it is RUNNING again" in dead.stderr
    adding.until(lambda top: "FIRST" in top["adder"]["status"] and top["adder"]["state"] == "RUNNING")
    assert "starts fresh" in adding.log("adder")


@pytest.mark.slow
def test_two_swaps_at_once_are_not_mixed_and_a_killed_one_is_put_back(adding: Robot) -> None:
    folder = adding.known_run().folder
    first = {"code": str(adding.folder / "mended"), "settings": {"factor": 2}}
    request = {"command": "swap", "module": "adder", "variant": first, "fresh": False}
    answers: list[dict[str, str]] = []

    def ask() -> None:
        connection, answer = converse(folder, request)
        connection.close()
        answers.append(answer)

    asking = threading.Thread(target=ask)
    asking.start()
    figures = adding.until(lambda top: "SECOND x2" in top["adder"]["status"])
    with pytest.raises(ControlRefused, match="adder is being swapped"):
        control(folder, "swap", "adder", variant={"settings": {"factor": 5}}, fresh=False)
    kill(figures["adder"]["pid"])
    asking.join()
    assert "killed by SIGKILL" in answers[0]["error"], answers
    adding.until(lambda top: "FIRST x1" in top["adder"]["status"])


@pytest.mark.slow
def test_code_on_trial_that_ends_the_run_ends_it(robot: Robot) -> None:
    (robot.folder / "source.py").write_text(SOURCE)
    robot.write_profile('modules: {source: {class: "source:Source", ends_run: true}}')
    process = robot.start()
    robot.until(lambda top: top["source"]["state"] == "RUNNING")
    ending = variant(robot, "ending", SOURCE.replace("self.count += 1", "self.stop()"))
    assert robot.command("module", "swap", "source", "--with", ending).returncode == 1
    assert process.wait(20) == 0


@pytest.mark.slow
def test_module_that_is_stopped_on_trial_starts_again_with_what_ran_before(adding: Robot) -> None:
    request = {"command": "swap", "module": "adder", "variant": {"settings": {"factor": 2}}, "fresh": False}
    answers: list[dict[str, str]] = []

    def ask() -> None:
        connection, answer = converse(adding.known_run().folder, request)
        connection.close()
        answers.append(answer)

    asking = threading.Thread(target=ask)
    asking.start()
    adding.until(lambda top: "x2" in top["adder"]["status"])
    assert adding.command("module", "stop", "adder").returncode == 0
    asking.join()
    assert "stopped before its trial was over" in answers[0]["error"]
    assert adding.command("module", "start", "adder").returncode == 0
    adding.until(lambda top: "FIRST x1" in top["adder"]["status"])


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (7, "no variant"),
        ({"code": 3}, "no variant"),
        ({"code": "/no/such/place"}, "no folder or file"),
        ({"code": json.dumps("x")}, "no folder or file"),
    ],
)
def test_what_is_no_variant_is_refused(value: object, said: str) -> None:
    with pytest.raises(InvalidVariant, match=said):
        Variant.of(value)


def test_file_takes_the_place_of_one_module_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "swapped_package"
    package.mkdir()
    for name in ("__init__", "one", "two"):
        (package / f"{name}.py").write_text("text = 'old'\n")
    (tmp_path / "new.py").write_text("text = 'new'\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    put_first(str(tmp_path / "new.py"), "swapped_package.one:Class")
    try:
        assert importlib.import_module("swapped_package.one").text == "new"
        assert importlib.import_module("swapped_package.two").text == "old"
    finally:
        for name in [name for name in sys.modules if name.startswith("swapped_package")]:
            del sys.modules[name]
