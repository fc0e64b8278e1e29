"""Types that a run has learnt from another system are there for all who load its plan."""

from pathlib import Path

import pytest

from robbie_mp.run import learnt_types
from robbie_mp.run.learnt_types import Entry, learn_type

GAS: Entry = ("nose_msgs/msg/Gas", 1, "uint16 ppm\n", "")


def test_a_type_is_learnt_once_with_one_definition(tmp_path: Path) -> None:
    assert learnt_types.learnt_types(tmp_path) == []
    assert learn_type(tmp_path, GAS)
    assert learn_type(tmp_path, GAS)
    assert not learn_type(tmp_path, (GAS[0], 1, "uint8 ppm\n", ""))
    assert learnt_types.learnt_types(tmp_path) == [GAS]
    assert len(list((tmp_path / "types").iterdir())) == 1


def test_a_run_learns_a_limited_number_of_types(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learnt_types, "MAX_TYPES", 1)
    assert learn_type(tmp_path, GAS)
    with pytest.raises(OSError, match="at most 1 types"):
        learn_type(tmp_path, ("nose_msgs/msg/Smell", 1, "", ""))
    assert learn_type(tmp_path, GAS)
