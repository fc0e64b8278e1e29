"""Takes the pictures of `robbie top` in docs/images: `python -m tools.top_pictures`, in half a minute.

The tool runs the demo, aborts a module to have a crash report, and presses the keys of each view.
"""

import asyncio
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from robbie_mp.cli.top_program.feed import RunFeed
from robbie_mp.cli.top_program.program import TopProgram

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
WARM_UP_S = 12.0
AFTER_ABORT_S = 6.0
INTERVAL_S = 0.5


def main() -> None:
    """Run the demo and take all pictures."""
    with tempfile.TemporaryDirectory() as folder:
        runtime = Path(folder, "runtime")
        runtime.mkdir(mode=0o700)
        os.environ["XDG_RUNTIME_DIR"] = str(runtime)
        demo = subprocess.Popen(
            [*ROBBIE, "run", "demo", "--quiet", "--output", f"{folder}/output"], stdout=subprocess.DEVNULL
        )
        try:
            time.sleep(WARM_UP_S)
            run_id = next(Path(runtime, "robbie").iterdir()).name
            with closing(RunFeed(run_id)) as feed:
                asyncio.run(_take_all(feed))
        finally:
            demo.send_signal(signal.SIGINT)
            demo.wait(60)


async def _take_all(feed: RunFeed) -> None:
    app = TopProgram(feed, INTERVAL_S)
    async with app.run_test(size=SIZE) as pilot:
        reading = app.snapshot.reading
        module = reading.module(ABORTED) if reading else None
        if module is None:
            raise SystemExit("the demo did not start in time")
        os.kill(module.pid, signal.SIGABRT)
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
