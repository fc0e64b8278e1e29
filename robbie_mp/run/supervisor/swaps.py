"""Exchanges the code and settings of single modules while the run goes on: `robbie module swap`.

The module restarts in order, so its messages wait in the core meanwhile and its last checkpoint is handed
over. New code is on trial at first. If it does not come up, or ends within `TRIAL_S`, what ran before is put
back. If that cannot start from the checkpoint that the new code has left, it starts fresh.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from robbie_mp.run.supervisor.child_spec import ChildKind, ChildSpec
from robbie_mp.run.supervisor.states import ChildState, StateChange
from robbie_mp.run.supervisor.supervised_child import SupervisedChild
from robbie_mp.run.supervisor.tree import CannotControl, Tree
from robbie_mp.run.trace.kinds import Kind
from robbie_mp.run.variant import TRIAL_S, Variant

OF_THE_PROFILE = Variant()

Answer = dict[str, str]


@dataclass
class Trial:
    """One swap that is not over.

    Attributes:
        child: the module.
        before: what it ran.
        tried: what it is to run.
        first: number of its first process that runs `tried`, or `before` when that has been put back.
        until_s: end of the trial, monotonic clock; None: it is not RUNNING.
        is_fresh: whether `before` was put back without a checkpoint.
        failure: why `before` was put back; '' if it was not.
        answer: how it ended; None: it has not.
    """

    child: SupervisedChild
    before: Variant
    tried: Variant
    first: int
    until_s: float | None = None
    failure: str = ""
    is_fresh: bool = False
    answer: Answer | None = None

    def progress(self) -> Answer | None:
        """Return the answer as soon as there is one."""
        return self.answer


class Swaps:
    """The swaps of a run, at most one at a time for each module.

    Args:
        tree: the modules.
        clock: monotonic time in s.
    """

    def __init__(self, tree: Tree, clock: Callable[[], float] = time.monotonic):
        self._tree = tree
        self._clock = clock
        self._planned: dict[str, ChildSpec] = {}
        """What the profile says about the modules that have been swapped."""
        self._present: dict[str, Variant] = {}
        self._trials: dict[str, Trial] = {}
        tree.is_put_back = self._on_change

    def begin(self, name: str, variant: Variant, *, is_fresh: bool = False) -> Trial:
        """Restart a module as a variant.

        Args:
            name: the module.
            variant: what it runs from now on.
            is_fresh: whether it starts without the checkpoint.

        Raises:
            NoSuchChild: no module has that name.
            CannotControl: it is the core, is being swapped, or cannot be restarted now; or it runs this
                already.
        """
        child = self._tree.child(name)
        if child.spec.kind is ChildKind.CORE:
            raise CannotControl("the core has no other code; only modules can be swapped")
        if name in self._trials:
            raise CannotControl(f"{name} is being swapped; try again when that is over")
        before = self._present.get(name, OF_THE_PROFILE)
        if variant == before == OF_THE_PROFILE:
            raise CannotControl(f"{name} has not been swapped: it runs {before}")
        self._tree.restart_child(name, f"swapped: from now on it runs {variant}")
        trial = self._trials[name] = Trial(child, before, variant, child.incarnation + 1)
        self._set(child, variant, is_fresh=is_fresh)
        return trial

    def turn(self) -> None:
        """End the trials of what has run long enough; called in every iteration of the loop."""
        for trial in list(self._trials.values()):
            if trial.until_s is not None and self._clock() >= trial.until_s:
                self._end(trial, "done", f"it runs {trial.tried}, start {trial.child.incarnation}")

    def _set(self, child: SupervisedChild, variant: Variant, *, is_fresh: bool) -> None:
        name = child.spec.name
        planned = self._planned.setdefault(name, child.spec)
        self._present[name] = variant
        if is_fresh:
            variant = replace(variant, fresh_start=child.incarnation + 1)
        if variant == OF_THE_PROFILE:
            child.spec = planned
            return
        child.spec = replace(
            planned,
            module=variant.applied(planned.module),
            environment={**planned.environment, **variant.environment()},
            may_be_warm=False,  # a spare does not get the environment, and may have imported the old code
        )

    def _on_change(self, child: SupervisedChild, change: StateChange) -> bool:
        """Follow a module on trial; return whether it has ended and something else is started instead."""
        trial = self._trials.get(change.name)
        if trial is None:
            return False
        if child.incarnation < trial.first:
            if change.new.is_final:
                self._call_off(trial, change.reason)
            return False
        if change.new is ChildState.STARTING:
            trial.until_s = None
        elif change.new is ChildState.RUNNING:
            trial.until_s = self._clock() + TRIAL_S
            if trial.failure:
                self._end(trial, "error", f"{trial.failure}; it is RUNNING again, start {child.incarnation}")
        elif child.is_ordered_to_end or self._tree.stop_reason:  # nothing starts again in a run that stops
            if change.new.is_final:
                self._call_off(trial, f"it was stopped before its trial was over: {change.reason}")
        else:
            return self._put_back(trial, change)
        return False

    def _call_off(self, trial: Trial, why: str) -> None:
        """End a trial of a module that has ended; if it is started again, it runs what ran before."""
        self._set(trial.child, trial.before, is_fresh=trial.is_fresh)
        self._end(trial, "error", why)

    def _put_back(self, trial: Trial, change: StateChange) -> bool:
        """Start again what ran before; False: that was tried already."""
        child, is_second = trial.child, bool(trial.failure)
        if is_second and (trial.is_fresh or change.old is not ChildState.STARTING):
            self._end(trial, "error", f"{trial.failure}; but that has ended, too: {change.reason}")
            return False
        trial.is_fresh = is_second
        if is_second:
            news = "it cannot start from the checkpoint that was left, so it starts fresh"
        else:
            news = f"{trial.tried} has ended ({change.reason}), so {trial.before} is put back"
            trial.failure = news
        child.output.say(Kind.WARNING, news)
        trial.first, trial.until_s = child.incarnation + 1, None
        self._set(child, trial.before, is_fresh=is_second)
        child.restart_now(news)
        return True

    def _end(self, trial: Trial, kind: str, text: str) -> None:
        trial.answer = {kind: f"{trial.child.spec.name}: {text}"}
        self._trials.pop(trial.child.spec.name, None)
