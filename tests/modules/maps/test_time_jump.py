"""When time jumps, mapping begins a new map."""

from pathlib import Path

from robbie_mp import ModuleHarness
from robbie_mp.messages import TFMessage, TimeJump, Transform, TransformStamped, Vector3
from robbie_robots.modules.maps.mapping import Mapping
from tests.modules.maps.test_restored import EVERY_SCAN, drive, results


def laser_at(x_m: float) -> TFMessage:
    place = TransformStamped(child_frame_id="laser", transform=Transform(translation=Vector3(x=x_m)))
    return TFMessage(transforms=[place])


def test_map_after_a_jump_contains_only_later_messages(tmp_path: Path) -> None:
    (tmp_path / "jumped").mkdir()
    (tmp_path / "fresh").mkdir()
    with ModuleHarness(Mapping, EVERY_SCAN, output_directory=tmp_path / "jumped") as jumped:
        jumped.send(laser_at(0.1), topic="tf_static")
        drive(jumped, 0, 60)
        jumped.send(TimeJump(reason="seek"))
        forgotten = jumped.checkpoint
        drive(jumped, 100, 160)
    with ModuleHarness(Mapping, EVERY_SCAN, output_directory=tmp_path / "fresh") as fresh:
        fresh.send(laser_at(0.1), topic="tf_static")
        drive(fresh, 100, 160)
    assert results(tmp_path / "jumped") == results(tmp_path / "fresh")
    assert forgotten["scans"] == 0  # nor does a crash bring the old map back
