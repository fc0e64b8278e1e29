"""Takes the pictures of `robbie top` in docs/images: `python -m tools.pictures.top`, in about half a minute.

The tool runs the demo, aborts a module to have a crash report, and presses the keys of each view.
"""

import argparse
import asyncio
import os
import re
import signal
import tempfile
import time
from contextlib import closing
from pathlib import Path

from robbie_mp.cli.top_program.feed import RunFeed
from robbie_mp.cli.top_program.program import TopProgram
from tools.robot import REPOSITORY, Robot, stopping

FOLDER = Path("docs/images")
SIZE = (110, 30)
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
INTERVAL_S = 0.5


def main() -> None:
    """Run the demo and take all pictures."""
    argparse.ArgumentParser(prog="python -m tools.pictures.top", description=__doc__).parse_args()
    with (
        tempfile.TemporaryDirectory() as folder,
        stopping(Robot(Path(folder, "demo"), REPOSITORY, "demo")) as robot,
    ):
        os.environ |= robot.environment  # the program finds the run there
        robot.wait_until_running()
        with closing(RunFeed(robot.run_id)) as feed:
            time.sleep(WARM_UP_S)
            asyncio.run(_take_all(robot, feed))


async def _take_all(robot: Robot, feed: RunFeed) -> None:
    app = TopProgram(feed, INTERVAL_S)
    async with app.run_test(size=SIZE) as pilot:
        robot.send(robot.figures()[ABORTED].pid, signal.SIGABRT)
        robot.wait_for(lambda: robot.figures()[ABORTED].restarts > 0 and robot.all_running(), "no restart")
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
