"""The state machine in docs/rescue.md works as described."""

from typing import Any

import pytest

from tests.docs._support.pages import block
from workers.state_machine import IllegalTransition


def test_state_machine_example_ends_in_its_final_state(capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, Any] = {"__name__": __name__}
    exec(block("docs/rescue.md", "machine"), names)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "STUCK timed out after 5 s"
    assert "    OPENING --> STUCK: after 5 s" in lines
    with pytest.raises(IllegalTransition):
        names["machine"].go(names["Door"].SHUT, "slammed")
