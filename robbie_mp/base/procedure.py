"""A procedure: a task as a coroutine, which reads from top to bottom and pauses where it waits.

Its owner drives it with the events that it gets anyway, so it needs no event loop and no thread. This file
imports nothing but the base of all errors.
"""

import types
from collections.abc import Callable, Coroutine, Generator, Iterable
from typing import Any, Generic, TypeVar, cast

from robbie_mp.base.errors import RobbieError

Result = TypeVar("Result")
Entry = tuple[str, Any]
"""The name of a step, and its result."""


class WrongJournal(RobbieError, ValueError):
    """A journal that does not fit the procedure that goes on with it.

    Example scenarios:
      - an earlier version of the program has kept it
      - the procedure decided by something that was neither its argument nor in the journal
    """


class Failed(RobbieError, RuntimeError):
    """What a procedure was to do cannot be done; the text says why, in plain words."""


@types.coroutine
def pause() -> Generator[None, Any, Any]:
    """Wait for what the procedure is told next, and return it; None if only time has passed."""
    return (yield)


class Procedure(Generic[Result]):
    """Runs a coroutine that awaits nothing but `pause()`: up to its first pause, and on with each event.

        async def fetch(self) -> str:
            self.say("I fetch it")
            while not self.holds:
                event = await pause()
                ...
            return "holds it"

        def setup(self) -> None:
            self.work = Procedure[str]()
            self.work.begin(self.fetch())

        def tick(self) -> None:
            self.work.tell()

    After a restart, its owner begins it again: the coroutine looks at what it is to change in the world, such
    as what the hand holds, or keeps a `Journal` of what is done already.

    Attributes:
        result: what the last coroutine has returned; None before, and if it was cancelled.
    """

    def __init__(self) -> None:
        self._work: Coroutine[Any, Any, Result] | None = None
        self.result: Result | None = None

    @property
    def is_over(self) -> bool:
        """Return whether nothing runs: no coroutine has begun, or the last one has ended."""
        return self._work is None

    def begin(self, work: Coroutine[Any, Any, Result]) -> None:
        """Run a coroutine up to its first pause; one that runs ends."""
        self.cancel()
        self._work, self.result = work, None
        self.tell()

    def tell(self, event: object = None) -> None:
        """Go on with an event, up to the next pause."""
        if self._work is None:
            return
        try:
            self._work.send(event)
        except StopIteration as end:
            self._work, self.result = None, end.value
        except BaseException:
            self._work = None
            raise

    def cancel(self) -> bool:
        """End what runs where it waits; return whether there was something. Its `finally` blocks run."""
        work, self._work = self._work, None
        if work is not None:
            work.close()
        return work is not None


class Journal:
    """Keeps the results of a procedure's steps: its next process skips them, and goes on where it was killed.

        async def bring(self) -> None:
            table = self.journal.once(self.nearest_table)
            problem = await self.journal.step(self.drive_to(table))

    A process that goes on runs the procedure from its top, and gets what is in the journal at once. So what
    the procedure decides by must be in the journal, or the same in each process. A step that is complete
    takes one entry, whatever steps it had itself.

    Args:
        memory: `memory` of the journal of the process before.
    """

    def __init__(self, memory: Iterable[Iterable[Entry]] = ()) -> None:
        self._levels = [list(level) for level in memory] or [[]]
        """The complete steps: of the procedure, of its step that is under way, of that one's, and so on."""
        self._at = [0]
        """The place in each of these of the step that is next."""

    @property
    def memory(self) -> list[list[Entry]]:
        """Return what a checkpoint keeps; results must be what a checkpoint can keep."""
        return [list(level) for level in self._levels]

    @property
    def is_replaying(self) -> bool:
        """Return whether the procedure has not come yet to where it was killed."""
        return len(self._at) < len(self._levels) or self._at[-1] < len(self._levels[-1])

    async def step(self, work: Coroutine[Any, Any, Result]) -> Result:
        """Do a step, unless it is complete; return its result.

        Raises:
            WrongJournal: another step is in the journal.
        """
        name, level = str(getattr(work, "__name__", "")), len(self._at)
        if self._is_done:
            work.close()
            return cast(Result, self._recall(name))
        if level == len(self._levels):
            self._levels.append([])
        self._at.append(0)
        try:
            result = await work
        finally:
            del self._at[level:], self._levels[level:]
        return self._keep(name, result)

    def once(self, decide: Callable[[], Result]) -> Result:
        """Decide or do something, unless that is done; return the result.

        Raises:
            WrongJournal: another step is in the journal.
        """
        name = decide.__name__
        return cast(Result, self._recall(name)) if self._is_done else self._keep(name, decide())

    def clear(self) -> None:
        """Forget everything: the procedure begins something new, in none of its steps."""
        self._levels, self._at = [[]], [0]

    @property
    def _is_done(self) -> bool:
        return self._at[-1] < len(self._levels[len(self._at) - 1])

    def _keep(self, name: str, result: Result) -> Result:
        self._levels[len(self._at) - 1].append((name, result))
        self._at[-1] += 1
        return result

    def _recall(self, name: str) -> Any:
        kept, result = self._levels[len(self._at) - 1][self._at[-1]]
        if kept != name:
            raise WrongJournal(f"the step {name} is next, but the journal has {kept}")
        self._at[-1] += 1
        return result
