"""`robbie info` knows each kind of file by its content, and says what its reader leaves out."""

import gzip
import json
import os
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from robbie_mp.cli import main
from robbie_mp.cli.file_kinds import DESCRIBED_BY
from tests.logs.recording._support.logs import LogFile, scan, write_log
from tests.logs.recording.test_imports import CARMEN, write_bag

URDF = """\
<robot name="r">
  <link name="a"><visual/></link>
  <link name="b"/>
  <joint name="j" type="revolute">
    <parent link="a"/><child link="b"/><limit lower="0" upper="1" velocity="1" effort="1"/>
  </joint>
</robot>
"""
MAP = "image: {}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
SCENE = "nodes:\n  map: {}\n  base: {parent: map}\n"


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], path: str) -> dict[str, Any]:
    assert main(["info", path]) == 0
    shown = capsys.readouterr().out
    assert main(["info", path, "--json"]) == 0
    (data,) = json.loads(capsys.readouterr().out)
    assert data["path"] == path and (data["kind"] in shown)
    return dict(data)


@pytest.mark.parametrize(("kind", "function"), DESCRIBED_BY.items())
def test_function_that_describes_a_kind_exists(kind: str, function: str) -> None:
    module, _, name = function.partition(":")
    assert callable(getattr(import_module(module), name)), kind


def test_log_is_known_without_its_suffix(capsys: pytest.CaptureFixture[str]) -> None:
    write_log(Path("drive.dat"), 30)
    assert told(capsys, "drive.dat")["kind"] == "log"


def test_log_says_which_messages_cannot_be_read(capsys: pytest.CaptureFixture[str]) -> None:
    with LogFile(Path("a.mcap")) as log:
        log.add(scan(1), "scan")
        log.add_bytes(log.channel("team_msgs/msg/Odd", "wstring x", 1, "odd", ""), b"", 1)
    (left_out,) = told(capsys, "a.mcap")["left_out"].items()
    assert "wstring" in left_out[0] and left_out[1] == 1


@pytest.mark.parametrize("form", ["ROS 1", "SQLITE3"])
def test_bag_says_what_an_import_leaves_out(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_bag(Path(), form)
    found = told(capsys, str(path))
    assert found["kind"] == ("ROS 1 bag" if form == "ROS 1" else "ROS 2 bag")
    assert found["messages"] == "3" and "/scan: 1 sensor_msgs/msg/LaserScan" in found["topics"]
    assert found["import leaves out"] == "nothing"


def test_bag_of_ros_2_in_mcap_is_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    assert told(capsys, str(write_bag(Path(), "MCAP")))["kind"] == "log"


@pytest.mark.parametrize("name", ["a.clf", "a.txt", "a.log.gz"])
def test_carmen_log_is_known_by_its_lines(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    content = CARMEN.encode()
    Path(name).write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    found = told(capsys, name)
    assert found["kind"] == "CARMEN log" and "broken FLASER" in found["import leaves out"]


@pytest.mark.parametrize("asked", ["hall.yaml", "hall.png", "other.cfg"])
def test_map_is_known_by_its_keys_or_its_image(asked: str, capsys: pytest.CaptureFixture[str]) -> None:
    Image.new("L", (3, 2), 254).save("hall.png")
    for name in ("hall.yaml", "other.cfg"):
        Path(name).write_text(MAP.format("hall.png"))
    found = told(capsys, asked)
    assert found["kind"] == "map" and "6 free" in found["cells"]


@pytest.mark.parametrize("name", ["robot.urdf", "robot.xacro", "ROBOT.URDF", "robot.txt"])
def test_urdf_is_known_by_its_first_character(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path(name).write_text(URDF)
    found = told(capsys, name)
    assert found["kind"] == "URDF" and "<visual>" in found["left out"]


def test_scene_says_what_its_urdf_leaves_out(capsys: pytest.CaptureFixture[str]) -> None:
    Path("robot.urdf").write_text(URDF)
    Path("scene.yaml").write_text(SCENE + "include:\n  - {file: robot.urdf, parent: base}\n")
    found = told(capsys, "scene.yaml")
    assert (found["kind"], found["nodes"], found["joints"]) == ("scene", "4", "1 revolute")
    assert "<visual>" in found["left out"]


def swapped_map() -> None:
    Image.new("L", (1, 1)).save("a.png")
    Path("bad").write_text(MAP.format("a.png").replace("0.65", "0.1"))


def empty() -> None:
    Path("bad").touch()


def text() -> None:
    Path("bad").write_text("hello\nworld\n")


def other_yaml() -> None:
    Path("bad").write_text("modules: {}\n")


def lonely_image() -> None:
    Image.new("L", (1, 1)).save("bad", "PNG")


def aliases() -> None:
    levels = "".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]\n" for n in range(1, 12))
    Path("bad").write_text(f"l0: &l0 x\n{levels}")


def fifo() -> None:
    os.mkfifo("bad")


def odd_scalar() -> None:
    Path("bad").write_text("image: a.png\nresolution: !!int ''\n")


def bad_urdf() -> None:
    Path("bad").write_text("<robot><link/></robot>")


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (swapped_map, "must be greater than free_thresh"),
        (empty, "bad is empty"),
        (text, "bad is none of the files that can be described: logs (MCAP"),
        (other_yaml, "URDF and xacro, scene files (YAML)"),
        (lonely_image, "no YAML file beside it names it as that of a map"),
        (aliases, "none of the files that can be described"),
        (fifo, "bad cannot be read: it is a FIFO or a device, not a file"),
        (odd_scalar, "origin, negate, occupied_thresh, free_thresh missing"),
        (bad_urdf, "<link> has no name"),
    ],
)
def test_what_cannot_be_described_is_a_clear_error(
    make: Callable[[], None], what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    make()
    assert main(["info", "bad"]) == 2
    error = capsys.readouterr().err
    assert what in error and "Traceback" not in error
