"""A module on trial is put back if it dies, whatever its policy, and the robot goes on."""

from collections.abc import Callable
from pathlib import Path

import pytest

from robbie_mp.run.supervisor.states import ChildState
from robbie_mp.run.supervisor.swaps import Swaps, Trial
from robbie_mp.run.supervisor.tree import CannotControl
from robbie_mp.run.variant import TRIAL_S, Variant
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import NEVER, Run, Scenario, animal, core

MENDED = Variant(settings={"gain": 2})
BROKEN = Variant(settings={"gain": zoo.DEADLY_GAIN})


def error_of(trial: Trial) -> str:
    return (trial.progress() or {})["error"]


class Swapping(Run):
    """A tree whose modules can be swapped; the clock of the trials is set by hand."""

    def __init__(self, folder: Path):
        super().__init__(
            folder, core(), animal(zoo.works_as_its_variant, "arm", essential=True, restart=NEVER)
        )
        self.now_s = 0.0
        self.swaps = Swaps(self.tree, lambda: self.now_s)
        self.each_turn = self.swaps.turn

    @property
    def arm(self) -> str:
        return str(self.tree.child("arm").state)

    def runs_as(self, start: int) -> Callable[[], bool]:
        child = self.tree.child("arm")
        return lambda: child.state is ChildState.RUNNING and child.incarnation == start


def test_code_that_lives_is_kept_after_its_trial(tmp_path: Path) -> None:
    run = Swapping(tmp_path)

    def scenario() -> Scenario:
        yield run.runs_as(1)
        trial = run.swaps.begin("arm", MENDED)
        with pytest.raises(CannotControl, match="arm is being swapped"):
            run.swaps.begin("arm", MENDED)
        yield run.runs_as(2)
        assert trial.progress() is None
        run.now_s = TRIAL_S
        yield lambda: trial.progress() is not None
        assert trial.progress() == {"done": "arm: it runs gain=2, start 2"}
        assert run.tree.child("arm").spec.module.settings == {"gain": 2}
        back = run.swaps.begin("arm", Variant())
        yield run.runs_as(3)
        run.now_s = 2 * TRIAL_S
        yield lambda: back.progress() is not None
        assert run.tree.child("arm").spec.module.settings == {}
        with pytest.raises(CannotControl, match="has not been swapped"):
            run.swaps.begin("arm", Variant())
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_code_that_dies_is_put_back_although_the_module_is_essential_and_never_restarted(
    tmp_path: Path,
) -> None:
    run = Swapping(tmp_path)

    def scenario() -> Scenario:
        yield run.runs_as(1)
        trial = run.swaps.begin("arm", BROKEN)
        yield lambda: trial.progress() is not None
        assert "exit code 1" in error_of(trial)
        assert "it is RUNNING again, start 3" in error_of(trial)
        assert run.tree.child("arm").spec.module.settings == {}
        assert not run.tree.stop_reason
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_core_and_unknown_modules_are_not_swapped(tmp_path: Path) -> None:
    run = Swapping(tmp_path)

    def scenario() -> Scenario:
        yield run.runs_as(1)
        with pytest.raises(CannotControl, match="the core has no other code"):
            run.swaps.begin("core", MENDED)
        run.tree.stop("seen enough")

    assert run.play(scenario()) == 0


def test_trial_that_is_stopped_by_command_says_so(tmp_path: Path) -> None:
    run = Swapping(tmp_path)

    def scenario() -> Scenario:
        yield run.runs_as(1)
        trial = run.swaps.begin("arm", MENDED)
        yield run.runs_as(2)
        run.tree.stop_child("arm", "stopped by command")
        yield lambda: trial.progress() is not None
        assert "stopped before its trial was over" in error_of(trial)

    assert run.play(scenario()) == 0
