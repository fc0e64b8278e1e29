"""A supervisor in a separate process: `supervise.py BASE FOLDER TERMINAL|- BEHAVIOUR...`.

It makes a run directory and a name in shared memory, prints the run id when all children run, and supervises.
"""

import os
import sys
from pathlib import Path

from robbie_mp.bus.transport.shared_folder import SHARED_MEMORY
from robbie_mp.run.run_directory import RunDirectory
from tests.run.supervisor._support import zoo
from tests.run.supervisor._support.running import Run, Scenario, animal


def main() -> int:
    base, folder, terminal, *behaviours = sys.argv[1:]
    if terminal != "-":
        os.open(terminal, os.O_RDWR)  # a session leader's first terminal becomes the one that controls it
    directory = RunDirectory.create("zoo", Path(folder), Path(base))
    segment = Path(f"{SHARED_MEMORY}/robbie-{directory.run_id}/board")
    segment.touch(mode=0o600)
    run = Run(
        Path(folder), *(animal(getattr(zoo, behaviour)) for behaviour in behaviours), run_id=directory.run_id
    )

    def scenario() -> Scenario:
        yield run.all_running
        print(directory.run_id, *run.incarnations.pids.values(), flush=True)

    code = run.play(scenario())
    directory.remove()
    return code


if __name__ == "__main__":
    sys.exit(main())
