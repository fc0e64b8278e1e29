"""The benchmark `restart`: how long a killed module is missing. No peer restarts a process."""

import json
import subprocess
import sys
from typing import Any

from tools.bench.contender import environment
from tools.bench.options import Options

LIMIT_S = 600.0


def restart(options: Options) -> list[dict[str, Any]]:
    """Run `tools.bench.restart` in a process of its own: it is the supervisor of what it kills."""
    kills = options.messages(30, 10)
    rows = [_measure(kills, spares) for spares in ((1,) if options.quick else (1, 0))]
    title = f"SIGKILL until the restarted module handles a message, {kills} kills"
    return [{"benchmark": "restart", "title": title, "kind": "restart", "contenders": rows}]


def _measure(kills: int, spares: int) -> dict[str, Any]:
    row: dict[str, Any] = {
        "name": f"robbie {spares} spares",
        "title": f"Robbie-MP, {spares} spare{'' if spares == 1 else 's'}",
        "version": "",
        "trouble": "",
        "parts": {},
    }
    program = [sys.executable, "-m", f"{__package__}.restart", "--json"]
    command = [*program, f"--kills={kills}", f"--spares={spares}"]
    ended = subprocess.run(
        command, env=environment(), capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    if ended.returncode:
        return row | {"trouble": ended.stderr.strip().splitlines()[-1]}
    return row | {"parts": json.loads(ended.stdout)["parts"]}
