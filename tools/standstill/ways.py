"""The ways to drive a robot: one entry each."""

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import psutil
import yaml
from playwright.sync_api import Page

from robbie_mp.connect.ros1 import ros_node
from tools.operator import scene as page_scene
from tools.operator.chromium import chromium_by
from tools.robot import COMMAND, REPOSITORY, Robot
from tools.ros1.ros import ROSCORE, SYSTEM_PYTHON
from tools.standstill.scene import TrialRobot
from tools.test_network.network import Host, Network, NetworkConditions

WALL, FLOOR = "#" * 14, "#............#"
HALL = "cell_m: 1.0\ndrawing: |\n" + "".join(
    f"  {line}\n" for line in [WALL, *[FLOOR] * 6, "#.....R......#", *[FLOOR] * 5, WALL]
)
OFTEN = {"policy": "always", "max_restarts": 1000, "stable_after_s": 1.0}
HANDS = (sys.executable, "-m", "tools.standstill.hands")
OWN_CLOCK = ("env", "--unset=LD_PRELOAD")
LINK = "robbie_mp.connect.link.module:Link"
END_LIMIT_S = 20.0
DRIVE_KEYS = ("KeyW", "KeyA")
NEAR = NetworkConditions(delay_s=0.001)
PORT, ROS_PORT = 7447, 11311
TOKEN = "an-operator-of-foxglove"


@dataclass(frozen=True)
class DrivingWay:
    """A way to drive.

    Attributes:
        opens: starts the robot, and the program that drives it, in an empty folder.
        needed: the processes without which it must stand.
        dead_man: the one that stops when somebody lets go, or the robot's eyes close.
        is_far: the operator is on another host.
    """

    opens: Callable[[Path], Any]
    needed: tuple[str, ...]
    dead_man: str = "laser"
    is_far: bool = False


def start(
    stack: ExitStack,
    folder: Path,
    profile: dict[str, Any],
    host: Host | None = None,
    shell: Sequence[str] = (),
) -> Robot:
    """Start a run of a profile, in a workspace with all stock profiles."""
    (folder / "profiles").mkdir(parents=True)
    for one in REPOSITORY.glob("profiles/*"):
        (folder / "profiles" / one.name).symlink_to(one)
    (folder / "hw").symlink_to(REPOSITORY / "hw")
    (folder / "profiles" / "way.yaml").write_text(yaml.safe_dump(profile, sort_keys=False))
    on_host = host.command() if host else []
    robot = Robot(folder / "run", folder, "way", on_host=[*on_host, *shell])
    stack.callback(_stop, robot)
    return robot


def _stop(robot: Robot) -> None:
    """End a run, and leave nothing behind, even if its supervisor was killed."""
    with suppress(subprocess.TimeoutExpired):
        robot.supervisor.send_signal(signal.SIGINT)
        robot.supervisor.wait(END_LIMIT_S)
    robot.close()
    if robot.supervisor.returncode < 0:
        subprocess.run([*COMMAND, "clean"], env=robot.environment, capture_output=True, check=False)


def scene_of(stack: ExitStack, robot: Robot, network: Network | None = None) -> TrialRobot:
    """Wait for a run, and look at it."""
    robot.wait_until_running()
    made = TrialRobot(robot, network)
    stack.callback(made.close)
    return made


def by_itself(profile: dict[str, Any], goals: Sequence[float] = ()) -> Callable[[Path], Any]:
    """Return how a robot is started that drives by itself, or between goals at these x (m)."""

    @contextmanager
    def opens(folder: Path) -> Iterator[TrialRobot]:
        with ExitStack() as stack:
            scene = scene_of(stack, start(stack, folder, profile))
            if goals:
                threading.Thread(target=_send_goals, args=[scene, goals], daemon=True).start()
            yield scene

    return opens


def _send_goals(scene: TrialRobot, goals: Sequence[float]) -> None:
    robot = scene.robot
    while robot.is_up:
        for x_m in goals:
            pose = f"{{position: {{x: {x_m}}}, orientation: {{w: 1.0}}}}"
            goal = f"{{pose: {{header: {{frame_id: map}}, pose: {pose}}}}}"
            call = [*COMMAND, "call", "NavigateTo", goal, "--run", robot.run_id]
            subprocess.run(call, env=robot.environment, capture_output=True, check=False)


def driven(folder: Path, more: dict[str, Any], parents: Sequence[str] = ()) -> dict[str, Any]:
    """Return the profile of a robot in a hall, whose laser guards driving by hand."""
    (folder / "hall.yaml").write_text(HALL)
    arena = {"arena": str(folder / "hall.yaml")}
    modules = {"base": {"settings": arena}, "laser": {"settings": arena}, **more}
    return {"parents": ["navigation", *parents], "modules": modules}


def hand(stack: ExitStack, scene: TrialRobot, role: str, *command: str, host: Host | None = None) -> None:
    """Start a program that drives, under a role. It can be started again."""

    def starts() -> None:
        made = subprocess.Popen(
            [*(host.command() if host else ()), *command],
            env=scene.robot.environment | without,
            cwd=REPOSITORY,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        stack.callback(_end, made)
        scene.others[role] = lambda: [made.pid]

    without = {"LD_PRELOAD": ""} if host else {}  # another host has a clock of its own
    scene.revivals[role] = starts
    starts()


def _end(process: "subprocess.Popen[Any]") -> None:
    process.kill()
    process.wait()


@contextmanager
def by_hand(folder: Path) -> Iterator[TrialRobot]:
    """An operator's program on the robot's machine."""
    with ExitStack() as stack:
        scene = scene_of(stack, start(stack, folder, driven(folder, {})))
        hand(stack, scene, "hand", *HANDS, "attached", scene.robot.run_id)
        yield scene


@contextmanager
def backwards(folder: Path) -> Iterator[TrialRobot]:
    """An operator's program on the household robot backs up, in the hall."""
    with ExitStack() as stack:
        (folder / "hall.yaml").write_text(HALL)
        arena = {"settings": {"arena": str(folder / "hall.yaml")}}
        modules = {**LIGHT, **dict.fromkeys(("base", "laser", "rear_laser", "arm"), arena)}
        scene = scene_of(stack, start(stack, folder, {"parents": ["home"], "modules": modules}))
        hand(stack, scene, "hand", *HANDS, "back", scene.robot.run_id)
        yield scene


def far(stack: ExitStack) -> Network:
    """Make a network between the robot and a laptop, whose delay can be changed at once."""
    network = stack.enter_context(Network("robot", "laptop"))
    network.set(NEAR)
    return network


@contextmanager
def over_link(folder: Path) -> Iterator[TrialRobot]:
    """A laptop with a link drives."""
    with ExitStack() as stack:
        network = far(stack)
        robot_host, laptop_host = network.host("robot"), network.host("laptop")
        address = f"tcp/{robot_host.address}:{PORT}"
        ours = {"robot": "robot", "listen": [address], "send": {"state": ["Odometry odom"]},
                "accept": {"laptop": ["DriveCommand manual"]}}  # fmt: skip
        theirs = {"robot": "laptop", "listen": [], "connect": [address],
                  "send": {"command": ["DriveCommand manual"]}, "accept": {"robot": ["*"]}}  # fmt: skip
        robot = start(stack, folder, driven(folder, {"link": _module(LINK, ours)}), robot_host)
        modules = {"link": _module(LINK, theirs), "pilot": _module("tools.standstill.hands:StandstillHand")}
        laptop = start(stack, folder / "laptop", {"modules": modules}, laptop_host, OWN_CLOCK)
        scene = scene_of(stack, robot, network)
        laptop.wait_until_running()
        for name in ("pilot", "link", "core"):
            scene.others[f"laptop's {name}"] = lambda name=name: [laptop.figures()[name].pid]  # type: ignore[misc]
        scene.others["laptop"] = lambda: [
            laptop.supervisor.pid,
            *(one.pid for one in laptop.figures().values()),
        ]
        yield scene


def _module(path: str, settings: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"class": path, "settings": settings or {}, "restart": OFTEN}


@contextmanager
def by_foxglove(folder: Path) -> Iterator[TrialRobot]:
    """A client of Foxglove drives."""
    with ExitStack() as stack:
        network = far(stack)
        (folder / "foxglove.token").touch(mode=0o600)
        (folder / "foxglove.token").write_text(TOKEN)
        settings = {"host": "0.0.0.0", "token": f"file:{folder}/foxglove.token"}
        more = {"foxglove": {"settings": settings, "restart": OFTEN}}
        robot = start(stack, folder, driven(folder, more, ["robbie:foxglove"]), network.host("robot"))
        scene = scene_of(stack, robot, network)
        link = f"ws://{network.host('robot').address}:8765/?token={TOKEN}"
        program = [*HANDS, "foxglove", link]
        hand(stack, scene, "client", *program, host=network.host("laptop"))
        yield scene


@contextmanager
def by_ros(folder: Path, type_name: str = "Twist") -> Iterator[TrialRobot]:
    """A node of ROS 1 drives, on another host than the bridge and the master."""
    with ExitStack() as stack:
        network = far(stack)
        here, there = network.host("robot"), network.host("laptop")
        ros = {"ROS_MASTER_URI": f"http://{here.address}:{ROS_PORT}", "ROS_HOME": str(folder / "ros")}
        master = here.popen(
            ROSCORE, "-p", str(ROS_PORT), env={**os.environ, **ros, "ROS_IP": here.address},
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        stack.callback(_end_all, master)
        bridge = {"master": ros["ROS_MASTER_URI"], "ip": here.address,
                  "accept": {"/cmd_vel": f"{type_name} as DriveCommand manual"}}  # fmt: skip
        more = {"ros1": _module("robbie_mp.connect.ros1.module:Ros1Bridge", bridge)}
        scene = scene_of(stack, start(stack, folder, driven(folder, more), here), network)
        scene.robot.environment |= {**ros, "ROS_IP": there.address}
        program = Path(__file__).parent / "ros_hand.py"
        hand(stack, scene, "node", SYSTEM_PYTHON, str(program), type_name, host=there)
        scene.others["bridge's node"] = lambda: [
            one.pid for one in _below(scene.robot.figures()["ros1"].pid) if ros_node.__file__ in one.cmdline()
        ]
        yield scene


def _below(pid: int) -> list[psutil.Process]:
    return psutil.Process(pid).children(recursive=True)


def _end_all(process: "subprocess.Popen[Any]") -> None:
    for one in _below(process.pid):
        one.kill()
    _end(process)


@contextmanager
def by_page(folder: Path) -> Iterator[TrialRobot]:
    """A real browser on another host drives by the operator's page."""
    with ExitStack() as stack:
        network = far(stack)
        (folder / "hall.yaml").write_text(HALL)
        base = {"class": "robbie_robots.modules.devices.base:SimulatedBase",
                "settings": {"arena": str(folder / "hall.yaml"), "guard_topics": [""]}}  # fmt: skip
        page = page_scene.Scene(
            folder / "page", folder / "hall.yaml", {"base": base}, on_host=network.host("robot").command()
        )
        stack.callback(_stop, page.robot)
        page.begin()
        scene = scene_of(stack, page.robot, network)
        command = [*network.host("laptop").command(), *OWN_CLOCK]
        browser = stack.enter_context(chromium_by(command, folder))
        scene.page = stack.enter_context(page.page(browser, network.host("robot").address))
        scene.others["browser"] = lambda: [
            one.pid for one in psutil.Process().children(recursive=True) if "chrom" in one.name()
        ]
        scene.urge = lambda: _hold_keys(scene.page)
        scene.urge()
        yield scene


def _hold_keys(page: Page) -> None:
    for key in DRIVE_KEYS:
        page.keyboard.up(key)
        page.keyboard.down(key)


LIGHT = dict.fromkeys(["operator", "camera", "depth_camera", "objects", "table_objects", "manipulation"])
"""What of the household robot does not drive, and takes the time of a small machine."""
DRIVER = ("mapping", "navigation", "core")
WAYS = {
    "by hand": DrivingWay(by_hand, ("hand", "laser", "core"), "hand"),
    "navigation": DrivingWay(by_itself({"parents": ["navigation"]}, (2.5, 0.0)), ("laser", *DRIVER)),
    "exploration": DrivingWay(by_itself({"parents": ["demo"]}), ("laser", "mapping", "exploration", "core")),
    "race": DrivingWay(by_itself({"parents": ["parcours"]}), ("laser", "parcours", "core")),
    "rescue": DrivingWay(
        by_itself({"parents": ["rescue"], "modules": {"operator": None}}), ("laser", *DRIVER)
    ),
    "household": DrivingWay(
        by_itself({"parents": ["home"], "modules": {**LIGHT}}, (5.875, 0.275)),
        ("laser", *DRIVER),  # without the rear laser, it only does not back up
    ),
    "household, back": DrivingWay(backwards, ("hand", "rear_laser"), "hand"),
    "link": DrivingWay(
        over_link,
        ("laptop's pilot", "laptop's link", "laptop's core", "laptop", "link", "laser", "core"),
        "laptop's pilot",
        True,
    ),
    "page": DrivingWay(by_page, ("browser", "operator", "laser", "core"), "browser", True),
    "ROS 1": DrivingWay(by_ros, ("node", "ros1", "bridge's node", "laser", "core"), "node", True),
    "ROS 1, stamped": DrivingWay(partial(by_ros, type_name="TwistStamped"), ("node",), "node", True),
    "Foxglove": DrivingWay(by_foxglove, ("client", "foxglove", "laser", "core"), "client", True),
}
