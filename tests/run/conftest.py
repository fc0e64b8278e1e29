from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.run._support.robot import Robot


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    """An empty workspace with the zoo's modules; its runs are listed apart from all others."""
    runtime = tmp_path / "runtime"
    runtime.mkdir(mode=0o700)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2]))
    workspace = tmp_path / "workspace"
    workspace.mkdir()
    made = Robot(workspace)
    yield made
    made.close()
