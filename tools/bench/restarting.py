"""The benchmark `restart`: how long a killed module is away. No peer restarts processes."""

import json
import subprocess
import sys
from typing import Any

from tools.bench.contender import environment
from tools.bench.options import Options

LIMIT_S = 600.0
SUBJECTS = {
    "small": ("--subject=small", "--spares=1"),
    "mapping": ("--subject=mapping", "--spares=1"),
    "small, no spares": ("--subject=small", "--spares=0"),
}
"""The subjects by title, and the options of `tools.bench.restart` for each."""


def restart(options: Options) -> list[dict[str, Any]]:
    """Run `tools.bench.restart` in a separate process for each subject, because it is itself a supervisor."""
    kills = options.messages(30, 10)
    subjects = list(SUBJECTS)[:1] if options.quick else list(SUBJECTS)
    title = f"SIGKILL until the restarted module handles a message, {kills} kills"
    rows = [_measure(subject, kills) for subject in subjects]
    return [{"benchmark": "restart", "title": title, "kind": "restart", "contenders": rows}]


def _measure(subject: str, kills: int) -> dict[str, Any]:
    row = {"name": f"robbie {subject}", "title": f"**{subject}**", "version": "", "trouble": "", "parts": {}}
    program = [sys.executable, "-m", f"{__package__}.restart", "--json", f"--kills={kills}"]
    ended = subprocess.run(
        [*program, *SUBJECTS[subject]],
        env=environment(),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    if ended.returncode:
        return row | {"trouble": ended.stderr.strip().splitlines()[-1]}
    return row | {"parts": json.loads(ended.stdout)["parts"]}
