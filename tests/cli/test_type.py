"""`robbie type` in a workspace, without any run."""

import json
from pathlib import Path

import pytest

from robbie_mp.cli import main
from robbie_mp.cli.new import make_workspace


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    folder = tmp_path / "mouse"
    make_workspace(folder)
    monkeypatch.chdir(folder)
    return folder


def test_type_of_a_workspace_is_shown(workspace: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["type", "show", "ProcessorLoad", "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["name"] == "mouse/msg/ProcessorLoad"
    assert "float64 smoothed" in shown["schema"]
    assert main(["type", "list"]) == 0
    assert {"mouse/msg/ProcessorLoad", "sensor_msgs/msg/LaserScan"} <= set(capsys.readouterr().out.split())


def test_module_that_cannot_be_imported_hides_no_stock_type(
    workspace: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (workspace / "modules" / "load_sensor.py").write_text("import os\nos._exit(3)\n")
    assert main(["type", "show", "geometry_msgs/Point"]) == 0
    assert capsys.readouterr().out.startswith("# geometry_msgs/msg/Point, version 1\nfloat64 x\n")
    assert main(["type", "show", "ProcessorLoad"]) == 1
