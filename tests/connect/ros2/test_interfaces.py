"""`robbie type import`: message classes in Python from the files of a package of ROS 2, and from logs."""

import ast
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from robbie_mp.cli import main
from robbie_mp.connect.ros2.action_types import action_type
from robbie_mp.connect.ros2.interfaces import python_source
from robbie_mp.connect.ros2.service_types import ros_type
from robbie_mp.connect.ros2.type_hash import service_hash, type_hash
from robbie_mp.messages import Message
from robbie_mp.messages.stock.registry import stock_registry
from tests._support.places import PROJECT
from tests.connect.ros2._support.ros_nodes import WHEELS
from tests.logs.recording._support.ros2_bags import Topic, rows, write_mcap

FILES = {
    "msg/Wheel.msg": """# A wheel that is driven.
#
# It turns.

float32 MAX_SPEED = 2.5   # rad/s
std_msgs/Header header
float32 speed nan # rad/s
                  # positive: ahead
string<=8 name "left"
geometry_msgs/Point[4] corners
""",
    "msg/Goal.msg": "Wheel[] wheels\nint32[<=3] numbers [1, 2]\nbyte[2] raw\nbool class\n",
    "srv/Turn.srv": "# Turns a wheel.\n\nWheel wheel\n---\nbool success\n",
    "action/Drive.action": "# goal definition\nfloat64 to_m\n---\n---\nGoal goal\n",
    "msg/Wide.msg": "wstring text\n",
    "srv/Dial.srv": "int64 call\n---\n",
    "msg/Lost.msg": "other_msgs/Thing thing\n",
}
WRITTEN = '''"""Messages of ROS 2's package cart_msgs, written by `robbie type import`."""

from typing import Annotated, ClassVar, Literal

import numpy as np

from robbie_mp import (
    DEFAULT,
    Array,
    Feedback,
    FixedLength,
    Goal,
    MaxLength,
    Message,
    Reply,
    Request,
    Result,
    byte,
    float32,
    float64,
    int32,
)
from robbie_mp.messages.stock.geometry_msgs import Point
from robbie_mp.messages.stock.std_msgs import Header


class Wheel(Message, name="cart_msgs/msg/Wheel"):
    """A wheel that is driven.

    It turns.
    """

    MAX_SPEED: ClassVar[float32] = 2.5  # rad/s
    header: Header = DEFAULT
    # rad/s
    # positive: ahead
    speed: float32 = float("nan")
    name: Annotated[str, MaxLength(8)] = "left"
    corners: Annotated[list[Point], FixedLength(4)] = DEFAULT


class CartGoal(Message, name="cart_msgs/msg/Goal"):
    """cart_msgs/Goal of ROS 2."""

    wheels: list[Wheel] = DEFAULT
    numbers: Annotated[Array[int32], MaxLength(3)] = np.array([1, 2], np.int32)
    raw: Array[byte, Literal[2]] = DEFAULT
    class_: bool = DEFAULT


class TurnReply(Reply, name="cart_msgs/srv/Turn_Response"):
    """The reply of cart_msgs/Turn."""

    success: bool = DEFAULT


class Turn(Request[TurnReply], name="cart_msgs/srv/Turn_Request"):
    """Turns a wheel."""

    wheel: Wheel = DEFAULT


class DriveResult(Result, name="cart_msgs/action/Drive_Result"):
    """The result of cart_msgs/Drive."""


class DriveFeedback(Feedback, name="cart_msgs/action/Drive_Feedback"):
    """Feedback of cart_msgs/Drive."""

    goal: CartGoal = DEFAULT


class Drive(Goal[DriveFeedback, DriveResult], name="cart_msgs/action/Drive_Goal"):
    """A goal for cart_msgs/Drive."""

    to_m: float64 = DEFAULT
'''


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    folder = tmp_path / "share" / "cart_msgs"
    for name, text in FILES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    (folder / "package.xml").write_text("<package/>")
    return folder


def classes_in(text: str, name: str) -> dict[str, type[Message]]:
    """Run a written file; return its classes, and the stock ones that it imports, by ROS's name."""
    module = ModuleType(f"imported_{name}")
    sys.modules[module.__name__] = module  # where the annotations of its classes are looked up
    try:
        exec(text, module.__dict__)
    finally:
        del sys.modules[module.__name__]
    found = [one for one in vars(module).values() if isinstance(one, type) and issubclass(one, Message)]
    return {one.type_name: one for one in found if getattr(one, "type_name", "")}


def test_package_is_written_as_a_person_would_and_what_cannot_be_is_named(
    package: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    target = tmp_path / "cart_msgs.py"
    assert main(["type", "import", str(package), "--output", str(target)]) == 1
    assert target.read_text() == WRITTEN
    told = capsys.readouterr().err.splitlines()
    assert [line.split(":")[1].strip() for line in told] == [
        "cart_msgs/msg/Lost",
        "cart_msgs/msg/Wide",
        "cart_msgs/srv/Dial_Request",
    ]
    assert "other_msgs/Thing" in told[0]
    assert "wstring" in told[1]
    assert "Robbie-MP's own" in told[2]
    assert classes_in(WRITTEN, "cart_msgs").keys() >= {
        "cart_msgs/action/Drive_Goal",
        "cart_msgs/srv/Turn_Request",
    }


def test_names_and_comments_of_strangers_run_nothing_in_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {
        "Fine": '# """ \x00 \\\n\nstring text "\\"; print(1)"  # \x00',
        "Hiding": "int32 DEFAULT=5\nint32 x",
        "Listing": "string list\nstring[] names",
        "Keyword": "int32 None=1",
        "np": "int32[] x [1]",
    }
    folder = tmp_path / "bad_msgs"
    evil = tmp_path / 'x"""; print("run"); """'
    for package in (folder, evil):
        (package / "msg").mkdir(parents=True)
        for name, text in files.items():
            (package / f"msg/{name}.msg").write_text(text)
    os.mkfifo(folder / "msg/Pipe.msg")
    assert main(["type", "import", str(folder)]) == 1
    output, told = capsys.readouterr()
    made = classes_in(output, "bad_msgs").keys()
    assert made == {"bad_msgs/msg/Fine", "bad_msgs/msg/np"}
    assert [line.split(":")[1].strip() for line in told.splitlines()] == [
        f"bad_msgs/msg/{name}" for name in ("Hiding", "Keyword", "Listing")
    ]
    assert main(["type", "import", str(evil)]) == 1
    (heading,) = ast.parse(capsys.readouterr().out).body
    assert isinstance(heading, ast.Expr)
    assert isinstance(heading.value, ast.Constant)


def test_type_whose_stock_form_has_other_fields_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder := tmp_path / "std_msgs/msg").mkdir(parents=True)
    (folder / "String.msg").write_text("string data\n")
    (folder / "Header.msg").write_text("uint32 seq\nbuiltin_interfaces/Time stamp\nstring frame_id\n")
    assert main(["type", "import", str(folder.parent)]) == 1
    (told,) = capsys.readouterr().err.splitlines()
    assert "std_msgs/msg/Header: Robbie-MP's stock type of this name has different fields" in told


def test_existing_file_is_not_replaced(
    package: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "mine.py"
    target.write_text("mine")
    assert main(["type", "import", str(package), "--output", str(target)]) == 1
    assert target.read_text() == "mine"
    assert "Traceback" not in capsys.readouterr().err


def test_installed_package_is_found_by_its_name(
    package: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["type", "import", "cart_msgs"]) == 1
    assert "AMENT_PREFIX_PATH is not set" in capsys.readouterr().err
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(package.parents[1]))
    main(["type", "import", "cart_msgs"])
    assert capsys.readouterr().out == WRITTEN
    assert main(["type", "import", "cart_msg"]) == 1
    assert "did you mean 'cart_msgs'" in capsys.readouterr().err


def test_types_of_a_log_are_written_except_the_stock_ones(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.mcap"
    wheel = f"{'=' * 80}\nMSG: cart_msgs/Wheel\nfloat32 speed  # rad/s\n"
    write_mcap(
        log, rows([Topic("/name"), Topic("/cart", "cart_msgs/msg/Cart", f"Wheel[2] wheels\n{wheel}")], 4)
    )
    assert main(["type", "import", str(log)]) == 0
    text = capsys.readouterr().out
    assert "speed: float32 = DEFAULT  # rad/s\n" in text
    assert "wheels: Annotated[list[Wheel], FixedLength(2)] = DEFAULT" in text
    assert classes_in(text, "log").keys() == {"cart_msgs/msg/Wheel", "cart_msgs/msg/Cart"}
    write_mcap(log, rows([Topic("/name"), Topic("/odd", "Cart", "int32 x")], 4))
    assert main(["type", "import", str(log)]) == 1
    assert "no definitions of message types" in capsys.readouterr().err


@pytest.mark.sampled(1)
@pytest.mark.slow
@pytest.mark.parametrize("distribution", WHEELS)
def test_every_interface_of_the_wheels_has_the_hash_of_ros(distribution: str) -> None:
    share = PROJECT / f".venv/ros-{distribution}/share"
    if not share.exists():
        pytest.skip(f"no wheels of ROS 2 {distribution} here: `make ros` installs them")
    count = 0
    left_out: list[str] = []
    for folder in sorted(share.iterdir()):
        if not any((folder / kind).is_dir() for kind in ("msg", "srv", "action")):
            continue
        text, source = python_source(str(folder))
        left_out += source.left_out
        known = {one.type_name: one for one in stock_registry()} | classes_in(text, folder.name)
        for name, computed, published in hashes(folder, known):
            count += 1
            assert computed == published, name
    assert [line.split(":")[0] for line in left_out] == ["test_msgs/msg/WStrings"]
    assert count > 190


def hashes(folder: Path, known: dict[str, type[Message]]) -> Iterator[tuple[str, Any, Any]]:
    """Yield each interface of a package, its hashes as computed here, and as ROS has written them."""
    for file in sorted(one for kind in ("msg", "srv", "action") for one in folder.glob(f"{kind}/*.{kind}")):
        name = f"{folder.name}/{file.parent.name}/{file.stem}"
        told = json.loads(file.with_suffix(".json").read_text())["type_hashes"]
        published = {one["type_name"]: one["hash_string"] for one in told}
        if file.suffix == ".msg" and name in known:
            yield name, type_hash(known[name]), published[name]
        elif file.suffix == ".srv":
            request, response = (ros_type(known[f"{name}_{one}"]) for one in ("Request", "Response"))
            yield name, service_hash(name, request, response), published[name]
        elif file.suffix == ".action":
            parts = (ros_type(known[f"{name}_{one}"]) for one in ("Goal", "Feedback", "Result"))
            made = action_type(name, *parts)
            computed = made.send_goal.type_hash, made.get_result.type_hash, type_hash(made.feedback)
            names = (f"{name}_SendGoal", f"{name}_GetResult", f"{name}_FeedbackMessage")
            yield name, computed, tuple(published[one] for one in names)
