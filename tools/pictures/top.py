"""Takes the pictures of `robbie top` in docs/images: `python -m tools.pictures.top`, in about half a minute.

The tool runs the demo, aborts a module to have a crash report, and presses the keys of each view.
"""

import argparse
import asyncio
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TypeVar

from robbie_mp.bus.observe import RunReading
from robbie_mp.cli.top_program.feed import RunFeed
from robbie_mp.cli.top_program.program import TopProgram
from robbie_mp.run.run_directory import list_runs
from robbie_mp.run.supervisor.states import ChildState, state_name

FOLDER = Path("docs/images")
SIZE = (110, 30)
ROBBIE = [sys.executable, "-c", "import sys; from robbie_mp.cli import main; sys.exit(main())"]
VIEWS = {
    "modules": ["1", "down"],
    "types": ["2"],
    "graph": ["3"],
    "details": ["1", "down", "down", "enter"],
}
"""Keys that lead to each view from the previous one. The details are those of the aborted module."""
ABORTED = "laser"
WARM_UP_S = 5.0
AFTER_ABORT_S = 4.0
LIMIT_S = 120.0
INTERVAL_S = 0.5

T = TypeVar("T")


def main() -> None:
    """Run the demo and take all pictures."""
    argparse.ArgumentParser(prog="python -m tools.pictures.top", description=__doc__).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        runtime = Path(folder, "runtime")
        runtime.mkdir(mode=0o700)
        os.environ["XDG_RUNTIME_DIR"] = str(runtime)
        demo = subprocess.Popen(
            [*ROBBIE, "run", "demo", "--quiet", "--output", f"{folder}/output"], stdout=subprocess.DEVNULL
        )
        try:
            (run, *_) = wait_for(lambda: list_runs([runtime / "robbie"]))
            with closing(RunFeed(run.run_id)) as feed:
                wait_for(lambda: all_run(feed.poll().reading))
                time.sleep(WARM_UP_S)
                asyncio.run(_take_all(feed))
        finally:
            demo.send_signal(signal.SIGINT)
            demo.wait(60)


def wait_for(condition: Callable[[], T]) -> T:
    """Wait until something is there, and return it."""
    until_s = time.monotonic() + LIMIT_S
    while not (found := condition()):
        if time.monotonic() > until_s:
            raise SystemExit(f"the demo did not start within {LIMIT_S:g} s")
        time.sleep(INTERVAL_S)
    return found


def all_run(reading: RunReading | None, restarts: int = 0) -> bool:
    """Return whether all modules run, after this number of restarts in total."""
    return (
        reading is not None
        and all(state_name(module.state) == ChildState.RUNNING for module in reading.modules)
        and sum(module.restarts for module in reading.modules) >= restarts
    )


async def _take_all(feed: RunFeed) -> None:
    app = TopProgram(feed, INTERVAL_S)
    async with app.run_test(size=SIZE) as pilot:
        reading = app.snapshot.reading
        module = reading.module(ABORTED) if reading else None
        if module is None:
            raise SystemExit("the demo did not start in time")
        os.kill(module.pid, signal.SIGABRT)
        while not all_run(app.snapshot.reading, restarts=1):
            await asyncio.sleep(INTERVAL_S)
        await asyncio.sleep(AFTER_ABORT_S)
        for view, keys in VIEWS.items():
            await pilot.press(*keys)
            await asyncio.sleep(2 * INTERVAL_S)
            picture = app.export_screenshot(title=f"robbie top: {view}")
            path = FOLDER / f"top-{view}.svg"
            path.write_text(without_remote_fonts(picture))
            print(path)


def without_remote_fonts(picture: str) -> str:
    """Use the reader's own monospaced font in a picture, instead of one that a server must provide."""
    return re.sub(r"@font-face \{.*?\}\n?", "", picture, flags=re.DOTALL).replace("Fira Code", "monospace")


if __name__ == "__main__":
    main()
