"""A 32-bit Python stores a word in two halves, so no run and no tool may start there."""

import os
import sys
from pathlib import Path

import pytest

from robbie_mp.bus.transport.layout import SegmentKind
from robbie_mp.bus.transport.segment import Segment
from robbie_mp.bus.transport.shared_folder import make_folder, remove_names
from robbie_mp.bus.transport.words import UnsuitableMachine
from robbie_mp.cli import main

RUN_ID = f"test{os.getpid()}"
PROFILE = "modules: {one: {class: 'robbie_mp:Module'}}"


@pytest.mark.parametrize(
    ("word", "value", "said"),
    [
        ("maxsize", 2**31 - 1, "little-endian Python of 32 bits"),
        ("byteorder", "big", "big-endian Python of 64"),
    ],
)
def test_run_is_refused_before_anything_starts(
    word: str,
    value: object,
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "profiles").mkdir()
    (tmp_path / "profiles" / "robot.yaml").write_text(PROFILE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, word, value)
    assert main(["run", "robot", "--output", str(tmp_path / "out")]) == 1
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_no_segment_can_be_created_or_mapped_there(monkeypatch: pytest.MonkeyPatch) -> None:
    make_folder(RUN_ID)
    segment = Segment.create(f"robbie-{RUN_ID}/x", 100, SegmentKind.DATA)
    try:
        monkeypatch.setattr(sys, "maxsize", 2**31 - 1)
        with pytest.raises(UnsuitableMachine):
            Segment.attach(f"robbie-{RUN_ID}/x", SegmentKind.DATA)
        with pytest.raises(UnsuitableMachine):
            Segment.create(f"robbie-{RUN_ID}/y", 100, SegmentKind.DATA)
    finally:
        monkeypatch.undo()
        segment.close()
        remove_names(RUN_ID)
