"""The end of `robbie run` says what was achieved, where the results are, and what became of every message."""

from pathlib import Path

import pytest

from robbie_mp.cli.run_summary import files
from tests._support.robot import Robot

MODULES = """
import time

import numpy as np

from robbie_mp import Module
from robbie_mp.messages import Image


class Source(Module):
    period_s = 0.002
    number = 0

    def tick(self):
        self.number += 1
        self.publish(Image(data=np.zeros(10, np.uint8)))
        if self.number == 300:
            self.stop()

    def teardown(self):
        (self.output_directory / "map.png").write_bytes(bytes(3000))
        self.show_state("DONE")
        self.status = "93 % explored, 3 of 4 victims found, and a line that is longer than eighty columns"


class Slow(Module):
    delay_s = 0.02

    def setup(self):
        self.subscribe(Image, self.on_image)

    def on_image(self, _image):
        time.sleep(self.delay_s)


class Quick(Slow):
    delay_s = 0.0


class Foreign(Module):
    # Publishes what only looks like an image, as a program with another version of the type does.
    period_s = 100.0

    def tick(self):
        self.publish_encoded(Image.type_name, Image.version, b"\\0\\1\\0\\0")
"""


@pytest.mark.slow
@pytest.mark.every_turn
def test_end_of_a_run_says_what_was_achieved_and_accounts_for_every_message(robot: Robot) -> None:
    (robot.folder / "search.py").write_text(MODULES)
    robot.write_profile(
        """
modules:
  quick: {class: "search:Quick"}
  source: {class: "search:Source", ends_run: true}
"""
    )
    ended = robot.command("run", "robot", "--output", "out")
    assert ended.returncode == 0, ended.stderr
    begin, *_ = ended.stderr.splitlines()
    assert begin == "robot: 2 modules; results in out; Ctrl-C ends the run"
    assert "the hot path runs in C" not in ended.stderr
    text = ended.stdout
    assert (
        "source: [DONE]  93 % explored, 3 of 4 victims found, and a line that is longer than eighty c" in text
    )
    assert "messages: 300 of 300 handled" in text
    assert "every message is accounted for" in text
    assert "exit code 0: the ru" not in text
    assert text.splitlines()[-1] == f"results: {robot.folder}/out: map.png (2.9K)"


@pytest.mark.slow
def test_module_that_missed_messages_has_a_line_of_its_own(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    (robot.folder / "search.py").write_text(MODULES)
    robot.write_profile(
        """
modules:
  quick: {class: "search:Quick"}
  slow: {class: "search:Slow", queue: {messages: 5}}
  source: {class: "search:Source", ends_run: true}
"""
    )
    monkeypatch.setenv("COLUMNS", "80")
    lines = robot.command("run", "robot").stdout.splitlines()
    head = next(number for number, line in enumerate(lines) if line.startswith("messages: "))
    assert lines[head].endswith("these were not handled:")
    assert lines[head + 1].startswith("    slow: ")
    assert lines[head + 1].endswith("dropped because it was too slow")
    assert lines[head + 2].startswith("run ended after")


@pytest.mark.slow
def test_messages_of_another_version_are_not_said_to_be_handled(robot: Robot) -> None:
    (robot.folder / "search.py").write_text(MODULES)
    robot.write_profile(
        """
modules:
  quick: {class: "search:Quick"}
  foreign: {class: "search:Foreign"}
  source: {class: "search:Source", ends_run: true}
"""
    )
    ended = robot.command("run", "robot")
    assert "    quick: 1 refused: ill-formed" in ended.stdout, ended.stderr
    assert "refused an ill-formed message, 1 of this kind: sensor_msgs/msg/Image" in ended.stderr


def test_folder_of_results_that_is_gone_is_said(tmp_path: Path) -> None:
    assert files(tmp_path / "gone") == " cannot be read any more (No such file or directory)"
