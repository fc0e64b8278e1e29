"""What the supervisor itself logs."""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from robbie_mp.run.trace.kinds import Kind, kind_of_level


class _SayingHandler(logging.Handler):
    def __init__(self, say: Callable[[Kind, str], None]):
        super().__init__()
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(kind_of_level(record.levelno), record.getMessage())


@contextmanager
def logging_to(say: Callable[[Kind, str], None]) -> Iterator[None]:
    """Write what the supervisor logs into the trace.

    Without a handler, Python prints it on standard error, and a stopped terminal would stop the supervisor.

    Args:
        say: writes an entry into the trace.
    """
    handler, log = _SayingHandler(say), logging.getLogger("robbie")
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
