"""Takes the pictures of RViz in docs/images: `python -m tools.pictures.ros1 [ros1 | rescue-ros1]`.

The tool starts roscore, the robot of the profile, and RViz on a display without a screen. It clicks into RViz
as you do: an initial pose, then a goal. It prints what RViz published and what modules of the robot got, and
fails if these differ. It needs ROS 1 with RViz, Xvfb, xdotool and pillow:
apt-get install -y --no-install-recommends rviz xvfb xdotool
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import yaml
from PIL import Image, ImageGrab

from tools.robot import COMMAND, REPOSITORY, Robot
from tools.ros1.ros import Ros

SCREEN = "1280x800x24"
LOADED_S = 15.0
"""Time for which RViz runs before it is clicked."""
CLICK_S = 0.6
DRIVEN_S = 0.6
"""Time between the goal and the picture."""
LIMIT_S = 240.0
COLOURS = 128
CLICKED = {"/initialpose": ("initial_pose", "p"), "/move_base_simple/goal": ("goal", "g")}
"""What RViz publishes, the robot's topic that then has it, and the key for it in RViz."""
Pixel = tuple[int, int]
Heard = tuple["subprocess.Popen[str]", "subprocess.Popen[str]"]
"""Print what comes on a topic of ROS, and on one of the robot."""


@dataclass(frozen=True)
class Scene:
    """A picture.

    Attributes:
        picture: its file.
        config: the configuration of RViz.
        options: of RViz.
        goal: where RViz is clicked.
        victims: number of victims that the robot finds first; then its mission is paused.
    """

    picture: Path
    config: str
    options: tuple[str, ...]
    goal: Pixel
    victims: int = 0


SCENES = {
    "ros1": Scene(Path("docs/images/rviz.png"), "hw/robots/demo.rviz", ("--fullscreen",), (880, 330)),
    "rescue-ros1": Scene(Path("docs/images/rviz-rescue.png"), "hw/robots/rescue.rviz", (), (640, 520), 3),
}


class WrongInRobot(RuntimeError):
    """The robot did not get what RViz has published."""


def main() -> int:
    """Take the pictures."""
    parser = argparse.ArgumentParser(prog="python -m tools.pictures.ros1", description=__doc__)
    parser.add_argument("profiles", nargs="*", metavar="PROFILE", help="ros1, rescue-ros1 (both)")
    for profile in parser.parse_args().profiles or SCENES:
        take(profile, SCENES[profile])
    return 0


def take(profile: str, scene: Scene) -> None:
    """Take one picture.

    Raises:
        WrongInRobot: a goal or pose of RViz is not what the robot got.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="robbie-rviz-")))
        ros = stack.enter_context(closing(Ros(folder)))
        ros.start()
        arguments = (profile, "--set", f"ros1.master={ros.uri}")
        robot = stack.enter_context(closing(Robot(folder / "run", REPOSITORY, *arguments)))
        robot.wait_until_running()
        display = stack.enter_context(_screen())
        environment = {**ros.environment, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
        stack.enter_context(_running(["rviz", "-d", scene.config, *scene.options], environment))
        heard = _listen(stack, ros, robot)
        time.sleep(LOADED_S)
        if scene.victims:
            _find_victims(robot, scene.victims)
        _click_and_compare(heard, display, scene.goal)
        time.sleep(DRIVEN_S)
        taken = ImageGrab.grab(xdisplay=display)
        robot.stop()
    taken.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(scene.picture, optimize=True)


@contextlib.contextmanager
def _running(
    command: list[str], environment: dict[str, str], stdout: int | None = None
) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(command, cwd=REPOSITORY, env=environment, text=True, stdout=stdout)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextlib.contextmanager
def _screen() -> Iterator[str]:
    """Run a display without a screen; yield its name."""
    reader, writer = os.pipe()
    command = ["Xvfb", "-displayfd", str(writer), "-screen", "0", SCREEN, "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[writer], stderr=subprocess.DEVNULL)
    try:
        yield f":{os.read(reader, 20).decode().strip()}"
    finally:
        server.kill()
        server.wait()


def _robbie(robot: Robot, *arguments: str) -> str:
    done = subprocess.run(
        [*COMMAND, *arguments],
        env=robot.environment,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    return done.stdout


def _find_victims(robot: Robot, victims: int) -> None:
    """Wait until the robot has seen victims, and pause its mission, so that it drives to goals of RViz."""
    found: set[int] = set()
    while len(found) < victims:
        found.add(yaml.safe_load(_robbie(robot, "echo", "VictimFound", "--once"))["id"])
    _robbie(robot, "call", "OrderMission", "{order: 1}")


def _click_and_compare(heard: dict[str, Heard], display: str, at: Pixel) -> None:
    """Set an initial pose and a goal in RViz, and wait until the robot has got both."""
    for topic, (name, key) in CLICKED.items():
        published, got = heard[topic]
        _drag(display, key, at)
        said = yaml.safe_load(published.communicate(timeout=LIMIT_S)[0].partition("---")[0])
        pose = said["pose"].get("pose", said["pose"])
        print(f"RViz published on {topic}: {pose['position']}, {pose['orientation']}", flush=True)
        limit = threading.Timer(LIMIT_S, got.kill)
        limit.start()
        assert got.stdout is not None
        if not any(json.loads(line)["message"]["pose"] == pose for line in got.stdout):
            raise WrongInRobot(f"the robot's topic {name} never had it")
        limit.cancel()


def _listen(stack: ExitStack, ros: Ros, robot: Robot) -> dict[str, Heard]:
    """Listen to what RViz publishes, in ROS and in the robot."""
    heard = {}
    for topic, (name, _) in CLICKED.items():
        in_ros = ["rostopic", "echo", "-n", "1", topic]
        in_robot = [*COMMAND, "echo", "PoseStamped", "--topic", name, "--json"]
        heard[topic] = (
            stack.enter_context(_running(in_ros, ros.environment, stdout=subprocess.PIPE)),
            stack.enter_context(_running(in_robot, robot.environment, stdout=subprocess.PIPE)),
        )
    return heard


def _drag(display: str, key: str, at: Pixel) -> None:
    """Choose a tool of RViz with its key, and pull its arrow."""
    x, y = map(str, at)
    further = str(at[0] + 60)
    steps: list[list[str]] = [
        ["mousemove", x, y],
        ["key", key],
        ["mousedown", "1"],
        ["mousemove", further, y],
        ["mouseup", "1"],
    ]
    for step in steps:
        time.sleep(CLICK_S)
        subprocess.run(["xdotool", *step], env={**os.environ, "DISPLAY": display}, check=True)


if __name__ == "__main__":
    sys.exit(main())
