"""Plays many histories in Python and in C, and compares every store.

    python -m tests.bus.hot._support.many_histories COUNT [--from NUMBER] [--progress FILE] [--builds FOLDER]

A history is drawn from its number, which a failure names. With `--progress`, it goes on where the last call
with this file stopped, until COUNT histories have been played in all.
"""

import argparse
import gc
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import ModuleType

from robbie_mp.bus.transport import words
from tests.bus.hot._support.build import fused_module
from tests.bus.hot._support.histories import crowd, history
from tests.bus.hot._support.trace import difference

ROBOTS_EVERY = 8
"""Every eighth history is that of a larger robot, which takes three times as long."""
LOOK_EVERYWHERE = 64
"""After every 64th history, all memory is searched for words that were stored without the macro."""
NOTED_EVERY = 1000


def no_fence() -> None:
    """Order nothing: in one process of one thread there is nothing to order, and a trace shows no fences."""


@contextmanager
def faster_play() -> Iterator[None]:
    """Do without what costs time and does not change any store."""
    users = [
        module
        for name, module in sys.modules.items()
        if name.startswith("robbie_mp.") and vars(module).get("new_fence") is words.new_fence
    ]
    new_fence = words.new_fence
    gc.collect()
    gc.freeze()  # what is there already is not searched for garbage again and again
    try:
        for module in users:
            vars(module)["new_fence"] = lambda: no_fence
        yield
    finally:
        for module in users:
            vars(module)["new_fence"] = new_fence
        gc.unfreeze()


def compare_history(built: ModuleType, number: int) -> str:
    """Play a history by its number; return how the stores differ, '' if they do not."""
    drawn: Callable[[int], object] = crowd if number % ROBOTS_EVERY == 3 else history
    found = difference(built, partial(drawn, number), look_everywhere=number % LOOK_EVERYWHERE == 0)
    return found and f"{drawn.__name__}({number}):\n{found}"


def compare_histories(built: ModuleType, numbers: Iterable[int]) -> None:
    """Play histories by their numbers.

    Raises:
        AssertionError: the stores of one differ.
    """
    count = 0
    with faster_play():
        for number in numbers:
            found = compare_history(built, number)
            assert not found, found
            count += 1
    print(f"{count} histories, the same stores")


class Progress:
    """The histories played so far, kept in a file."""

    def __init__(self, path: Path | None, first: int):
        self._path = path
        self.next, self.count, self.violations, self.cpu_s = first, 0, 0, 0.0
        if path is not None and path.exists():
            self.next, self.count, self.violations, self.cpu_s = json.loads(path.read_text())
        self._cpu_s = self.cpu_s - time.process_time()

    def note(self) -> None:
        """Write it down, and say it."""
        self.cpu_s = self._cpu_s + time.process_time()
        if self._path is not None:
            written = self._path.with_suffix(".new")
            written.write_text(json.dumps([self.next, self.count, self.violations, self.cpu_s]))
            written.replace(self._path)
        print(f"{self.count} histories, {self.violations} violations, {self.cpu_s:.0f} s CPU", flush=True)


def main() -> None:
    """Play them; the exit code is 1 if there was a violation."""
    parser = argparse.ArgumentParser(prog="python -m tests.bus.hot._support.many_histories")
    parser.add_argument("count", type=int, help="histories to play in all")
    parser.add_argument("--from", type=int, default=0, dest="first", metavar="NUMBER", help="the first (0)")
    parser.add_argument("--progress", type=Path, metavar="FILE", help="where to go on")
    parser.add_argument("--builds", type=Path, metavar="FOLDER", help="where to keep the test build")
    options = parser.parse_args()
    progress = Progress(options.progress, options.first)
    with tempfile.TemporaryDirectory() as folder:
        built = fused_module(options.builds or Path(folder))
    with faster_play():
        while progress.count < options.count:
            try:
                found = compare_history(built, progress.next)
            except AssertionError as error:
                found = f"history {progress.next}: {error}"
            if found:
                progress.violations += 1
                print(found, flush=True)
            progress.next += 1
            progress.count += 1
            if found or progress.count % NOTED_EVERY == 0 or progress.count == options.count:
                progress.note()
    sys.exit(progress.violations > 0)


if __name__ == "__main__":
    main()
