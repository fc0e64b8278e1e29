"""The examples in docs/scene-graph.md work as described."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from robbie_mp import Header, ModuleHarness, Time
from robbie_mp.messages import LaserScan, TFMessage, Transform, TransformStamped, Vector3
from robbie_mp.module.settings import check_settings
from robbie_mp.scene.module import SceneGraphService
from tests.docs._support.pages import ROOT, block

PAGE = "docs/scene-graph.md"


def test_library_reads_the_files_on_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("robot.yaml", "world.yaml"):
        (tmp_path / name).write_text(block(PAGE, name))
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(block(PAGE, "library"), names)
    assert len(names["graph"]) == 13
    # The blue robot is 2 m ahead of the red one; its camera is turned.
    assert names["X_RB"].translation == pytest.approx([2.1287, 0.0089, 0.37], abs=3e-3)


def test_module_looks_up_where_a_scan_was_taken() -> None:
    names: dict[str, Any] = {"__name__": __name__}
    exec(block(PAGE, "listener"), names)
    with ModuleHarness(names["ScanPlacer"]) as harness:
        scan = LaserScan(header=Header(stamp=Time(sec=1), frame_id="laser"))
        harness.send(scan)
        assert harness.module.status == "there is no node 'map'"
        place = Transform(translation=Vector3(x=1.5))
        link = TransformStamped(
            header=Header(stamp=Time(sec=1), frame_id="map"), child_frame_id="laser", transform=place
        )
        harness.send(TFMessage(transforms=[link]), topic="tf")
        harness.send(scan)
        assert harness.module.status == "scan taken at 1.50, 0.00, heading 0.00 rad"


def test_profile_on_the_page_has_valid_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    (module,) = yaml.safe_load(block(PAGE, "profile"))["modules"].values()
    assert module["class"] == f"{SceneGraphService.__module__}:{SceneGraphService.__name__}"
    SceneGraphService.check(check_settings(SceneGraphService, module["settings"]))
