"""A procedure: a task as a coroutine, which reads from top to bottom and pauses where it waits.

Its owner drives it with the events that it gets anyway, so it needs no event loop and no thread. This file
imports nothing but the standard library.
"""

import types
from collections.abc import Coroutine, Generator
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


@types.coroutine
def pause() -> Generator[None, Any, Any]:
    """Wait for what the procedure is told next, and return it; None if only time has passed."""
    return (yield)


class Procedure(Generic[Result]):
    """Runs a coroutine that awaits nothing but `pause()`, up to its first pause, and on with each event.

        async def fetch(self) -> str:
            self.say("I fetch it")
            while not self.holds:
                event = await pause()
                ...
            return "holds it"

        self.fetching = Procedure(self.fetch())

        def tick(self) -> None:
            self.fetching.tell()

    After a restart, its owner begins it again, with what it has kept in a checkpoint: the coroutine looks
    what is done already.

    Args:
        work: the coroutine.

    Attributes:
        result: what the coroutine has returned; None before.
        is_over: whether it has returned, or was cancelled.
    """

    def __init__(self, work: Coroutine[Any, Any, Result]) -> None:
        self._work = work
        self.result: Result | None = None
        self.is_over = False
        self.tell()

    def tell(self, event: object = None) -> None:
        """Go on with an event, up to the next pause; one that is over does nothing."""
        if self.is_over:
            return
        try:
            self._work.send(event)
        except StopIteration as end:
            self.result, self.is_over = end.value, True

    def cancel(self) -> None:
        """End it where it waits; its `finally` blocks run."""
        self.is_over = True
        self._work.close()
